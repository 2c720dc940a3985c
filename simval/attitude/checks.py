"""What makes a pair of vector observations usable, sample by sample.

The estimator needs vectors that are finite, not zero and not parallel, and body
and reference vectors of the same length: it is homogeneous in each pair's common
length, so unit vectors, m/s^2 and tesla all work, but not a mixture.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array, finite_array, real_number
from simval.errors import GeometryError, InputError, SimvalError
from simval.shapes import Bool, Float
from simval.text import shown

Codes = NDArray[np.int8]
Mask = NDArray[np.bool_]

# Below this sine of the angle between the two vectors the rotation about them has
# lost half of its digits: rounding enters the attitude as eps / sine.
MIN_SINE: Final = 1e-7
# A fixed frame is refused below this share of the greatest possible norm: rounding
# enters the direction of qbar as eps / |qbar|.
MIN_NORM: Final = 1e-8
# Squares and fourth powers of lengths inside this range neither over- nor underflow.
LENGTHS: Final = (1e-50, 1e50)


class Validity(IntEnum):
    """Whether a sample can be used, and if not, why."""

    VALID = 0
    NOT_FINITE = 1
    LENGTH = 2
    LENGTHS_DISAGREE = 3
    COLLINEAR = 4
    SINGULAR = 5
    INCONSISTENT = 6


_MESSAGES: Final = {
    Validity.NOT_FINITE: "a component is not finite; remove or repair that sample",
    Validity.LENGTH: (
        "a vector is zero or its length is outside 1e-50 to 1e50; "
        "a direction is needed, so remove that sample or rescale"
    ),
    Validity.LENGTHS_DISAGREE: (
        "a body vector and its reference vector differ in length by more than "
        "`length_tolerance`; give both in the same unit, or normalise both"
    ),
    Validity.COLLINEAR: (
        f"the two vectors are parallel (sine below {MIN_SINE:g}): rotation about "
        "them is not observable, so choose a second direction farther from the first"
    ),
    Validity.SINGULAR: (
        f"the chosen frame is singular there (|qbar| below {MIN_NORM:g}): use "
        'frame="best" or "combined", which never are'
    ),
    Validity.INCONSISTENT: (
        "the angle between the body vectors differs from that of the references by "
        "more than `noise_std` explains; check which pair is wrong, and remove it"
    ),
}


def block_validity(
    vectors: Float[Array, "12 n"], length_tolerance: float
) -> Codes | None:
    """Validity of each column of a block, or None where all are valid."""
    lengths, dots = _products(vectors)
    shortest, longest = lengths.min(), lengths.max()
    if LENGTHS[0] ** 2 < shortest and longest < LENGTHS[1] ** 2:  # no NaN either
        limit = max(0.0, 1.0 - length_tolerance) ** 2
        agree = shortest >= limit * longest or _lengths_agree(lengths, limit).all()
        if agree and _apart(lengths, dots).all():
            return None
    return _codes(vectors, lengths, dots, length_tolerance)


def _products(
    vectors: Float[Array, "12 n"],
) -> tuple[Float[Array, "4 n"], Float[Array, "2 n"]]:
    # squared lengths of b1, b2, r1, r2; b1.b2 and r1.r2
    v = vectors.reshape(4, 3, -1)
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        lengths = np.einsum("kjn,kjn->kn", v, v)
        dots = np.einsum("kjn,kjn->kn", v[::2], v[1::2])
    return lengths, dots


def _lengths_agree(
    lengths: Float[Array, "4 n"], limit: float
) -> Bool[NDArray[np.bool_], "2 n"]:
    body, reference = lengths[:2], lengths[2:]
    agree: Mask = (body >= limit * reference) & (reference >= limit * body)
    return agree


def _apart(
    lengths: Float[Array, "4 n"], dots: Float[Array, "2 n"]
) -> Bool[NDArray[np.bool_], "2 n"]:
    # Lagrange: |v1 x v2|^2 = |v1|^2 |v2|^2 - (v1.v2)^2; its rounding, 4e-16, is
    # 4 % of MIN_SINE^2
    apart: Mask = dots * dots <= (1.0 - MIN_SINE**2) * (lengths[::2] * lengths[1::2])
    return apart


def _codes(
    vectors: Float[Array, "12 n"],
    lengths: Float[Array, "4 n"],
    dots: Float[Array, "2 n"],
    length_tolerance: float,
) -> Codes:
    limit = max(0.0, 1.0 - length_tolerance) ** 2
    codes: Codes = np.zeros(vectors.shape[1], dtype=np.int8)
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        codes[~_apart(lengths, dots).all(axis=0)] = Validity.COLLINEAR
        codes[~_lengths_agree(lengths, limit).all(axis=0)] = Validity.LENGTHS_DISAGREE
        inside = (lengths > LENGTHS[0] ** 2) & (lengths < LENGTHS[1] ** 2)
    codes[~inside.all(axis=0)] = Validity.LENGTH
    codes[~np.isfinite(vectors).all(axis=0)] = Validity.NOT_FINITE
    return codes


def singular_columns(
    vectors: Float[Array, "12 n"], squared: Float[Array, " n"]
) -> Mask | None:
    """Which columns of a fixed frame are singular, or None where none is."""
    r = vectors[6:].reshape(2, 3, -1)
    lengths = np.einsum("kjn,kjn->kn", r, r)
    if squared.min() >= MIN_NORM**2 * lengths.max() ** 2:
        return None
    mask: Mask = ~(squared >= MIN_NORM**2 * lengths[0] * lengths[1])
    return mask if mask.any() else None


def widest_difference(noise_std: Any, false_alarm: Any) -> float:
    """Difference of the two angles, rad, that noise exceeds in a share of the samples.

    Raises
    ------
    InputError
        If the noise or the share is none.
    """
    rate = real_number("false_alarm", false_alarm, "of the samples")
    if not 0.0 < rate < 1.0:
        msg = f"`false_alarm` is {shown(false_alarm)}; it must be between 0 and 1"
        raise InputError(msg)
    if noise_std is None:
        return np.inf
    std = finite_array("noise_std", noise_std, ())
    if std.shape not in ((), (4,)) or not (np.all(std >= 0.0) and 0.0 < std.max() <= 1):
        msg = (
            f"`noise_std` is {shown(noise_std)}; give one standard deviation of the "
            "unit vectors, or four for b1, b2, r1, r2, from 0 to 1 and one above 0"
        )
        raise InputError(msg)
    # each vector's noise in the plane of the pair turns it by that angle
    total = float(np.sqrt(np.sum(np.broadcast_to(std, (4,)) ** 2)))
    return total * float(-scipy.special.ndtri(rate / 2.0))


def refuse(codes: Codes, shape: Sequence[int]) -> None:
    """Raise the error of the first sample that is not valid, if there is one.

    Raises
    ------
    InputError
        If a component is not finite, a vector zero, or lengths disagree.
    GeometryError
        If the vectors are parallel or the fixed frame is singular.
    """
    bad = np.flatnonzero(codes)
    if bad.size == 0:
        return
    code = Validity(int(codes[bad[0]]))
    index = tuple(int(i) for i in np.unravel_index(bad[0], tuple(shape)))
    where = f"sample {index}" if index else "the sample"
    kind: type[SimvalError] = InputError
    if code in (Validity.COLLINEAR, Validity.SINGULAR):
        kind = GeometryError
    msg = (
        f"{bad.size} of {codes.size} sample(s) cannot be used; the first is {where}: "
        f"{_MESSAGES[code]} (`estimate_attitude` gives a validity per sample instead)"
    )
    raise kind(msg)
