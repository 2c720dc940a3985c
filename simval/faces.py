"""The face of a package: its public names, each imported when it is first used.

A command needs a few modules of each package; a face that imported all of them would
make every start pay for the whole package. So a face imports its names under
``TYPE_CHECKING`` only, for readers and type checkers, and `present` reads the same
lines and imports each name when it is asked for.
"""

import ast
import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any


class Face(ModuleType):
    """A package whose public names are imported when they are first used."""

    _homes: dict[str, str]  # name -> the module that holds it

    def __getattr__(self, name: str) -> Any:
        """Import a public name."""
        if name not in self._homes:
            msg = f"module {self.__name__!r} has no attribute {name!r}"
            raise AttributeError(msg, name=name, obj=self)
        value = getattr(import_module(self._homes[name]), name)
        setattr(self, name, value)
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        """Let no module hide the public name that it holds, as `scene.render`.

        The import system binds each module to its name in the package.
        """
        if name not in self._homes or not isinstance(value, ModuleType):
            super().__setattr__(name, value)

    def __dir__(self) -> Iterable[str]:
        """List what a completion should offer: public names and the modules inside."""
        return offered(self)


def offered(package: ModuleType) -> list[str]:
    """Public names of a package, imported yet or not, and its modules that are."""
    own = vars(package)
    inside = [
        name
        for name, value in own.items()
        if name.startswith("__")
        or getattr(value, "__name__", "") == f"{own['__name__']}.{name}"
    ]
    return sorted({*own["__all__"], *inside})


def present(package: str, file: str) -> None:
    """Make a package the face of the modules that its own file imports from."""
    face = sys.modules[package]
    text = ast.parse(Path(file).read_text(encoding="utf-8"))
    (block,) = (line for line in text.body if isinstance(line, ast.If))
    vars(face)["_homes"] = {
        alias.name: line.module
        for line in block.body
        if isinstance(line, ast.ImportFrom)
        for alias in line.names
    }
    face.__class__ = Face
