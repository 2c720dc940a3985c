"""Checks of shape and finiteness at public boundaries, and read-only arrays.

A public function passes each array argument through `finite_array` once; inside,
types and shapes are trusted. Nothing is converted that is not a real number already:
text, dates, truth values, complex numbers, None and masked entries are refused, where
NumPy would silently make numbers of them. An `InputError` names the argument, what is
wrong of it, and the first bad entry by its index.
"""

from collections.abc import Iterator, Sequence
from decimal import Decimal
from numbers import Real
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from simval.errors import InputError
from simval.shapes import Float, Shaped
from simval.text import shown

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]
Places = NDArray[np.intp]  # of entries in an array
# what is given: lists mixed of whole numbers and others have these types, and no
# `ArrayLike`
Vector = NDArray[Any] | Sequence[float]
Matrix = NDArray[Any] | Sequence[Sequence[float]]
Scalars = Array | np.floating  # of an array without axes NumPy makes a number

_KINDS: Final = {
    "b": "holds truth values",
    "c": "is complex",
    "M": "holds dates",
    "m": "holds time differences",
    "S": "holds bytes",
    "U": "holds text",
    "T": "holds text",
    "V": "is a table with named columns",
}
# Readings and gravity as a user gives them. A scale is one over the other, from 1e-72
# to 1e72, and its fourth power, the highest that a moment takes, stays finite.
GREATEST: Final = 1e36
LEAST: Final = 1e-36  # one over it: the same reason


def outer(
    a: Shaped[Array, "... n"], b: Shaped[Array, "... m"]
) -> Shaped[Array, "... n m"]:
    """Outer products of vectors, of numbers or of power series."""
    return a[..., :, None] * b[..., None, :]


def finite_array(name: str, value: Any, tail: Sequence[int | None]) -> Array:
    """Convert to a float64 array whose last axes have the given lengths."""
    array = shaped_array(name, value, tail)
    if not np.isfinite(array).all():
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        msg = (
            f"`{name}` has values that are not finite: "
            f"{np.count_nonzero(~np.isfinite(array))} in all, the first "
            f"({array[first]}) at index {first}; remove or repair those rows"
        )
        raise InputError(msg)
    return array


def physical_array(
    name: str, value: Any, tail: Sequence[int | None], most: float = GREATEST
) -> Array:
    """`finite_array` of values whose powers can be worked with."""
    array = shaped_array(name, value, tail)
    greatest = max(float(array.max(initial=0.0)), -float(array.min(initial=0.0)))
    if not greatest <= most:
        finite_array(name, array, tail)
        msg = (
            f"`{name}` has a value of {greatest:g}, beyond {most:g}; no sensor "
            "reads that, so check its unit"
        )
        raise InputError(msg)
    return array


def noise_levels(
    name: str, value: Any, count: int, of: str = "poses", trials: int | None = None
) -> Float[Array, "... count"]:
    """Standard deviations of poses or axes, one for all or one for each.

    Of each of so many trials, too, if they are given in that shape.
    """
    sigma = shaped_array(name, value, ())
    fits = sigma.shape in ((), (count,), (trials, count))
    if not (fits and np.all((sigma == 0.0) | (sigma >= LEAST))):
        least = np.min(sigma, initial=np.inf)
        each = "" if trials is None else f", or of {trials} trials ({trials}, {count})"
        msg = (
            f"`{name}` has shape {sigma.shape} and least value {least:g}; give one "
            f"number, or one for each of the {count} {of}{each}, 0 or {LEAST:g} and "
            "more"
        )
        raise InputError(msg)
    if not np.all(sigma <= GREATEST):
        msg = f"`{name}` is infinite or beyond {GREATEST:g}; check its unit"
        raise InputError(msg)
    return np.broadcast_to(sigma, (*sigma.shape[:-1], count))


