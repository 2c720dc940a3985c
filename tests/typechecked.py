"""Plug-in of pytest: checks shapes and types of calls inside simval.

Of each function and method the first `CALLS` calls in a process are checked, arguments
and result, which costs little and meets every function. Those of a package's face are
left out: they are tried with garbage on purpose, and check what they are given
themselves, in users' runs too.
"""

import ast
import random
import sys
from functools import wraps
from inspect import isfunction
from pathlib import Path
from typing import Any, Self
from unittest.mock import patch

import numpy as np
from hooks import after_import
from jaxtyping import jaxtyped

from docs.site.equations import room_of

# of a list one entry is checked, chosen by dice that hypothesis does not watch
with patch("random.getrandbits", random.Random(0).getrandbits):
    from beartype import BeartypeConf, FrozenDict, beartype

CALLS = 50
ROOT = Path(__file__).resolve().parents[1] / "simval"
SWITCH = {"on": True}
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


def face(room):
    """The names in the `__all__` of a package's or a module's own text."""
    for statement in ast.parse(room.read_text()).body:
        if isinstance(statement, ast.Assign) and "__all__" in map(
            ast.unparse, statement.targets
        ):
            return set(ast.literal_eval(statement.value))
    return set()


FACES = {
    room_of(".".join(path.relative_to(ROOT.parent).with_suffix("").parts)): face(path)
    for path in [
        *ROOT.glob("*.py"),
        *ROOT.glob("*/__init__.py"),
        *ROOT.glob("imu/*/__init__.py"),
    ]
}


def checked(function):
    """The function with its first calls checked."""
    state = {"left": CALLS, "full": None}

    @wraps(function)
    def call(*args, **names):
        if state["left"] and SWITCH["on"]:
            state["left"] -= 1
            if state["full"] is None:  # built at its first call: a quick import
                for name, hint in function.__annotations__.items():
                    if hint is Self:
                        function.__annotations__[name] = Any
                state["full"] = jaxtyped(function, typechecker=INNER)
            return state["full"](*args, **names)
        return function(*args, **names)

    # it is no line of a user's, to whoever looks for that in a traceback
    call.__code__ = call.__code__.replace(co_filename="<checked>")
    return call


def check_module(module):
    """Put `checked` around the functions, methods and dataclasses of a module."""
    room = room_of(module.__name__)
    if room == "simval.cli":  # its annotations are of modules that are imported later
        return
    for name, value in list(vars(module).items()):
        if getattr(value, "__module__", "") != module.__name__:
            continue
        if name in FACES.get(room, ()):
            continue
        if isfunction(value) and not hasattr(value, "__wrapped__"):
            setattr(module, name, checked(value))
        elif isinstance(value, type):
            check_class(value)


def check_class(kind):
    """Put `checked` around the methods that a class has of its own."""
    for name, value in list(vars(kind).items()):
        plain = isfunction(value) and not hasattr(value, "__wrapped__")
        if plain and (name == "__init__" or not name.startswith("__")):
            setattr(kind, name, checked(value))


if "simval" in sys.modules:
    msg = "simval is imported already: its calls would go unchecked"
    raise RuntimeError(msg)
after_import(lambda name: name.split(".")[0] == "simval", check_module)
