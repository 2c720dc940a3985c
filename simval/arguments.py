"""Checks of arguments that are not arrays: counts, choices, switches, objects.

Like those of `arrays` they are made once, at a public boundary. Each refuses, by an
`InputError`, what Python would silently take for another value: 2.7 for 2, True for 1,
the word "no" for true.
"""

import operator
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from simval.errors import InputError
from simval.text import as_whole, did_you_mean, shown

MOST: Final = 10**12  # of anything counted here: more is a slip, and never ends

Kind = TypeVar("Kind")


def whole_number(name: str, value: Any, least: int, most: int = MOST) -> int:
    """Convert to an integer within its limits: 1e5 is one, 1.5 and True are not."""
    try:
        number = operator.index(as_whole(value))
    except TypeError:
        number = least - 1
    if isinstance(value, bool | np.bool_) or not least <= number <= most:
        # a count that is too large by a slip learns the limit
        told = number <= most == MOST
        limit = f"{least} or more" if told else f"from {least} to {most}"
        msg = f"`{name}` is {shown(value)}; it must be a whole number, {limit}"
        raise InputError(msg)
    return number


def choice(name: str, value: Any, allowed: Sequence[Any]) -> Any:
    """Require one of the values of an option."""
    for known in allowed:
        if isinstance(value, type(known)) and value == known:
            return known
    words = [str(known) for known in allowed]
    near = did_you_mean(value, words) if isinstance(value, str) else ""
    listed = ", ".join(words)
    msg = f"`{name}` is {shown(value)}{near}; it must be one of {listed}"
    raise InputError(msg)


def switch(name: str, value: Any) -> bool:
    """Require True or False."""
    if not isinstance(value, bool | np.bool_):
        msg = f"`{name}` is {shown(value)}; it must be True or False"
        raise InputError(msg)
    return bool(value)


def instance(name: str, value: Any, kind: type[Kind]) -> Kind:
    """Require an object of a type."""
    if not isinstance(value, kind):
        msg = f"`{name}` is {shown(value)}; it must be of type {kind.__name__}"
        raise InputError(msg)
    return value


def function(name: str, value: Any) -> Callable[..., Any]:
    """Require something that can be called."""
    if not callable(value):
        msg = f"`{name}` is {shown(value)}; it must be a function"
        raise InputError(msg)
    return value


def file_path(name: str, value: Any) -> Path:
    """Convert to a path: not empty, without a zero byte."""
    text = value if isinstance(value, str | os.PathLike) else ""
    text = os.fspath(text)
    if not isinstance(text, str) or not text or "\0" in text:
        msg = f"`{name}` is {shown(value)}; it must be the path of a file or folder"
        raise InputError(msg)
    return Path(text)
