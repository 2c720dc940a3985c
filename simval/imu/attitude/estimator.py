r"""Batched two-vector quaternion estimator with its checks.

The estimator needs vectors that are finite, not zero and not parallel, and body
and reference vectors of the same length: it is homogeneous in each pair's common
length, so unit vectors, m/s^2 and tesla all work, but not a mixture.
Equations and conventions are in `simval.imu.attitude.kernel`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, Literal, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arguments import choice, switch
from simval.arrays import GREATEST, Array, finite_array, real_number, shaped_array
from simval.errors import GeometryError, InputError, SimvalError
from simval.imu.attitude import kernel
from simval.shapes import Bool, Float
from simval.spelling import counted
from simval.text import shown

Codes = NDArray[np.int8]
Mask = NDArray[np.bool_]

# Below this sine of the angle between the two vectors the rotation about them has
# lost half of its digits: rounding enters the attitude as eps / sine.
MIN_SINE: Final = 1e-7
# A fixed frame is refused below this share of the greatest possible norm: rounding
# enters the direction of qbar as eps / |qbar|.
MIN_NORM: Final = 1e-8
# Of a quotient of two lengths: each is a root of a sum of three squares.
ROUNDED: Final = 1e-15
# Squares and fourth powers of lengths inside this range neither over- nor underflow.
LENGTHS: Final = (1e-50, 1e50)


class Validity(IntEnum):
    """Whether a sample can be used, or the reason why not."""

    VALID = 0
    NOT_FINITE = 1
    LENGTH = 2
    LENGTHS_DISAGREE = 3
    COLLINEAR = 4
    SINGULAR = 5
    INCONSISTENT = 6
    AMBIGUOUS = 7


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
        f"the vectors are parallel (sine below {MIN_SINE:g}): rotation about "
        "them is not observable, so choose another direction farther from the first"
    ),
    Validity.SINGULAR: (
        f"the chosen frame is singular there (|qbar| below {MIN_NORM:g}): use "
        'frame="optimal", "best" or "combined", which never are'
    ),
    Validity.INCONSISTENT: (
        "angles or lengths of the body vectors differ from those of the references by "
        "more than `noise_std` explains; check which pair is wrong, and remove it, or "
        "normalise vectors whose lengths are known to be wrong"
    ),
    Validity.AMBIGUOUS: (
        "two attitudes fit equally well, or the weights differ too much; give vectors "
        "in other directions, or closer weights"
    ),
}


def block_validity(
    vectors: Float[Array, "12 n"], length_tolerance: float
) -> Codes | None:
    """Validity of each column of a block; None if all are valid."""
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
    """Mask of the columns that are singular in a fixed frame; None if none is."""
    r = vectors[6:].reshape(2, 3, -1)
    lengths = np.einsum("kjn,kjn->kn", r, r)
    if squared.min() >= MIN_NORM**2 * lengths.max() ** 2:
        return None
    mask: Mask = ~(squared >= MIN_NORM**2 * lengths[0] * lengths[1])
    return mask if mask.any() else None


def widest_differences(noise_std: Any, false_alarm: Any) -> Float[Array, "3"]:
    """Differences that noise alone exceeds in a stated share of the samples.

    Of the two angles, rad, and of the length of b1 and of b2, over that of its
    reference.

    Raises
    ------
    InputError
        If the noise or the share is none.
    """
    rate = share_of_samples(false_alarm)
    if noise_std is None:
        return np.full(3, np.inf)
    std = finite_array("noise_std", noise_std, ())
    if std.shape not in ((), (4,)) or not (np.all(std >= 0.0) and 0.0 < std.max() <= 1):
        msg = (
            f"`noise_std` is {shown(noise_std)}; give one standard deviation of the "
            "unit vectors, or four for b1, b2, r1, r2, from 0 to 1 and one above 0"
        )
        raise InputError(msg)
    # each vector's noise in the plane of the pair turns it by that angle
    b1, b2, r1, r2 = np.broadcast_to(std, (4,))
    total = np.array(
        [np.linalg.norm(std * np.ones(4)), np.hypot(b1, r1), np.hypot(b2, r2)]
    )
    # three tests share the rate; lengths are rounded where there is no noise
    return total * float(-scipy.special.ndtri(rate / 6.0)) + [0.0, ROUNDED, ROUNDED]


def share_of_samples(false_alarm: Any) -> float:
    """Check the share of good samples that a test may refuse.

    Raises
    ------
    InputError
        If it is not between 0 and 1.
    """
    rate = real_number("false_alarm", false_alarm, "")
    if not 0.0 < rate < 1.0:
        msg = f"`false_alarm` is {shown(false_alarm)}; it must be between 0 and 1"
        raise InputError(msg)
    return rate


def refuse(
    codes: Codes, shape: Sequence[int], instead: str = "estimate_attitude"
) -> None:
    """Raise an error about the first sample that is not valid, if any.

    It names the function that gives a validity per sample instead.

    Raises
    ------
    InputError
        If a component is not finite, a vector zero, or lengths disagree.
    GeometryError
        If the vectors do not fix the attitude, or the fixed frame is singular.
    """
    bad = np.flatnonzero(codes)
    if bad.size == 0:
        return
    code = Validity(int(codes[bad[0]]))
    index = tuple(int(i) for i in np.unravel_index(bad[0], tuple(shape)))
    where = f"sample {index}" if index else "the sample"
    kind: type[SimvalError] = InputError
    if code in (Validity.COLLINEAR, Validity.SINGULAR, Validity.AMBIGUOUS):
        kind = GeometryError
    msg = (
        f"{bad.size} of {counted(codes.size, 'sample')} cannot be used; the "
        f"first is {where}: {_MESSAGES[code]} (`{instead}` gives a validity "
        "for each sample instead)"
    )
    raise kind(msg)


Selection = Literal["optimal", "best", "combined", "x", "y", "z", "plain"]
SELECTIONS = get_args(Selection)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttitudeEstimate:
    """Attitudes of a batch, with the validity of each sample.

    Attributes
    ----------
    q : Array
        Unit quaternions, reference to body, vector first, (..., 4); NaN where the
        sample is not valid.
    validity : Array
        Codes of `Validity`, (...).
    """

    q: Float[Array, "... 4"]
    validity: Codes

    @property
    def valid(self) -> Mask:
        """Mask of valid samples, (...)."""
        mask: Mask = self.validity == Validity.VALID
        return mask

    def require_valid(self) -> Float[Array, "... 4"]:
        """The attitudes, refused if one sample is not valid.

        Returns
        -------
        Array
            Unit quaternions, (..., 4).

        Raises
        ------
        InputError, GeometryError
            Naming the first sample that is not valid.
        """
        refuse(self.validity.reshape(-1), self.validity.shape)
        return self.q


def two_vector_quaternion(
    b1: Any,
    b2: Any,
    r1: Any,
    r2: Any,
    frame: Selection = "optimal",
    *,
    weights: Any = None,
    normalized: bool = False,
    length_tolerance: float = 0.5,
) -> Float[Array, "... 4"]:
    r"""Attitude from two vector observations in closed form, eq. (K1).

    Parameters
    ----------
    b1, b2 : array_like
        First and second vector in the body frame, (..., 3).
    r1, r2 : array_like
        The same vectors in the reference frame and the same unit, (..., 3); the
        leading axes broadcast.
    frame : {"optimal", "best", "combined", "plain", "x", "y", "z"}
        ``optimal``, the default, is the least-squares attitude of the four directions,
        Wahba's, by eq. (K3). ``best`` takes the greatest of the four columns of eq.
        (K2), ``combined`` all of them; these three are never singular. The others
        are one column: ``plain`` is eq. (8) of the source, the rest a half turn of the
        reference frame.
    weights : array_like, optional
        Weights of the two pairs, (2,) or (..., 2), above zero. With them every frame
        returns the weighted optimum of Wahba's problem, eq. (K4). The best weight is
        the inverse of the summed variances of b and r. Without `weights`, ``optimal``
        weighs both pairs equally, and the other frames use their formula as it is.
    normalized : bool, default False
        Normalise the vectors first, as ``optimal`` and `weights` always do, so that
        noise along a vector does not affect the answer. If False, the formula is the
        source's.
    length_tolerance : float, default 0.5
        Largest relative difference of length between a body vector and its
        reference vector; ``inf`` accepts any.

    Returns
    -------
    Array
        Unit quaternions, reference to body, vector first, (..., 4). The scalar is
        not negative for the first three frames; in a fixed frame the sign is the
        formula's own.

    Raises
    ------
    InputError
        If a shape is wrong, a component is not finite, a vector is zero, or the
        lengths disagree.
    GeometryError
        If the vectors are parallel, or the fixed frame is singular.

    Notes
    -----
    The answer is exact without noise. With noise of standard deviation sigma its error
    is of order sigma / |qbar|. `simval.theory.attitude_moments` predicts the error if
    you give it the same frame; for ``best`` there is no prediction.
    """
    estimate = estimate_attitude(
        b1,
        b2,
        r1,
        r2,
        frame,
        weights=weights,
        normalized=normalized,
        length_tolerance=length_tolerance,
    )
    return estimate.require_valid()


def estimate_attitude(
    b1: Any,
    b2: Any,
    r1: Any,
    r2: Any,
    frame: Selection = "optimal",
    *,
    weights: Any = None,
    normalized: bool = False,
    noise_std: Any = None,
    false_alarm: float = 1e-6,
    length_tolerance: float = 0.5,
) -> AttitudeEstimate:
    """`two_vector_quaternion` with a validity per sample instead of an error.

    Parameters
    ----------
    b1, b2 : array_like
        First and second vector in the body frame, (..., 3).
    r1, r2 : array_like
        The same vectors in the reference frame and the same unit, (..., 3).
    frame : {"optimal", "best", "combined", "plain", "x", "y", "z"}
        As in `two_vector_quaternion`.
    weights : array_like, optional
        As in `two_vector_quaternion`.
    normalized : bool, default False
        As in `two_vector_quaternion`. State it of vectors whose lengths mean nothing.
    noise_std : array_like, optional
        Noise of the unit vectors for each axis: one standard deviation, or four for b1,
        b2, r1, r2. With it, a sample whose pairs fit no common attitude, or whose body
        vectors have other lengths than their references, is not valid; the lengths do
        not count with `normalized`.
    false_alarm : float, default 1e-6
        Share of good samples that these tests together may refuse.
    length_tolerance : float, default 0.5
        As in `two_vector_quaternion`.

    Returns
    -------
    AttitudeEstimate
        Attitudes and validity; one bad sample leaves the others alone.

    Raises
    ------
    InputError
        If a shape or an option is wrong.
    """
    frame = choice("frame", frame, SELECTIONS)
    length_tolerance = _tolerance(length_tolerance)
    widest = widest_differences(noise_std, false_alarm)
    if switch("normalized", normalized):
        widest[1:] = np.inf  # the lengths are of no account
    arrays, shape = _flat_batch(b1, b2, r1, r2)
    count = arrays[0].shape[0]
    shares = None
    if weights is not None:
        shares = pair_weights(weights, (*shape, 2)).reshape(-1, 2).T
    q = np.empty((count, 4))
    validity: Codes = np.zeros(count, dtype=np.int8)
    block = np.empty((12, max(2, min(count, kernel.BLOCK))))
    for start in range(0, count, kernel.BLOCK):
        rows = slice(start, min(start + kernel.BLOCK, count))
        width = rows.stop - start
        # A single sample fills two columns: sums over rows of one column alone would
        # be ordered differently, and a sample's bits would depend on its company.
        vectors = block[:, : max(2, width)]
        for i, array in enumerate(arrays):
            vectors[3 * i : 3 * i + 3] = array[rows].T
        codes = _block_codes(vectors, length_tolerance, widest)
        fitted = frame == "optimal" or shares is not None
        if normalized or fitted:
            kernel.normalize_vectors(vectors)
        if fitted:
            kernel.fit_pairs(
                vectors, None if shares is None else _wide(shares[:, rows])
            )
        raw, scale, codes = _estimate_block(vectors, frame, codes)
        np.multiply(raw[:, :width], scale[:width], out=q[rows].T)
        if codes is not None:
            validity[rows] = codes[:width]
            q[rows][codes[:width] != 0] = np.nan
    return AttitudeEstimate(q=q.reshape(*shape, 4), validity=validity.reshape(shape))


def valid_batch(
    b1: Any, b2: Any, r1: Any, r2: Any, *, length_tolerance: float = 0.5
) -> tuple[list[Float[Array, "n 3"]], tuple[int, ...]]:
    """Flatten a batch of vector pairs, every sample of it valid.

    Raises
    ------
    InputError, GeometryError
        As `two_vector_quaternion`.
    """
    length_tolerance = _tolerance(length_tolerance)
    arrays, shape = _flat_batch(b1, b2, r1, r2)
    for start in range(0, len(arrays[0]), kernel.BLOCK):
        rows = slice(start, start + kernel.BLOCK)
        block = np.concatenate([array[rows].T for array in arrays])
        codes = block_validity(block, length_tolerance)
        if codes is not None:
            whole = np.zeros(len(arrays[0]), dtype=np.int8)
            whole[rows] = codes
            refuse(whole, shape)
    return arrays, shape


def _tolerance(value: Any) -> float:
    # of lengths: 0 or more, infinite to accept any
    unbounded = isinstance(value, float) and value == np.inf
    number = value if unbounded else real_number("length_tolerance", value, "or inf")
    if not number >= 0.0:
        msg = f"`length_tolerance` is {shown(value)}; it must be 0 or more"
        raise InputError(msg)
    return float(number)


def pair_weights(weights: Any, shape: tuple[int, ...]) -> Array:
    """Weights (..., n) of the pairs of samples; None is equal.

    Raises
    ------
    InputError
        If one is not above 0, or they are neither (n,) nor (..., n).
    """
    if weights is None:
        return np.ones(shape)
    value = finite_array("weights", weights, shape[-1:])
    bad = np.argwhere(~((value > 0.0) & (value <= GREATEST)))
    if len(bad):
        first = tuple(int(i) for i in bad[0])
        msg = (
            f"`weights` is {value[first]:g} at index {first}; each must be above 0 and "
            f"at most {GREATEST:g}"
        )
        raise InputError(msg)
    try:
        return np.broadcast_to(value, shape)
    except ValueError:
        msg = (
            f"`weights` has shape {value.shape}; give one for each pair, {shape[-1:]}, "
            f"or for each pair of each sample, {shape}"
        )
        raise InputError(msg) from None


def _block_codes(
    vectors: Array, length_tolerance: float, widest: Float[Array, "3"]
) -> Codes | None:
    # codes if any is bad, with a harmless sample in place of each bad one
    codes = block_validity(vectors, length_tolerance)
    if codes is not None:
        vectors[:, codes != 0] = _HARMLESS
    if widest.min() < np.inf:
        unit = vectors.copy()
        lengths = kernel.normalize_vectors(unit)
        off = [kernel.angle_difference(unit), *(lengths[:2] / lengths[2:] - 1.0)]
        apart = (np.abs(off) > widest[:, None]).any(axis=0)
        if apart.any():
            codes = np.zeros(apart.shape, dtype=np.int8) if codes is None else codes
            codes[apart] = Validity.INCONSISTENT
            vectors[:, apart] = _HARMLESS
    return codes


def _estimate_block(
    vectors: Float[Array, "12 n"], frame: str, codes: Codes | None
) -> tuple[Float[Array, "4 n"], Float[Array, " n"], Codes | None]:
    # un-normalised quaternions (4, n), what to multiply them with, codes if any is bad
    if frame in ("optimal", "best"):
        raw = kernel.best_quaternion(kernel.column_matrix(vectors, symmetric=False))
    elif frame == "combined":
        raw = kernel.combined_quaternion(kernel.column_matrix(vectors, symmetric=True))
    else:
        raw = kernel.raw_quaternion(vectors, frame)
    squared = kernel.squared_norm(raw)
    if frame not in kernel.FRAMES:
        return raw, np.copysign(1.0 / np.sqrt(squared), raw[3]), codes
    singular = singular_columns(vectors, squared)
    if singular is not None:
        codes = np.zeros(squared.shape, dtype=np.int8) if codes is None else codes
        codes[singular & (codes == 0)] = Validity.SINGULAR
        squared[singular] = 1.0
    return raw, 1.0 / np.sqrt(squared), codes


def _wide(shares: Float[Array, "2 n"]) -> Float[Array, "2 m"]:
    # those of a single sample twice, as its vectors are
    return shares if shares.shape[1] > 1 else np.repeat(shares, 2, axis=1)


# a turn of 120 degrees about (1, 1, 1), regular in every frame: all |qbar| are 1/2
_HARMLESS = np.array([1.0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 1]).reshape(12, 1)


def _flat_batch(*values: Any) -> tuple[list[Float[Array, "n 3"]], tuple[int, ...]]:
    # Arrays of shape (n, 3) with a common batch, and the batch's shape
    names = ("b1", "b2", "r1", "r2")
    arrays = [
        shaped_array(name, value, (3,))
        for name, value in zip(names, values, strict=True)
    ]
    try:
        shape = np.broadcast_shapes(*(array.shape for array in arrays))[:-1]
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        msg = (
            f"b1, b2, r1, r2 have shapes {shapes}; their leading axes do not "
            "match, so give one vector for each sample, or one for all"
        )
        raise InputError(msg) from None
    count = int(np.prod(shape))
    flat = [
        np.broadcast_to(a, (count, 3))
        if a.ndim == 1
        else np.broadcast_to(a, (*shape, 3)).reshape(count, 3)
        for a in arrays
    ]
    return flat, shape
