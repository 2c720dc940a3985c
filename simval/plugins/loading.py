r"""Load a plug-in from a file, a package or a command, and record its sources.

Loading runs a user's code, so what a file or a package offers is asked in a child.

It is made of each file and of each file that this names in turn (an imported module or
a string beside a Python file, a ``file`` beside an XML file), told by SHA-256, and of
packages, told by their versions. A cell is computed, and a run resumed, only where all
of it is unchanged.

The package's own algorithms are entry points as any package has them, ``simval:NAME``.
Their code is in `simval.algorithms`, loaded only when one is asked for.
"""

import ast
import hashlib
import os
import re
import shutil
import sys
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.metadata import EntryPoint
from importlib.util import module_from_spec
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, Final, TypeVar

from simval.errors import PluginError, UnusablePluginError
from simval.files import MOST_DOCUMENT, MOST_MODEL, read_bytes
from simval.plugins.child import started
from simval.plugins.names import COMMAND, file_of, is_file, portable, words_of
from simval.plugins.programs import command_calibrator, fault_of
from simval.plugins.protocol import (
    SCENE,
    Calibrator,
    Estimator,
    Filter,
    Plugin,
    declarations,
)
from simval.text import did_you_mean, nearest, raised

STATED = frozenset({"simval", "numpy", "scipy", "mujoco", "pydantic"})
"""Modules whose versions a run states whatever its plug-ins."""


def imported_versions(files: Iterable[str]) -> dict[str, str]:
    """Version of each installed package that some Python files import."""
    tops: set[str] = set()
    for file in (each for each in files if each.endswith(".py")):
        with suppress(OSError):  # loading it reports the error
            for node in _nodes(read_bytes(file, MOST_DOCUMENT)):
                if isinstance(node, ast.Import):
                    tops |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.level == 0:
                    tops.add((node.module or "").partition(".")[0])
    foreign = tops - STATED - sys.stdlib_module_names
    if not foreign:
        return {}
    found = {dist for name in foreign for dist in _distributions().get(name, ())}
    return {dist: metadata.version(dist) for dist in sorted(found)}


@cache
def _distributions() -> Mapping[str, list[str]]:
    """Names of packages by their top-level modules, read once as that is slow."""
    return metadata.packages_distributions()


def _nodes(content: bytes) -> list[ast.AST]:
    """All syntax nodes of a Python file; none if it cannot be parsed."""
    try:
        return list(ast.walk(ast.parse(content)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return []


GROUP: Final = "simval.plugins"
PREFIX: Final = "simval:"

_CLOSED_FORMS = ("optimal", "closed-form", "combined", "sequential", "table-1", "plain")
_ESTIMATORS = ("wahba", "weighted-wahba", "triad", *_CLOSED_FORMS)
_CALIBRATORS = ("squared", "norm", "weighted", "sampson", "adjusted")
_FILTERS = ("mekf", "mekf-six")

BUILTIN: Final[Mapping[str, EntryPoint]] = MappingProxyType(
    {
        f"{PREFIX}{name}": EntryPoint(
            name=f"{PREFIX}{name}",
            value=f"simval.algorithms:{name.replace('-', '_')}",
            group=GROUP,
        )
        for name in (*_ESTIMATORS, *_CALIBRATORS, *_FILTERS)
    }
)
"""By the name that suites and the command line call it."""

BESIDE: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        Estimator.taken_by: (f"{PREFIX}wahba", f"{PREFIX}triad"),
        Calibrator.taken_by: (f"{PREFIX}squared",),
        Filter.taken_by: (f"{PREFIX}mekf",),
    }
)
"""What ``--plugin`` adds beside a user's, by the field: the optimum first, whose time
is the unit of a call's; of estimators the plainest one too."""


def points_of(name: str) -> tuple[Any, ...]:
    """Entry points of a name: simval's own first, else those of other packages.

    Of the standard library's kind, or of `importlib_metadata`'s, which some packages
    put in its place when they are imported.
    """
    if name in BUILTIN:
        return (BUILTIN[name],)
    return tuple(metadata.entry_points(group=GROUP, name=name))


def beside_builtin(
    chosen: Mapping[str, list[str]],
) -> dict[str, list[str]]:
    """Plug-ins by field, with the built-in ones added where a user has one."""
    return {
        field: [*words, *(own for own in BESIDE.get(field, ()) if own not in words)]
        if any(word not in BUILTIN for word in words)
        else words
        for field, words in chosen.items()
    }


NAME_LIMIT = 255
"""Greatest length of a file's name: longer strings name none."""

_XML_FILE = re.compile(r"""\bfile\s*=\s*["']([^"'<>]+)["']""")
_XML_FOLDER = re.compile(r"""\b(?:asset|mesh|texture)dir\s*=\s*["']([^"'<>]+)["']""")


