r"""Values that name files: which fields may, and what they are wherever they lie.

Only a field marked with `NamesFiles` is ever taken for one; a slash in any other value
is part of the text. Who computes a cell needs the path; its name, its streams, the
store and all that is shown have the file's name alone, so that the same plug-in in two
folders is the same one, and nobody's folders are told to others.
"""

import os
import re
import shlex
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import PurePath
from typing import Any

from pydantic import BaseModel

from simval.plugins.command import COMMAND

SUFFIXES = (".py", ".xml", ".csv", ".txt", ".log", ".mat", ".json", ".toml")
"""Endings by which a value is known to name a file."""

_BEFORE = r"""(?:(?<![^\s'"`(=:,;<>\[|])|(?<=file://))"""
"""Where a path may begin: not inside a word, so that ``m/s^2`` and a URL are none."""

_FOLDERS = re.compile(_BEFORE + r"""/(?:[^/\s'"`<>|:,;]+/)+""")


@dataclass(frozen=True, slots=True)
class NamesFiles:
    """Mark of a field whose value may name files."""


@cache
def file_fields(model: type[BaseModel]) -> frozenset[str]:
    """Fields of a study's parameters that may name files."""
    return frozenset(
        key
        for key, info in model.model_fields.items()
        if any(isinstance(mark, NamesFiles) for mark in info.metadata)
    )


def portable_fields(
    model: type[BaseModel], values: Mapping[str, Any]
) -> dict[str, Any]:
    """Values of a study's fields, files by their names alone."""

    def plain(value: Any) -> Any:
        if isinstance(value, list):
            return [plain(v) for v in value]
        return portable(value) if isinstance(value, str) else value

    named = file_fields(model)
    return {k: plain(v) if k in named else v for k, v in values.items()}


def is_path(text: str) -> bool:
    """Tell whether a value of a field that may name files does."""
    if text.startswith(COMMAND):
        return True
    return "/" in text or "\\" in text or ".py:" in text or text.endswith(SUFFIXES)


def file_of(text: str) -> str:
    """Path of the file that a value names."""
    path, colon, _ = text.partition(".py:")
    return f"{path}.py" if colon else path


def portable(text: str) -> str:
    """Name of a file without its folder, and what the text names inside it."""
    if text.startswith(COMMAND):
        return with_words(text, lambda _, word: _shortened(word))
    path = file_of(text)
    return PurePath(path).name + text.removeprefix(path)


def with_words(text: str, change: Callable[[int, str], str]) -> str:
    """Change words of a command."""
    try:
        words = shlex.split(text.removeprefix(COMMAND))
    except ValueError:  # the study says so, in words
        return text
    changed = [change(place, word) for place, word in enumerate(words)]
    if changed == words:
        return text
    plain = [shlex.quote(w) if set(w) & set(" \t\n\"'\\") else w for w in changed]
    return " ".join([COMMAND, *plain])


def _shortened(word: str) -> str:
    path = PurePath(word)
    return path.name if path.is_absolute() else without_folders(word)


def without_folders(text: str, folders: Iterable[str] = ()) -> str:
    """Take the folders of this machine out of a text."""
    known = {f.rstrip(os.sep) for f in folders if os.path.isabs(f)} - {""}
    for folder in sorted(known, key=len, reverse=True):
        text = re.sub(f"{_BEFORE}{re.escape(folder)}/", "", text)
    return _FOLDERS.sub("", text)
