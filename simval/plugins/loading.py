"""Load a plug-in: from a file, an installed package, or a command.

Loading runs a user's code, so what a file or a package offers is asked in a child.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import module_from_spec
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from simval.errors import PluginError, UnusablePluginError
from simval.files import MOST_DOCUMENT, read_bytes
from simval.plugins.builtin import BUILTIN, GROUP, PREFIX, meant_builtin, points_of
from simval.plugins.child import started
from simval.plugins.command import command_calibrator
from simval.plugins.declarations import declarations
from simval.plugins.names import COMMAND
from simval.plugins.protocol import SCENE, Calibrator, Plugin
from simval.text import did_you_mean, message_of

TIME_LIMIT = 60.0
"""Seconds for reading what a file or a package offers."""

Kind = TypeVar("Kind", bound=Plugin)


@dataclass(frozen=True, slots=True)
class Meant:
    """A plug-in that a word means."""

    field: str  # of a study, which takes it
    word: str  # what that field is set to
    name: str  # as it calls itself
    declared: Mapping[str, str]  # see `simval.plugins.declarations`


def find_plugin(algorithm: str, kind: type[Kind]) -> Kind:
    """Find the plug-in of a name.

    Parameters
    ----------
    algorithm : str
        As in the table of `simval.plugins.names`.
    kind : type
        `Estimator`, `Calibrator`, `Filter` or `simval.scene.Scene`.

    Returns
    -------
    Estimator, Calibrator, Filter or Scene
        The plug-in, as it declares itself; see `simval.plugins.probe`.

    Raises
    ------
    UnusablePluginError
        If there is none, or more than one.
    """
    if algorithm.startswith(COMMAND):
        if kind is not Calibrator:
            msg = (
                f"`{algorithm}`: only a calibrator can be a command; declare the "
                "program of an estimator or of a filter in a Python file, with "
                "`command_estimator` or `command_filter`"
            )
            raise UnusablePluginError(msg)
        command: Any = command_calibrator(algorithm)
        return command
    file, name = _python_file(algorithm)
    return _of_file(file, name, kind) if file else _of_package(algorithm, kind)


def overrides_of(plugins: tuple[str, ...]) -> list[str]:
    """Overrides that put some plug-ins, and no others, into a suite.

    Raises
    ------
    UnusablePluginError
        As `chosen`.
    """
    return spelled(chosen(plugins))


def spelled(words: Mapping[str, Sequence[str]]) -> list[str]:
    """Plug-ins by field as overrides of a suite."""
    return [f"{field}={','.join(each)}" for field, each in words.items()]


def chosen(plugins: tuple[str, ...]) -> dict[str, list[str]]:
    """Some plug-ins, by the field that takes them.

    Raises
    ------
    UnusablePluginError
        If one cannot be used, or holds no plug-in.
    """
    values: dict[str, list[str]] = {}
    for plugin in plugins:
        if "," in plugin:
            msg = f"`{plugin}` has a comma, which separates values; rename it"
            raise UnusablePluginError(msg)
        for each in meant(plugin):
            values.setdefault(each.field, []).append(each.word)
    return values


def meant(plugin: str) -> list[Meant]:
    """Plug-ins that a word means; each is loaded in a child.

    Raises
    ------
    UnusablePluginError
        If one cannot be used, or none is held.
    """
    if plugin.startswith(COMMAND):
        command = command_calibrator(plugin)
        return [Meant(command.taken_by, plugin, command.name, declarations(command))]
    file, name = _python_file(plugin)
    if not file and not points_of(plugin):
        raise _no_plugin(plugin, 0)
    whole = file or plugin
    try:
        with started(TIME_LIMIT, f"the plug-in {whole}") as child:
            held = child.ask(offer, whole)
    except PluginError as error:
        raise UnusablePluginError(str(error)) from None
    if not file:
        return [Meant(field, plugin, own, declared) for field, own, declared in held]
    chosen = [each for each in held if name in ("", each[1])]
    if not chosen:
        names = ", ".join(own for _, own, _ in held)
        msg = f"{file} holds no plug-in named {name}; it has: {names}"
        raise UnusablePluginError(msg)
    alone = sum(field == SCENE for field, *_ in held) == 1
    return [
        Meant(field, file if field == SCENE and alone else f"{file}:{own}", own, words)
        for field, own, words in chosen
    ]


def offer(plugin: str) -> list[tuple[str, str, dict[str, str]]]:
    """Load a file or a package, and list the plug-ins in it.

    For each the field that takes it, its name, and what it declares.

    Raises
    ------
    UnusablePluginError
        If it cannot be loaded, or holds no plug-in.
    """
    is_file = plugin.endswith(".py")
    try:
        values = _held_by(Path(plugin)) if is_file else _loaded(plugin)
    except SystemExit as error:
        what = "file" if is_file else "package"
        msg = f"the plug-in {what} {plugin} calls exit({error.code})"
        raise UnusablePluginError(msg) from None
    held = [
        (value.taken_by, value.name, declarations(value))
        for value in values
        if isinstance(value, Plugin)
    ]
    if not held:
        msg = (
            f"{plugin} holds no Estimator, Calibrator, Filter or Scene at its top "
            "level; see docs/plugins.md"
        )
        raise UnusablePluginError(msg)
    return held


def installed() -> list[tuple[str, str]]:
    """Plug-ins that installed packages offer; none is loaded."""
    points = metadata.entry_points(group=GROUP)
    return sorted(
        (point.name, f"{point.dist.name} {point.dist.version}" if point.dist else "")
        for point in points
    )


def _held_by(file: Path) -> list[Any]:
    """Plug-ins of a Python file."""
    if not file.is_file():
        msg = f"the plug-in file {file} does not exist; give the path of a Python file"
        raise UnusablePluginError(msg)
    try:
        content = vars(_imported(file))
    except SystemExit as error:
        msg = f"the plug-in file {file} calls exit({error.code})"
        raise UnusablePluginError(msg) from None
    except Exception as error:  # whatever a user's file may raise
        msg = f"the plug-in file {file} fails with {message_of(error)}"
        raise UnusablePluginError(msg) from error
    return _distinct(file, content)


def _distinct(file: str | Path, content: Mapping[str, Any]) -> list[Any]:
    """Plug-ins among the values of a module; two names for the same one count once."""
    held = [value for value in content.values() if isinstance(value, Plugin)]
    plugins = list({id(value): value for value in held}.values())
    names: set[tuple[type, str]] = set()
    for value in plugins:
        if (type(value), value.name) in names:
            msg = (
                f"{file} holds two {type(value).__name__}s named `{value.name}`; give "
                "each a different name"
            )
            raise UnusablePluginError(msg)
        names.add((type(value), value.name))
    return plugins


def _imported(file: Path) -> ModuleType:
    """Import a file afresh, under a unique name.

    It is a module like any other, so that what looks one up later finds it: pickle, the
    evaluation of annotations, an import of a neighbour from inside a function.
    """
    folder, name = str(file.resolve().parent), _module_name(file)
    # not resolved: what it has beside itself is beside the link that names it
    path = str(file.absolute())
    loader = SourceFileLoader(name, path)
    module = module_from_spec(ModuleSpec(name, loader, origin=path))
    module.__file__ = path
    # not by the loader: its cache takes a file of the same second and size for this one
    source = read_bytes(file, MOST_DOCUMENT)
    sys.modules[name] = module
    if folder not in sys.path:
        sys.path.append(folder)
    try:
        exec(loader.source_to_code(source, path), vars(module))
    except BaseException:
        sys.modules.pop(name, None)  # as after an import that fails
        raise
    return module


def _module_name(file: Path) -> str:
    return f"simval_plugin_{file.stem}"


def _python_file(word: str) -> tuple[str, str]:
    """Python file that a word names, or nothing, and what is meant inside it."""
    path, _, name = word.partition(".py:")
    if name:
        return f"{path}.py", name
    return word if word.endswith(".py") else "", ""


def _of_file(file: str, name: str, kind: type[Kind]) -> Kind:
    return _fitting(file, _held_by(Path(file)), name, kind)


def _fitting(file: str, held: Sequence[Any], name: str, kind: type[Kind]) -> Kind:
    fitting = [value for value in held if isinstance(value, kind)]
    if name:
        fitting = [value for value in fitting if value.name == name]
    if len(fitting) != 1:
        names = ", ".join(value.name for value in held) or "none"
        msg = (
            f"{file} holds {len(fitting)} {kind.__name__}s"
            f"{f' named {name}' if name else ''}; it must hold one, or be given as "
            f"FILE:NAME (it has: {names})"
        )
        raise UnusablePluginError(msg)
    return fitting[0]


def _of_package(name: str, kind: type[Kind]) -> Kind:
    held = _loaded(name)
    fitting = [value for value in held if isinstance(value, kind)]
    if len(fitting) == 1:
        return fitting[0]
    if len(held) == 1:
        (point,) = points_of(name)
        home = kind.__module__.rpartition(".")[0]
        msg = (
            f"the entry point `{name}` = {point.value} is of type "
            f"{type(held[0]).__name__}; it must be a {home}.{kind.__name__}"
        )
        raise UnusablePluginError(msg)
    raise _no_plugin(name, len(held))


def _no_plugin(word: str, count: int) -> UnusablePluginError:
    offered = [known for known, _ in installed()]
    near = did_you_mean(word, offered) or meant_builtin(word)
    if word.startswith(PREFIX):
        return UnusablePluginError(
            f"there is no built-in algorithm `{word}`{near}; there are "
            f"{', '.join(BUILTIN)}"
        )
    names = ", ".join(offered) or "none"
    return UnusablePluginError(
        f"there is no plug-in `{word}`{near}: a file must end in .py (FILE.py or "
        f"FILE.py:NAME), a command begin with `{COMMAND}`, and {count or 'no'} "
        f"installed package{'s offer' if count > 1 else ' offers'} one of that name "
        f"(installed: {names})"
    )


def _loaded(name: str) -> list[Any]:
    try:
        return [point.load() for point in points_of(name)]
    except Exception as error:  # whatever an installed package may raise
        msg = f"the entry point `{name}` fails with {message_of(error)}"
        raise UnusablePluginError(msg) from error
