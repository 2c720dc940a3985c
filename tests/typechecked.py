"""Plug-in of pytest: checks the shapes and types of every call inside simval.

The functions of a package's face are left out: they are tried with garbage on
purpose, and check what they are given themselves, in users' runs too.
"""

import ast
import random
import sys
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from jaxtyping import install_import_hook

# of a list one entry is checked, chosen by dice that hypothesis does not watch
with patch("random.getrandbits", random.Random(0).getrandbits):
    from beartype import BeartypeConf, FrozenDict, beartype

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
INNER = beartype(
    conf=BeartypeConf(
        hint_overrides=FrozenDict(  # a number that NumPy makes is one, too
            {
                bool: bool | np.bool_,
                int: int | np.integer,
                float: float | int | np.floating | np.integer,
                complex: complex | float | int | np.number,
            }
        )
    )
)
BUILT = {}  # by signature: a function in a function is the same each time


def check(stand_in):
    """What jaxtyping calls before a function, and with its result after it."""
    room = ".".join(stand_in.__module__.split(".")[:2])
    if stand_in.__qualname__.split(".")[0] in FACES.get(room, ()):
        return stand_in
    hints = stand_in.__annotations__
    if hints.get("return", Any) is not Any:  # after it: the arguments have been checked
        stand_in.__annotations__ = {"return": hints["return"]}
    key = (
        stand_in.__module__,
        stand_in.__qualname__,
        str(hints),
        str(stand_in.__annotations__),
    )

    def checked(*args, **names):  # built at its first call: a quick import
        if key not in BUILT:
            BUILT[key] = INNER(stand_in)
        return BUILT[key](*args, **names)

    return checked


if "simval" in sys.modules:
    msg = "simval is imported already: its calls would go unchecked"
    raise RuntimeError(msg)
install_import_hook("simval", "typechecked.check")
