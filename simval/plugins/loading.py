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

import sys
from importlib import metadata
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import module_from_spec
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from simval.plugins.command import COMMAND, command_calibrator
from simval.plugins.errors import UnusablePluginError, told
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
    UnusablePluginError
        If there is none, or more than one.
    """
    if algorithm.startswith(COMMAND):
        if kind is not Calibrator:
            msg = f"`{algorithm}`: only a calibrator can be a command"
            raise UnusablePluginError(msg)
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
        Run as a module of its own, which stays in ``sys.modules``; its folder stays at
        the end of the module path, where it hides nothing.
    *others : type
        What else counts, beside `Estimator` and `Calibrator`.

    Returns
    -------
    list
        In the order of the file; two names for the same object count once.

    Raises
    ------
    UnusablePluginError
        If the file is missing or fails, or two plug-ins of a kind share a name.
    """
    if not file.is_file():
        msg = f"the plug-in file {file} does not exist; give the path of a Python file"
        raise UnusablePluginError(msg)
    try:
        content = vars(_imported(file.resolve()))
    except Exception as error:  # whatever a user's file may raise
        msg = f"the plug-in file {file} fails with {told(error)}"
        raise UnusablePluginError(msg) from error
    kinds = (Estimator, Calibrator, *others)
    held = [value for value in content.values() if isinstance(value, kinds)]
    found: list[Any] = list({id(value): value for value in held}.values())
    names: set[tuple[type, str]] = set()
    for value in found:
        if (type(value), value.name) in names:
            msg = (
                f"{file} holds two {type(value).__name__}s named `{value.name}`; give "
                "each a name of its own"
            )
            raise UnusablePluginError(msg)
        names.add((type(value), value.name))
    return found


def _imported(file: Path) -> ModuleType:
    """Import a file afresh, under a name that no other module has.

    It is a module like any other, so that what looks one up later finds it: pickle, the
    evaluation of annotations, an import of a neighbour from inside a function.
    """
    folder, name = str(file.parent), f"simval_plugin_{file.stem}"
    loader = SourceFileLoader(name, str(file))
    module = module_from_spec(ModuleSpec(name, loader, origin=str(file)))
    module.__file__ = str(file)
    sys.modules[name] = module
    if folder not in sys.path:
        sys.path.append(folder)
    # not by the loader: its cache takes a file of the same second and size for this one
    exec(loader.source_to_code(file.read_bytes(), str(file)), vars(module))
    return module


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
        raise UnusablePluginError(msg)
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
        raise UnusablePluginError(msg)
    try:
        value = chosen[0].load()
    except Exception as error:  # whatever an installed package may raise
        msg = f"the entry point `{name}` fails with {told(error)}"
        raise UnusablePluginError(msg) from error
    if not isinstance(value, kind):
        msg = (
            f"the entry point `{name}` = {chosen[0].value} is of type "
            f"{type(value).__name__}; it must be a simval.plugins.{kind.__name__}"
        )
        raise UnusablePluginError(msg)
    return value
