"""What a calibration file states, and whether its statements agree.

Some statements say all, the others follow from them. A statement that follows is
recomputed and compared, entry by entry, to the digits that are printed.
"""

from decimal import Decimal
from typing import Any

import numpy as np

from simval.arrays import Array, shaped_array
from simval.calibrate.result import FitResult
from simval.errors import InputError
from simval.text import shown

_ROUNDING = 1e-12  # a sum of products of two parameters is off by a few times 1e-16
_SIX_DIGITS = 5e-6  # half a unit in the sixth digit, relative, of a leading 1
_REACH = 1.5  # readings at rest, over g; the fit's own residuals are far below a half


def derived(fit: FitResult) -> dict[str, Any]:
    """Statements that follow from the others."""
    return {
        "names": list(fit.names),
        "T": plain(fit.T),
        "K": plain(fit.K),
        "B": plain(fit.B),
        "matrix": plain(fit.matrix),
        "sd": plain(fit.sd),
        "confidence_95": plain(fit.intervals),
        "raw_per_g": plain(fit.raw_per_g),
        "raw_unit": fit.raw_unit,
    }


def require_possible(fit: FitResult) -> None:
    """Refuse values that no calibration has.

    Raises
    ------
    InputError
        If T K is singular, the covariance is none, or the readings are not of it.
    """
    fit.sensor()  # T K can be inverted
    known = np.isfinite(fit.covariance)
    if known.any() != known.all() or known.any() == (fit.covariance_kind == "none"):
        msg = (
            f"`covariance_kind` is {fit.covariance_kind!r}, and {known.sum()} of the "
            "81 entries of `covariance` are there; give both, or leave both out"
        )
        raise InputError(msg)
    if known.all():
        size = np.sqrt(np.maximum(np.diagonal(fit.covariance), 0.0))
        skew = np.abs(fit.covariance - fit.covariance.T)
        good = (skew <= _ROUNDING * np.outer(size, size)).all() and (size > 0.0).all()
        if not good:
            msg = "`covariance` is not symmetric with variances above 0; leave it out"
            raise InputError(msg)
    low, high = fit.raw_range.T
    reach = _REACH * fit.g * np.linalg.norm(np.linalg.inv(fit.matrix), axis=1)
    stated = np.isfinite(fit.raw_range)
    inside = (fit.B - reach <= low) & (low <= high) & (high <= fit.B + reach)
    if stated.any() and not (stated.all() and inside.all()):
        msg = (
            f"`raw_range` is {shown(fit.raw_range.tolist())}, and with this g, K and B "
            f"a sensor at rest reads from {shown((fit.B - reach).tolist())} to "
            f"{shown((fit.B + reach).tolist())}; correct what is wrong, or leave it out"
        )
        raise InputError(msg)


def require_agreement(data: dict[str, Any], fit: FitResult) -> None:
    """Refuse a statement that is not what follows from the others.

    Raises
    ------
    InputError
        Naming the first such statement, and both values.
    """
    for name, value in derived(fit).items():
        stated = data.get(name, value)
        if name in ("names", "raw_unit"):
            if stated != value:
                raise InputError(_contradiction(name, stated, value))
            continue
        want = np.array(value, dtype=float)
        have = array({name: stated}, name, want.shape)
        same = np.abs(have - want) <= _rounding(have, want)
        same |= np.isnan(have) & np.isnan(want)
        if not same.all():
            place = tuple(int(i) for i in np.argwhere(~same)[0])
            field = name + "".join(f"[{i}]" for i in place)
            values = (f"{x[place]:.12g}" for x in (have, want))
            raise InputError(_contradiction(field, *values))


def _rounding(have: Array, want: Array) -> Array:
    # what two statements of one number may differ by: half a unit of the last digit
    # that is printed, of six digits at least, and the rounding of a sum in its row
    units = [Decimal(repr(float(x))).as_tuple().exponent for x in have.flat]
    half = [0.5 * 10.0 ** int(e) if isinstance(e, int) else 0.0 for e in units]
    row = np.max(np.abs(want), axis=-1, keepdims=want.ndim > 1)
    printed = np.minimum(np.reshape(half, have.shape), _SIX_DIGITS * np.abs(want))
    return np.asarray(printed + _ROUNDING * row)


def _contradiction(field: str, stated: Any, derived: Any) -> str:
    return (
        f"`{field}` is {stated}, but the rest of the file makes it {derived}; it was "
        "edited by hand in one place only: keep T, K, B and g alone, which say all, "
        "or calibrate again"
    )


def plain(value: Any) -> Any:
    """Lists of floats, what is not finite as None."""
    numbers = np.asarray(value, dtype=float)
    plain = numbers.astype(object)
    plain[~np.isfinite(numbers)] = None
    return plain.tolist()


def array(data: dict[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    """Numbers of a file; null, and what is not there, becomes NaN.

    Raises
    ------
    InputError
        If it holds something else.
    """
    if name not in data:
        return np.full(shape, np.nan)
    numbers = shaped_array(name, _filled(data[name]), ())
    if numbers.shape != shape or np.isinf(numbers).any():
        msg = (
            f"`{name}` has shape {numbers.shape}; finite numbers of {shape} are needed"
        )
        raise InputError(msg)
    return numbers


def _filled(value: Any) -> Any:
    if isinstance(value, list):
        return [_filled(entry) for entry in value]
    return np.nan if value is None else value