def shaped_array(name: str, value: Any, tail: Sequence[int | None]) -> Array:
    """Convert to a float64 array of the given trailing shape, finite or not."""
    array = _real_array(name, value)
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
    """Convert to a float from `LEAST` to `GREATEST`."""
    number = real_number(name, value, unit)
    if not number >= LEAST:
        limit = "above 0" if number <= 0.0 else f"of {LEAST:g} or more"
        msg = (
            f"`{name}` is {shown(value)}; it must be a finite number {limit}{_in(unit)}"
        )
        raise InputError(msg)
    return number


def nonnegative_number(name: str, value: Any, unit: str) -> float:
    """Convert to a float of zero or more, `GREATEST` at most."""
    number = real_number(name, value, unit)
    if not number >= 0.0:
        msg = (
            f"`{name}` is {shown(value)}; it must be a finite number, 0 {unit} or more"
        )
        raise InputError(msg)
    return number


def _in(unit: str) -> str:
    return f", in {unit}" if unit else ""


def real_number(name: str, value: Any, unit: str) -> float:
    """Convert to a finite float, of size `GREATEST` at most."""
    try:
        array = _real_array(name, value)
    except InputError:
        array = np.full(1, np.nan)
    if array.ndim != 0 or not np.isfinite(array):
        msg = f"`{name}` is {shown(value)}; it must be one finite number{_in(unit)}"
        raise InputError(msg)
    if not np.abs(array) <= GREATEST:
        msg = f"`{name}` is {shown(value)}, beyond {GREATEST:g}; check its unit"
        raise InputError(msg)
    return float(array)


def _real_array(name: str, value: Any) -> Array:
    # float64 array of what is real numbers already; not a copy where none is needed
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    if type(value) in (float, np.float64):
        return np.asarray(value)
    try:
        reason = _masked(value)
        given = np.asarray(None if reason else value)
        reason = reason or _foreign(given, value)
        with np.errstate(over="ignore"):  # a number too large becomes infinite
            array = np.asarray(0.0 if reason else given, dtype=np.float64)
    except Exception as error:  # the __array__ of any library runs in here
        reason = str(error) or type(error).__name__
    if reason:
        msg = f"`{name}` is not an array of real numbers ({reason}); give numbers"
        raise InputError(msg)
    return array


def _masked(value: Any) -> str:
    # what is masked in a masked array, or in one within a sequence
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        return f"{np.ma.getmaskarray(value).sum()} of its entries are masked"
    if isinstance(value, list | tuple):
        return next(filter(None, map(_masked, value)), "")
    return ""


def _foreign(given: NDArray[np.generic], value: Any) -> str:
    # what is in an array, or in the sequence it was made of, that is no real number
    kind = given.dtype.kind
    if kind in _KINDS:
        return f"it {_KINDS[kind]}"
    if kind == "O":
        entries: Any = given.flat
    elif isinstance(value, list | tuple):
        entries = _leaves(value)
    else:
        return ""
    for entry in entries:
        if isinstance(entry, bool | np.bool_) or not isinstance(entry, Real | Decimal):
            return f"it holds {shown(entry)}, of type {type(entry).__name__}"
    return ""


def _leaves(value: Any) -> Iterator[Any]:
    # entries of nested sequences; an array within is one of numbers by its own type
    for entry in value:
        if isinstance(entry, list | tuple):
            yield from _leaves(entry)
        elif isinstance(entry, np.ndarray):
            yield np.zeros((), entry.dtype)[()]
        else:
            yield entry


def frozen(array: Any) -> Array:
    """Copy to a read-only float64 array, for a frozen dataclass to keep."""
    copy = np.array(_real_array("array", array))
    copy.flags.writeable = False
    return copy


def json_values(values: Any) -> Any:
    """Values as JSON holds them, nested as they are; None for what is not finite."""
    array = np.asarray(values)
    found = array.astype(object)
    if array.dtype.kind == "f":
        found[~np.isfinite(array)] = None
    return found.tolist()


class ReadOnly:
    """Base of a frozen dataclass whose arrays are its own: read-only float64 copies."""

    __slots__ = ()
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if isinstance(value, np.ndarray) and value.dtype.kind == "f":
                object.__setattr__(self, name, frozen(value))
