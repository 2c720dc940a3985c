"""Paths in a suite file: relative to the file, inside its folder, and existing.

A command may run any program, so its words need not lie in the folder; words that are
files in it are resolved.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from simval.errors import InputError
from simval.plugins.names import file_of, located
from simval.studies import STUDIES
from simval.studies.plugin import PluginParameters
from simval.studies.study import Cell


def kept_inside(name: str, content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Check the paths of a suite file and resolve them.

    Raises
    ------
    InputError
        If a path is absolute, has a ``..``, or leads out of the folder by a link.
    """

    def kept(value: Any, key: str) -> Any:
        if isinstance(value, list):
            return [kept(v, key) for v in value]
        if not isinstance(value, str):
            return value
        if file_of(value):
            _require_inside(name, key, value, folder)
        return located(value, str(folder))

    resolved = dict(content)
    for study in resolved.keys() & STUDIES.keys():
        table, field = resolved[study], STUDIES[study].parameters.plugin
        if isinstance(table, Mapping) and field in table:
            resolved[study] = {**table, field: kept(table[field], field)}
    return resolved


def require_plugins(cells: Iterable[Cell]) -> None:
    """Check that the plug-ins of some cells exist, before anything is computed."""
    for cell in cells:
        own = cell.parameters
        if isinstance(own, PluginParameters) and (gone := own.missing()):
            msg = (
                f"`{cell.study}.{own.plugin}`: {gone}; give FILE.py, FILE.py:NAME or "
                "the name of an installed plug-in, in a suite relative to its file"
            )
            raise InputError(msg)


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