def sources(text: str) -> dict[str, str]:
    """Find everything that the code of a plug-in consists of."""
    files = [file_of(text)]
    if text.startswith(COMMAND):
        files = [w for w in words_of(text) if os.path.isabs(w) and is_file(w)]
    elif not files[0]:
        points = points_of(text)  # the package's own have no distribution
        return {p.dist.name: p.dist.version for p in points if p.dist is not None}
    held = {path: digest for f in files for path, digest in _closure(Path(f)).items()}
    return held | imported_versions(held)


def missing(text: str, held: Container[str] = ()) -> str:
    """Say which part of a plug-in is missing on this machine."""
    if text.startswith(COMMAND):
        if fault := fault_of(text):
            return fault
        program, *words = words_of(text)
        files = [word for word in words if portable(word) in held]
        if shutil.which(program) is None:
            return f"there is no program `{program}` here that can be run"
    elif file := file_of(text):
        files = [file]
    elif points_of(text):
        files = []
    elif text.startswith(PREFIX):
        return _no_builtin(text)
    else:
        return f"no installed package offers a plug-in `{text}`"
    gone = next((path for path in files if not is_file(path)), None)
    return "" if gone is None else f"the file {gone} does not exist"


def _closure(first: Path) -> dict[str, str]:
    """SHA-256 of a file and of every file that it names, and so on."""
    hashes: dict[str, str] = {}
    queue = [first]
    while queue:
        file = queue.pop()
        if str(file) in hashes:
            continue
        named = {".py": _named_by_python, ".xml": _named_by_xml}.get(file.suffix)
        try:
            if named is None:
                hashes[str(file)] = _digest(file)
                continue
            content = read_bytes(file, MOST_MODEL)
        except OSError:  # whoever uses it reports that
            hashes[str(file)] = ""
            continue
        hashes[str(file)] = hashlib.sha256(content).hexdigest()
        queue += named(file, first.parent, content)
    return hashes


def _digest(file: Path) -> str:
    # of a file of any size: a program, meshes, weights
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def _named_by_python(file: Path, root: Path, content: bytes) -> list[Path]:
    named: set[Path] = set()
    for node in _nodes(content):
        if isinstance(node, ast.Import):
            named.update(*(_modules(root, alias.name) for alias in node.names))
        elif isinstance(node, ast.ImportFrom):
            above = [root, *file.parents][min(node.level, len(file.parents))]
            names = [f"{node.module or ''}.{alias.name}" for alias in node.names]
            named.update(*(_modules(above, name.strip(".")) for name in names))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            named |= _beside(file.parent, node.value)
    return sorted(path for path in named if is_file(path))


def _modules(folder: Path, name: str) -> Iterator[Path]:
    """Files that importing a dotted name would run, if they are there."""
    path = folder
    for part in name.split("."):
        path = path / part
        yield path.with_name(f"{part}.py")
        yield path / "__init__.py"


def _named_by_xml(file: Path, root: Path, content: bytes) -> list[Path]:
    text = content.decode(errors="replace")
    folders = [".", *_XML_FOLDER.findall(text)]
    named: set[Path] = set()
    for name in _XML_FILE.findall(text):
        for folder in folders:
            named |= _beside(file.parent / folder, name)
    return sorted(named)


def _beside(folder: Path, name: str) -> set[Path]:
    if not 0 < len(name) <= NAME_LIMIT or os.path.isabs(name):
        return set()
    path = Path(os.path.normpath(folder / name))
    return {path} if is_file(path) else set()


TIME_LIMIT = 60.0
"""Seconds for reading what a file or a package offers."""

Kind = TypeVar("Kind", bound=Plugin)


@dataclass(frozen=True, slots=True)
class Meant:
    """A plug-in to which a word refers."""

    field: str  # of a study, which takes it
    word: str  # what that field is set to
    name: str  # as it calls itself
    declared: Mapping[str, str]  # see `simval.plugins.protocol`


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
    held = _held_by(Path(file)) if file else _loaded(algorithm)
    fitting = [
        value for value in held if isinstance(value, kind) and name in ("", value.name)
    ]
    if len(fitting) == 1:
        return fitting[0]
    if not file and len(held) != 1:
        raise _no_plugin(algorithm, len(held))
    names = ", ".join(value.name for value in held if isinstance(value, Plugin))
    msg = (
        f"{file} holds {len(fitting)} {kind.__name__}s"
        f"{f' named {name}' if name else ''}; it must hold one, or be given as "
        f"FILE:NAME (it has: {names or 'none'})"
    )
    if not file:
        (point,) = points_of(algorithm)
        home = kind.__module__.rpartition(".")[0]
        msg = (
            f"the entry point `{algorithm}` = {point.value} is of type "
            f"{type(held[0]).__name__}; it must be a {home}.{kind.__name__}"
        )
    raise UnusablePluginError(msg)


