"""Find a plug-in: in a file, among the entry points, or behind a command.

============================= ==================================================
algorithm                     what it is
============================= ==================================================
``mine.py``                   the one plug-in of the wanted kind in a file
``mine.py:name``              the one of that name
``command: ./mine {poses}``   a calibrator that runs a command, see `command`
``name``                      an entry point of the group ``simval.plugins``
============================= ==================================================
"""

import runpy
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

from simval.plugins.command import COMMAND, command_calibrator
from simval.plugins.errors import PluginError
from simval.plugins.protocol import Calibrator, Estimator

GROUP = "simval.plugins"
Kind = TypeVar("Kind", Estimator, Calibrator)


def find_plugin(algorithm: str, kind: type[Kind]) -> Kind:
    """Find the plug-in that an algorithm's word stands for.

    Parameters
    ----------
    algorithm : str
        As in the table above.
    kind : type
        `Estimator` or `Calibrator`.

    Returns
    -------
    Estimator or Calibrator
        The plug-in, as it declares itself; see `simval.plugins.probe`.

    Raises
    ------
    PluginError
        If there is none, or more than one.
    """
    if algorithm.startswith(COMMAND):
        if kind is not Calibrator:
            msg = f"`{algorithm}`: only a calibrator can be a command"
            raise PluginError(msg)
        found: Any = command_calibrator(algorithm)
        return found
    path, _, name = algorithm.partition(".py:")
    if algorithm.endswith(".py") or name:
        file = Path(algorithm if not name else f"{path}.py")
        return _chosen(plugins_of(file), kind, name, str(file))
    return _entry_point(algorithm, kind)


def plugins_of(file: Path, *others: type) -> list[Any]:
    """Plug-ins that a Python file holds.

    Parameters
    ----------
    file : Path
        Run as a module of its own, with its folder on the module path.
    *others : type
        What else counts, beside `Estimator` and `Calibrator`.

    Returns
    -------
    list
        In the order of the file; two names for the same object count once.

    Raises
    ------
    PluginError
        If the file is missing or fails.
    """
    if not file.is_file():
        msg = f"the plug-in file {file} does not exist; give the path of a Python file"
        raise PluginError(msg)
    try:
        with _importing_from(file.resolve().parent):
            held = runpy.run_path(str(file), run_name=f"simval_plugin_{file.stem}")
    except Exception as error:  # whatever a user's file may raise
        msg = f"the plug-in file {file} fails with {type(error).__name__}: {error}"
        raise PluginError(msg) from error
    found = [
        v for v in held.values() if isinstance(v, (Estimator, Calibrator, *others))
    ]
    return list({id(value): value for value in found}.values())


def _chosen(held: list[Any], kind: type[Kind], name: str, where: str) -> Kind:
    fitting = [value for value in held if isinstance(value, kind)]
    if name:
        fitting = [value for value in fitting if value.name == name]
    if len(fitting) != 1:
        names = ", ".join(value.name for value in held) or "none"
        msg = (
            f"{where} holds {len(fitting)} {kind.__name__}s"
            f"{f' named {name}' if name else ''}; it must hold one, or be given as "
            f"FILE:NAME (it has: {names})"
        )
        raise PluginError(msg)
    return fitting[0]


def _entry_point(name: str, kind: type[Kind]) -> Kind:
    points = metadata.entry_points(group=GROUP)
    chosen = [point for point in points if point.name == name]
    if len(chosen) != 1:
        names = ", ".join(sorted(point.name for point in points)) or "none"
        msg = (
            f"there is no plug-in `{name}`: {len(chosen)} installed packages offer it "
            f"in the group {GROUP} (installed: {names}); a file is given as FILE.py or "
            f"FILE.py:NAME, a command as `{COMMAND} PROGRAM {{poses}}`"
        )
        raise PluginError(msg)
    try:
        value = chosen[0].load()
    except Exception as error:  # whatever an installed package may raise
        msg = f"the entry point `{name}` fails with {type(error).__name__}: {error}"
        raise PluginError(msg) from error
    return _chosen([value], kind, "", f"the entry point {name}")


@contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    before = list(sys.path)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path[:] = before
