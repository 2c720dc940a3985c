"""The numbered equations of the code: where each is defined, and what cites it.

A number belongs to its module: (K1) of the two-vector kernel is not that of the
calibration theory. It is defined by the tag of a displayed equation, or by standing
two spaces behind an equation in a line of text. It is cited by standing in brackets in
any other text or comment, and is found by `home`.
"""

import ast
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
TAG = r"\\tag\{([^}]*)\}"
NUMBER = r"[A-Z]{1,2}[0-9]+"
IN_LINE = rf"(?<=\S  )\(({NUMBER})\)"
CITED = re.compile(rf"(?<!\w)\(({NUMBER})\)")  # no argument of a call
_DEFINES = re.compile(f"{TAG}|{IN_LINE}")
_DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef


@dataclass(frozen=True, slots=True)
class Module:
    """The equations of one module of the package.

    Attributes
    ----------
    name : str
        Dotted name.
    defined : dict of str to str
        Numbers of its equations, and the function or class whose docstring has them;
        empty for the module's own.
    cited : frozenset of str
        Numbers in its strings and comments that it does not define.
    source : str
        Text of the file.
    """

    name: str
    defined: dict[str, str]
    cited: frozenset[str]
    source: str

    @property
    def package(self) -> str:
        """Name of the package it is in."""
        return self.name.rpartition(".")[0]


def room_of(module: str) -> str:
    """The package, or the module on its own, whose page tells of a module."""
    parts = module.split(".")
    return ".".join(parts[: 3 if parts[1:2] == ["imu"] else 2])


def anchor(number: str, module: str = "") -> str:
    """Name of an equation's place on its page."""
    return "-".join(["eq", *module.split(".")[1:], number])


def numbers(tag: str) -> list[str]:
    """Numbers in a tag: ``K1, (8)`` has two."""
    return [part.strip().strip("()") for part in tag.split(",")]


def defined_in(docstring: str) -> list[str]:
    """Numbers that a docstring gives to its equations."""
    tagged = [number for tag in re.findall(TAG, docstring) for number in numbers(tag)]
    return tagged + re.findall(IN_LINE, docstring)


@cache
def modules() -> dict[str, Module]:
    """Every module of the package that defines or cites an equation, by its name."""
    found = map(_read, sorted((ROOT / "simval").rglob("*.py")))
    return {m.name: m for m in found if m.defined or m.cited}


def home(number: str, citing: Module) -> Module | None:
    """Module of the equation that is cited.

    The citing module itself; else the only one of those that it names in backticks, of
    those beside it in its package, of those that it imports, or of those in a package
    that it imports from; else none.
    """
    if number in citing.defined:
        return citing
    owners = [m for m in modules().values() if number in m.defined]
    for choice in (_named, _beside, _imported, _near):
        chosen = [m for m in owners if choice(m, citing)]
        if len(chosen) == 1:
            return chosen[0]
    return None


def _named(owner: Module, citing: Module) -> bool:
    last = owner.name.rpartition(".")[2]
    return f"`{owner.name}`" in citing.source or f"`{last}`" in citing.source


def _beside(owner: Module, citing: Module) -> bool:
    return owner.package == citing.package


def _imported(owner: Module, citing: Module) -> bool:
    return f"from {owner.name} import" in citing.source


def _near(owner: Module, citing: Module) -> bool:
    return f"from {owner.package}" in citing.source and owner.package != "simval"


def _read(path: Path) -> Module:
    source = path.read_text(encoding="utf-8")
    parts = path.relative_to(ROOT).with_suffix("").parts
    defined = _defined(source) if _DEFINES.search(source) else {}
    return Module(
        name=".".join(part for part in parts if part != "__init__"),
        defined=defined,
        cited=frozenset(CITED.findall(source)) - defined.keys(),
        source=source,
    )


def _defined(source: str) -> dict[str, str]:
    return {
        number: "" if isinstance(node, ast.Module) else node.name
        for node in ast.walk(ast.parse(source))
        if isinstance(node, _DOCUMENTED)
        for number in defined_in(ast.get_docstring(node) or "")
    }
