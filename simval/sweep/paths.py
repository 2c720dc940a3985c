"""Paths in a suite file: relative to the file, and never out of its folder.

A command may run any program, so its words are not held to the folder; those that are
files there are meant.
"""

from collections.abc import Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from simval.errors import InputError
from simval.plugins.command import COMMAND
from simval.studies.sources import located
from simval.studies.study import file_of, is_path


def kept_inside(name: str, content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Check the paths of a suite file and resolve them.

    Parameters
    ----------
    name : str
        Of the suite, for the message.
    content : mapping
        As read from TOML.
    folder : Path
        Folder of the suite file.

    Returns
    -------
    dict
        The content, paths absolute.

    Raises
    ------
    InputError
        If a path is absolute, has a ``..``, or leads out of the folder by a link.
    """

    def kept(value: Any, key: str) -> Any:
        if isinstance(value, Mapping):
            return {k: kept(v, str(k)) for k, v in value.items()}
        if isinstance(value, list):
            return [kept(v, key) for v in value]
        if key != "title" and isinstance(value, str) and is_path(value):
            if not value.startswith(COMMAND):
                _require_inside(name, key, value, folder)
            return located(value, str(folder))
        return value

    return {str(key): kept(value, str(key)) for key, value in content.items()}


def _require_inside(name: str, key: str, text: str, folder: Path) -> None:
    path = file_of(text)
    parts = {*PurePosixPath(path).parts, *PureWindowsPath(path).parts}
    rooted = PurePosixPath(path).is_absolute() or PureWindowsPath(path).anchor
    target = (folder / path).resolve()
    if rooted or ".." in parts or not target.is_relative_to(folder.resolve()):
        msg = (
            f"suite {name}, `{key}`: {text!r} leaves the folder of the suite; paths in "
            "a suite file must be relative and stay inside it: move the file there, or "
            "give it on the command line (--plugin, --set)"
        )
        raise InputError(msg)
