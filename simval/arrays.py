"""Checks of shape and finiteness at public boundaries, and read-only arrays.

A public function passes each array argument through `finite_array` once; inside,
types and shapes are trusted.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.errors import InputError

Array = NDArray[np.floating]


def finite_array(name: str, value: Any, tail: Sequence[int | None]) -> Array:
    """Convert to a float64 array whose last axes have the given lengths.

    Parameters
    ----------
    name : str
        The argument's name, for the message.
    value : array_like
        What the caller gave.
    tail : sequence of int or None
        Required lengths of the last axes; None accepts any length.

    Returns
    -------
    Array
        A float64 array of shape ``(..., *tail)``; not a copy where none is needed.

    Raises
    ------
    InputError
        If the value is not numeric, has another shape, or is not finite: the
        message names the first bad entry by its index.
    """
    array = shaped_array(name, value, tail)
    if not np.isfinite(array).all():
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        msg = (
            f"`{name}` has {np.count_nonzero(~np.isfinite(array))} non-finite "
            f"value(s), the first ({array[first]}) at index {first}; every value "
            "must be finite, so remove or repair those rows"
        )
        raise InputError(msg)
    return array


def shaped_array(name: str, value: Any, tail: Sequence[int | None]) -> Array:
    """Convert to a float64 array of the given trailing shape, finite or not.

    Parameters
    ----------
    name : str
        The argument's name, for the message.
    value : array_like
        What the caller gave.
    tail : sequence of int or None
        Required lengths of the last axes; None accepts any length.

    Returns
    -------
    Array
        A float64 array of shape ``(..., *tail)``; not a copy where none is needed.

    Raises
    ------
    InputError
        If the value is not numeric or has another shape.
    """
    try:
        if np.iscomplexobj(value):
            reason = "it is complex"
            raise TypeError(reason)
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        msg = f"`{name}` is not an array of real numbers ({error}); give numbers"
        raise InputError(msg) from None
    fits = array.ndim >= len(tail) and all(
        want is None or have == want
        for have, want in zip(array.shape[array.ndim - len(tail) :], tail, strict=True)
    )
    if not fits:
        wanted = ", ".join("n" if n is None else str(n) for n in tail)
        msg = f"`{name}` has shape {array.shape}; the last axes must be ({wanted})"
        raise InputError(msg)
    return array


def positive_number(name: str, value: Any, unit: str) -> float:
    """Convert to a finite float above zero.

    Parameters
    ----------
    name : str
        The argument's name, for the message.
    value : float
        What the caller gave.
    unit : str
        Unit of the quantity, for the message.

    Returns
    -------
    float
        The value.

    Raises
    ------
    InputError
        If the value is not one finite number above zero.
    """
    number = _real_number(name, value, unit)
    if not number > 0.0:
        msg = f"`{name}` is {value!r}; it must be a finite number above 0 {unit}"
        raise InputError(msg.rstrip())
    return number


def nonnegative_number(name: str, value: Any, unit: str) -> float:
    """Convert to a finite float that is zero or more.

    Parameters
    ----------
    name : str
        The argument's name, for the message.
    value : float
        What the caller gave.
    unit : str
        Unit of the quantity, for the message.

    Returns
    -------
    float
        The value.

    Raises
    ------
    InputError
        If the value is not one finite number of at least zero.
    """
    number = _real_number(name, value, unit)
    if not number >= 0.0:
        msg = f"`{name}` is {value!r}; it must be a finite number, 0 {unit} or more"
        raise InputError(msg)
    return number


def _real_number(name: str, value: Any, unit: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not np.isfinite(number):
        msg = f"`{name}` is {value!r}; it must be one finite number {unit}"
        raise InputError(msg.rstrip())
    return number


def frozen(array: Any) -> Array:
    """Copy to a read-only float64 array, for a frozen dataclass to keep.

    Parameters
    ----------
    array : array_like
        Any numeric array.

    Returns
    -------
    Array
        A read-only copy.
    """
    copy = np.array(array, dtype=np.float64)
    copy.flags.writeable = False
    return copy
