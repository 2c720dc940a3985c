"""The public names: what a user may import, and pages that document them.

A package's names are those of its `__all__`; a module on its own that the documentation
tells users to import has those it defines.
"""

import ast
import importlib
import inspect
import pkgutil
from collections.abc import Iterable
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import FunctionType, ModuleType

import simval.imu
from docs.site.equations import Module, modules, room_of

PLAIN = ("errors", "figures", "geometry", "poses", "results", "statistics", "streams")
"""Modules without `__all__` whose names users import."""
METHODS = (FunctionType, classmethod, staticmethod, property, cached_property)
LONGEST = 120  # characters of a constant's value that is shown


def public_modules() -> dict[str, ModuleType]:
    """Every module that users import from, by its dotted name."""
    found = {}
    below = [
        *pkgutil.iter_modules(simval.__path__, "simval."),
        *pkgutil.iter_modules(simval.imu.__path__, "simval.imu."),
    ]
    for info in below:
        plain = info.name.removeprefix("simval.") in PLAIN
        if info.ispkg or plain:
            module = importlib.import_module(info.name)
            if hasattr(module, "__all__") or plain:
                found[module.__name__] = module
    return found


def public_names(module: ModuleType) -> list[str]:
    """Names of a module that users import."""
    if hasattr(module, "__all__"):
        return sorted(module.__all__, key=str.lower)
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and (inspect.isclass(value) or inspect.isfunction(value))
        and value.__module__ == module.__name__
    ]


def interface_page(name: str, module: ModuleType) -> str:
    """Page of one module: its own words, then each name."""
    parts = [_title(name, "="), f".. automodule:: {name}"]
    for member in public_names(module):
        value = getattr(module, member)
        if inspect.isclass(value) or inspect.isroutine(value):
            parts.append(_documented(f"{name}.{member}", value))
        else:
            parts.append(_constant(module, member, value))
    return "\n\n".join(parts) + "\n"


def _documented(name: str, value: object) -> str:
    methods = ", ".join(public_methods(value)) if isinstance(value, type) else ""
    members = f"\n   :members: {methods}" * bool(methods)
    return f".. {_directive(value)}:: {name}{members}"


def _directive(value: object) -> str:
    return "autoclass" if inspect.isclass(value) else "autofunction"


def public_methods(value: type) -> list[str]:
    """Methods and properties that a class of this project describes, inherited too."""
    described = {
        name: member
        for base in reversed(value.__mro__)
        if base.__module__.partition(".")[0] == "simval"
        for name, member in vars(base).items()
        if not name.startswith("_")
        and isinstance(member, METHODS)
        and inspect.getdoc(member)
    }
    return list(described)


def _constant(module: ModuleType, member: str, value: object) -> str:
    """A constant with its value, where that is short, and the words below it."""
    shown = repr(value)
    lines = [f".. py:data:: {module.__name__}.{member}"]
    if len(shown) < LONGEST and "<" not in shown:
        lines.append(f"   :value: {shown}")
    words = _words_below(module, member)
    return "\n".join([*lines, "", *(f"   {line}" for line in words.splitlines())])


def _words_below(module: ModuleType, member: str) -> str:
    """The string below the assignment of a constant, in any module of its package."""
    folder = Path(str(module.__file__)).parent
    for path in sorted(folder.glob("*.py")):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        for line, below in pairwise(body):
            assigned = isinstance(line, ast.Assign | ast.AnnAssign) and any(
                isinstance(target, ast.Name) and target.id == member
                for target in getattr(line, "targets", [getattr(line, "target", None)])
            )
            if assigned and isinstance(below, ast.Expr):
                return inspect.cleandoc(str(ast.literal_eval(below.value)))
    return ""


def top_page() -> str:
    """Page of `simval` itself, whose names are those of other packages."""
    lines = []
    for name in sorted(simval.__all__, key=str.lower):
        home = simval._HOMES.get(name)
        lines.append(
            f"- ``simval.{name}`` is `{home}.{name}`"
            if home
            else f"- ``simval.{name}``: version of the installed distribution"
        )
    return (
        "\n\n".join((_title("simval", "="), ".. automodule:: simval", "\n".join(lines)))
        + "\n"
    )


def equations_page(package: str, members: list[Module], public: set[str]) -> str:
    """Page of the numbered equations of one package, in their modules' own words."""
    parts = [_title(f"Equations of {package}", "=")]
    for module in members:
        again = "\n   :no-index:" if module.name in public else ""
        parts += [
            _title(module.name, "-"),
            f".. automodule:: {module.name}{again}",
        ]
        for owner in sorted({o for o in module.defined.values() if o}):
            kind = _directive(getattr(importlib.import_module(module.name), owner))
            parts.append(f".. {kind}:: {module.name}.{owner}\n   :no-index:")
    return "\n\n".join(parts) + "\n"


def index_page(title: str, names: Iterable[str]) -> str:
    """List of pages with the first lines of their modules."""
    rows = []
    for name in names:
        words = inspect.getdoc(importlib.import_module(name)) or ""
        rows.append(f"- :doc:`{name}`: {words.partition(chr(10))[0]}")
    tree = "\n".join((".. toctree::", "   :hidden:", "", *(f"   {n}" for n in names)))
    return "\n\n".join((_title(title, "="), "\n".join(rows), tree)) + "\n"


def with_equations() -> dict[str, list[Module]]:
    """Modules that define equations, by the package below simval or the module."""
    found: dict[str, list[Module]] = {}
    for module in modules().values():
        if module.defined:
            found.setdefault(room_of(module.name), []).append(module)
    return found


def _title(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}"