def spelled(words: Mapping[str, Sequence[str]]) -> list[str]:
    """Plug-ins by field, spelled as overrides of a suite."""
    return [f"{field}={','.join(each)}" for field, each in words.items()]


def chosen(plugins: tuple[str, ...]) -> dict[str, list[str]]:
    """Plug-ins that the words choose, by the field that takes them."""
    values: dict[str, list[str]] = {}
    for plugin in plugins:
        if "," in plugin:
            msg = (
                f"`{plugin}` has a comma, which separates values in a list; rename "
                "the file"
            )
            raise UnusablePluginError(msg)
        for each in meant(plugin):
            values.setdefault(each.field, []).append(each.word)
    return values


def meant(plugin: str) -> list[Meant]:
    """Plug-ins to which a word refers; each is loaded in a child."""
    if plugin.startswith(COMMAND):
        command = command_calibrator(plugin)
        return [Meant(command.taken_by, plugin, command.name, declarations(command))]
    file, name = _python_file(plugin)
    if not file and not points_of(plugin):
        raise _no_plugin(plugin, 0)
    whole = file or plugin
    try:
        later = "what takes long belongs into a call, not into the import"
        with started(TIME_LIMIT, f"the plug-in {whole}", later) as child:
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
    """
    values = _held_by(Path(plugin)) if plugin.endswith(".py") else _loaded(plugin)
    held = [
        (value.taken_by, value.name, declarations(value))
        for value in values
        if isinstance(value, Plugin)
    ]
    if not held:
        msg = (
            f"{plugin} holds no Estimator, Calibrator, Filter or Scene at its "
            "top level; docs/plugins.md says how to declare one"
        )
        raise UnusablePluginError(msg)
    return held


def installed() -> list[tuple[str, str]]:
    """Plug-ins that installed packages offer, without loading any."""
    points = metadata.entry_points(group=GROUP)
    return sorted(
        (point.name, f"{point.dist.name} {point.dist.version}" if point.dist else "")
        for point in points
    )


def _held_by(file: Path) -> list[Any]:
    """Plug-ins in a Python file, each once even if it has several names."""
    if not file.is_file():
        msg = f"the plug-in file {file} does not exist; give the path of a Python file"
        raise UnusablePluginError(msg)
    with _usable(f"the plug-in file {file}"):
        content = vars(imported_file(file))
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


def imported_file(file: Path) -> ModuleType:
    """Import a file afresh, under a unique name.

    It is a module like any other, so that what looks one up later finds it: pickle, the
    evaluation of annotations, an import of a neighbour from inside a function.
    """
    folder, name = str(file.resolve().parent), f"simval_plugin_{file.stem}"
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


def _python_file(word: str) -> tuple[str, str]:
    """Python file that a word names, or nothing, and the name inside it."""
    path, _, name = word.partition(".py:")
    if name:
        return f"{path}.py", name
    return word if word.endswith(".py") else "", ""


def _meant_builtin(word: str) -> str:
    own = {name.removeprefix(PREFIX): name for name in BUILTIN}
    near = nearest(word.removeprefix(PREFIX), own)
    return f" (did you mean `{own[near[0]]}`?)" if near else ""


def _no_builtin(word: str) -> str:
    return (
        f"there is no built-in algorithm `{word}`{_meant_builtin(word)}; there are "
        f"{', '.join(BUILTIN)}"
    )


def _no_plugin(word: str, count: int) -> UnusablePluginError:
    if word.startswith(PREFIX):
        return UnusablePluginError(_no_builtin(word))
    offered = [known for known, _ in installed()]
    near = did_you_mean(word, offered) or _meant_builtin(word)
    return UnusablePluginError(
        f"there is no plug-in `{word}`{near}: a file must end in .py (FILE.py or "
        f"FILE.py:NAME), a command begin with `{COMMAND}`, and {count or 'no'} "
        f"installed package{'s offer' if count > 1 else ' offers'} one of that name "
        f"(installed: {', '.join(offered) or 'none'})"
    )


def _loaded(name: str) -> list[Any]:
    with _usable(f"the entry point `{name}`"):
        return [point.load() for point in points_of(name)]


@contextmanager
def _usable(what: str) -> Iterator[None]:
    """Refuse a plug-in whose code cannot be loaded, whatever it raises."""
    try:
        yield
    except (Exception, SystemExit) as error:
        msg = f"{what} fails with {raised(error)}"
        raise UnusablePluginError(msg) from error
