r"""Name of a plug-in: the source that it refers to, and a portable spelling.

========================== ==========================================================
word                       what it names
========================== ==========================================================
``mine.py``                the one plug-in of the wanted kind in a file
``mine.py:NAME``           the one of that name
``command: ./mine {log}``  a calibrator that runs a command
``NAME``                   an entry point of the group ``simval.plugins``
========================== ==========================================================

Who computes a cell needs the path; its name, its streams, the store and all that is
shown have the file's name alone, so that the same plug-in in two folders is the same
one, and no folder of a user is shown to others.
"""

import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable
from pathlib import Path, PurePath
from tempfile import gettempdir

COMMAND = "command:"
"""Beginning of a word for a program and its words."""

SUFFIXES = (".py", ".xml", ".csv", ".txt", ".log", ".mat", ".json", ".toml")
"""Endings by which a word is known to name a file."""

_BEFORE = r"""(?:(?<![^\s'"`(=:,;<>\[|])|(?<=file://))"""
"""Where a path may begin: not inside a word, so that ``m/s^2`` and a URL are none."""

_FOLDERS = re.compile(_BEFORE + r"""/(?:[^/\s'"`<>|:,;]+/)+""")


def file_of(text: str) -> str:
    """Path of the file in a name; empty for a command or a package."""
    path, colon, _ = text.partition(".py:")
    if text.startswith(COMMAND):
        return ""
    known = "/" in text or "\\" in text or text.endswith(SUFFIXES)
    return f"{path}.py" if colon else text if known else ""


def located(text: str, folder: str = "") -> str:
    """The name with absolute paths of its files."""
    if text.startswith(COMMAND):
        return _with_words(text, lambda place, word: _located(place, word, folder))
    path = file_of(text)
    whole = os.path.abspath(os.path.join(folder, path)) if path else ""
    return whole + text.removeprefix(path)


def _located(place: int, word: str, folder: str) -> str:
    if place == 0 and "/" not in word:
        return word
    path = os.path.abspath(os.path.join(folder, word))
    return path if is_file(path) else word


def portable(text: str) -> str:
    """The name with its files' names only, without folders."""
    if text.startswith(COMMAND):
        return _with_words(text, lambda _, word: _shortened(word))
    path = file_of(text)
    return PurePath(path).name + text.removeprefix(path)


def _shortened(word: str) -> str:
    path = PurePath(word)
    return path.name if path.is_absolute() else without_folders(word)


def words_of(text: str) -> list[str]:
    """Words of a command; none if it cannot be split."""
    try:
        return shlex.split(text.removeprefix(COMMAND))
    except ValueError:  # the study reports that
        return []


def _with_words(text: str, change: Callable[[int, str], str]) -> str:
    words = words_of(text)
    changed = [change(place, word) for place, word in enumerate(words)]
    if changed == words:
        return text
    plain = [shlex.quote(w) if set(w) & set(" \t\n\"'\\") else w for w in changed]
    return " ".join([COMMAND, *plain])


def is_file(path: str | Path) -> bool:
    """True if there is a file of that name, whatever the name."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):  # a name that no file can have
        return False


def told_anywhere(text: str, files: Iterable[str]) -> str:
    """Remove the folders of a plug-in's files, and of this process, from a text."""
    places = (str(Path.cwd()), str(Path.home()), gettempdir())
    return without_folders(text, (*sys.path, *map(os.path.dirname, files), *places))


def without_folders(text: str, folders: Iterable[str] = ()) -> str:
    """Remove folders of this machine from a text."""
    known = {f.rstrip(os.sep) for f in folders if os.path.isabs(f)} - {""}
    for folder in sorted(known, key=len, reverse=True):
        text = re.sub(f"{_BEFORE}{re.escape(folder)}/", "", text)
    return _FOLDERS.sub("", text)
