"""Checks the shapes and types of every call inside simval, in tests only.

The functions of a package's face are left out: they are tried with garbage, and
check what they are given themselves, in users' runs too.
"""

import ast
import sys
from pathlib import Path

from beartype import BeartypeConf, beartype
from jaxtyping import install_import_hook

ROOT = Path(__file__).resolve().parents[1] / "simval"


def face(room):
    """The names in the `__all__` of a package's or a module's own text."""
    for statement in ast.parse(room.read_text()).body:
        if isinstance(statement, ast.Assign) and statement.targets[0].id == "__all__":
            return set(ast.literal_eval(statement.value))
    return set()


FACES = {
    ".".join(("simval", *path.relative_to(ROOT).parts[:1])).removesuffix(".py"): face(
        path
    )
    for path in [*ROOT.glob("*.py"), *ROOT.glob("*/__init__.py")]
}
INNER = beartype(conf=BeartypeConf(is_pep484_tower=True))


def check(function):
    """`function`, its arguments and its result checked unless it is on a face."""
    room = ".".join(function.__module__.split(".")[:2])
    if function.__qualname__.split(".")[0] in FACES.get(room, ()):
        return function
    return INNER(function)


def install():
    """Check what is imported from now on."""
    if "simval" in sys.modules:
        msg = "simval is imported already: its calls would go unchecked"
        raise RuntimeError(msg)
    install_import_hook("simval", "typechecked.check")
