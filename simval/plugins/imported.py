"""Versions of the packages that a plug-in's files import.

Their own code is not hashed: a version says which it was. The package itself and what
every run states anyway (`simval.sweep.provenance`) are left out.
"""

import ast
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import metadata

from simval.files import MOST_DOCUMENT, read_bytes

STATED = frozenset({"simval", "numpy", "scipy", "mujoco", "pydantic"})
"""Modules whose versions a run states whatever its plug-ins."""


def imported_versions(files: Iterable[str]) -> dict[str, str]:
    """Version of each installed package that some Python files name in an import."""
    named = {name for file in files if file.endswith(".py") for name in _named(file)}
    foreign = named - STATED - sys.stdlib_module_names
    if not foreign:
        return {}
    found = {dist for name in foreign for dist in _distributions().get(name, ())}
    return {dist: metadata.version(dist) for dist in sorted(found)}


@cache
def _distributions() -> Mapping[str, list[str]]:
    """Packages by the modules at their top: reading them all takes a while."""
    return metadata.packages_distributions()


def _named(file: str) -> Iterator[str]:
    """First part of each module that a file imports."""
    try:
        nodes = ast.walk(ast.parse(read_bytes(file, MOST_DOCUMENT)))
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return  # loading it fails, in words
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.partition(".")[0]
