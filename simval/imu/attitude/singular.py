r"""Singular cases of the closed form: direct solutions and sequential rotations.

Without noise :math:`\bar q = (e^T n) q`, :math:`n = r_1 \times r_2`, so the formula is
singular exactly when the rotation axis lies in the plane of r1 and r2, or the angle is
zero. The source's Table 1 splits that set:

====  ===============================  ==========================================
case  sign                             rotation
====  ===============================  ==========================================
A     :math:`d_1 = d_2 = 0`            none
B     :math:`d_1 = 0`                  about r1
C     :math:`d_2 = 0`                  about r2
D     :math:`d_1 \times d_2 = 0`       about another axis u in the plane
====  ===============================  ==========================================

In each the axis is normal to n, so the attitude is the smallest rotation that takes
the unit normal :math:`r_3` to :math:`b_3`, with half difference and sum d3 and s3,

.. math:: q = [d_3 \times s_3/|s_3|;\ |s_3|] = [\pm u\, |d_3|;\ |s_3|],  \tag{D1}

the sign that of :math:`u^T (b_3 \times r_3)`. The first form fails at a half turn; the
second needs the axis: r1, r2, or in case D the direction of :math:`d \times n`, d the
longer of d1 and d2. The source prints the second form for B and C without the sign
(eqs. 21, 23), and for D only the axis :math:`b_3 \times r_3`, which vanishes at a half
turn (eq. 25).
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arguments import whole_number
from simval.arrays import Array, real_number
from simval.errors import InputError
from simval.geometry import cross, normalize
from simval.imu.attitude import kernel
from simval.imu.attitude.estimator import MIN_NORM, Mask, valid_batch
from simval.shapes import Bool, Float, Int
from simval.text import shown


class Case(IntEnum):
    """Singular case of the plain formula, Table 1 of the source."""

    REGULAR = 0
    A = 1
    B = 2
    C = 3
    D = 4


# a share of the lengths; the direct solutions are off by as much, over the sine of the
# angle between the vectors
TOLERANCE: Final = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SingularSolution:
    """Direct solutions for the samples that are singular.

    Attributes
    ----------
    q : Array
        Unit quaternions with a scalar that is not negative, (..., 4); NaN where the
        sample is regular, because no direct solution holds there.
    case : Array
        Codes of `Case`, (...).
    """

    q: Float[Array, "... 4"]
    case: Int[NDArray[np.intp], "..."]

    @property
    def valid(self) -> Mask:
        """Mask of singular samples, for which the solution holds, (...)."""
        mask: Mask = self.case != Case.REGULAR
        return mask


def singular_solution(
    b1: Any, b2: Any, r1: Any, r2: Any, tolerance: float = TOLERANCE
) -> SingularSolution:
    """Classify each sample by Table 1 and solve the singular ones by (D1).

    Parameters
    ----------
    b1, b2 : array_like
        Body vectors, (..., 3).
    r1, r2 : array_like
        Reference vectors, (..., 3).
    tolerance : float, default 1e-12
        How far from singular, as a share of the lengths, still counts as singular.

    Returns
    -------
    SingularSolution
        Attitudes and cases.

    Raises
    ------
    InputError, GeometryError
        As `two_vector_quaternion`; also if the tolerance is not in (0, 1).
    """
    vectors, shape = valid_batch(b1, b2, r1, r2)
    q, case = _direct(vectors, tolerance)
    return SingularSolution(q=q.reshape(*shape, 4), case=case.reshape(shape))


def _direct(
    vectors: list[Float[Array, "n 3"]], tolerance: Any
) -> tuple[Float[Array, "n 4"], Int[NDArray[np.intp], " n"]]:
    # direct solutions, NaN where the sample is regular, and cases
    _require_tolerance(tolerance)
    v1, v2, u1, u2 = map(normalize, vectors)
    d1, d2 = (v1 - u1) / 2, (v2 - u2) / 2
    singular = _plain_norm(v1, u1, d1, d2) <= tolerance * _norm(cross(u1, u2))
    case = _classify(d1, d2, singular, tolerance)
    q = np.full((len(case), 4), np.nan)
    some = np.flatnonzero(case[:, 0] != Case.REGULAR)
    own, u1, u2, d1, d2 = case[some], u1[some], u2[some], d1[some], d2[some]
    r3, b3 = normalize(cross(u1, u2)), normalize(cross(v1[some], v2[some]))
    d3, s3 = (b3 - r3) / 2, (b3 + r3) / 2
    axis = cross(np.where(_norm(d1) >= _norm(d2), d1, d2), r3)
    axis = np.where(own == Case.B, u1, np.where(own == Case.C, u2, axis))
    signed = np.copysign(_norm(d3), np.sum(axis * cross(b3, r3), axis=1)[:, None])
    near_half_turn = signed * axis / _safe(_norm(axis))
    small = cross(d3, s3) / _safe(_norm(s3))
    vector = np.where(_norm(s3) >= _norm(d3), small, near_half_turn)
    q[some] = np.concatenate([vector, _norm(s3)], axis=1)
    q[case[:, 0] == Case.A] = [0.0, 0.0, 0.0, 1.0]
    return q, case[:, 0]


def case_quaternion(
    b1: Any, b2: Any, r1: Any, r2: Any, tolerance: float = MIN_NORM
) -> Float[Array, "... 4"]:
    r"""Attitude by Table 1: directly where singular, else by the plain formula.

    Parameters
    ----------
    b1, b2 : array_like
        Body vectors, (..., 3).
    r1, r2 : array_like
        Reference vectors, (..., 3).
    tolerance : float, default 1e-8
        Border of the singular cases, as in `singular_solution`: by default where what
        the direct solution leaves out is as large as the rounding of the plain formula.

    Returns
    -------
    Array
        Unit quaternions, reference to body, vector first, (..., 4); the scalar is not
        negative.

    Raises
    ------
    InputError, GeometryError
        As `two_vector_quaternion`; also if the tolerance is not in (0, 1).

    Notes
    -----
    Not continuous: at the border the direct solution lacks the turn about
    :math:`r_1 \times r_2`, whose half angle has the sine tolerance over the scalar of
    the singular attitude. With noise it is no more accurate than the plain formula is
    just beyond the border (study `attitude_singular`).
    """
    vectors, shape = valid_batch(b1, b2, r1, r2)
    direct, case = _direct(vectors, tolerance)
    raw = kernel.raw_quaternion(np.stack([v.T for v in vectors]), "plain")
    length = np.sqrt(kernel.squared_norm(raw))
    plain = (raw / np.copysign(np.where(length > 0.0, length, 1.0), raw[3])).T
    q = np.where((case != Case.REGULAR)[:, None], direct, plain)
    return q.reshape(*shape, 4)


def _require_tolerance(value: Any) -> None:
    if not 0.0 < real_number("tolerance", value, "") < 1.0:
        msg = f"`tolerance` is {shown(value)}; it must be between 0 and 1"
        raise InputError(msg)


def _norm(v: Float[Array, "n 3"]) -> Float[Array, "n 1"]:
    length: Array = np.linalg.norm(v, axis=1, keepdims=True)
    return length


def _safe(length: Float[Array, "n 1"]) -> Float[Array, "n 1"]:
    return np.where(length > 0.0, length, 1.0)


def _plain_norm(
    v1: Float[Array, "n 3"],
    u1: Float[Array, "n 3"],
    d1: Float[Array, "n 3"],
    d2: Float[Array, "n 3"],
) -> Float[Array, "n 1"]:
    # |qbar| = |e.n|: the part of the rotation vector along n is what a direct solution
    # leaves out. Not |d1 x d2| = |e.n| |e|, which vanishes for any small rotation.
    scalar = np.sum((v1 + u1) * d2, axis=1, keepdims=True) / 2
    return np.hypot(_norm(cross(d1, d2)), scalar)


def _classify(
    d1: Float[Array, "n 3"],
    d2: Float[Array, "n 3"],
    singular: Bool[Mask, "n 1"],
    tolerance: float,
) -> Int[NDArray[np.intp], "n 1"]:
    zero1, zero2 = _norm(d1) <= tolerance, _norm(d2) <= tolerance
    case = np.where(singular, Case.D, Case.REGULAR)
    case = np.where(zero1, Case.B, np.where(zero2, Case.C, case))
    return np.where(zero1 & zero2, Case.A, case)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SequentialEstimate:
    """Attitudes by sequential rotations, and which turn each sample took.

    Attributes
    ----------
    q : Array
        Unit quaternions with the raw sign of the frame, (..., 4).
    turn : Array
        0 for none, 1, 2, 3 for a half turn of the reference about x, y, z, (...).
    """

    q: Float[Array, "... 4"]
    turn: Int[NDArray[np.intp], "..."]


def sequential_quaternion(
    b1: Any, b2: Any, r1: Any, r2: Any, threshold: float = 0.5
) -> SequentialEstimate:
    r"""Attitude by the first frame that is far enough from singular.

    The source's sequential rotations (its section 3.1): keep the reference frame if
    :math:`|\bar q| \ge` threshold times :math:`|r_1 \times r_2|`, else try half turns
    about x, y and z in this order.

    Parameters
    ----------
    b1, b2 : array_like
        Body vectors, (..., 3).
    r1, r2 : array_like
        Reference vectors, (..., 3).
    threshold : float, default 0.5
        Above 0, at most 0.5, which some frame always reaches without noise.

    Returns
    -------
    SequentialEstimate
        Attitudes and the turns taken; where noise keeps all four frames below the
        threshold, the best of them.

    Raises
    ------
    InputError, GeometryError
        As `two_vector_quaternion`; also if the threshold is out of range.
    """
    if not 0.0 < real_number("threshold", threshold, "") <= 0.5:
        msg = f"`threshold` is {shown(threshold)}; it must be above 0 and at most 0.5"
        raise InputError(msg)
    vectors, shape = valid_batch(b1, b2, r1, r2)
    columns = kernel.column_matrix(np.stack([v.T for v in vectors]), symmetric=False)
    columns = columns[[3, 0, 1, 2]]
    norms = np.linalg.norm(columns, axis=1)
    reached = norms >= threshold * np.linalg.norm(cross(vectors[2], vectors[3]), axis=1)
    turn = np.where(reached.any(axis=0), reached.argmax(axis=0), norms.argmax(axis=0))
    chosen = np.arange(turn.size)
    q = columns[turn, :, chosen] / norms[turn, chosen][:, None]
    return SequentialEstimate(q=q.reshape(*shape, 4), turn=turn.reshape(shape))


def turn_is_singular(
    b1: Any, b2: Any, r1: Any, r2: Any, axis: int, tolerance: float = TOLERANCE
) -> Mask:
    r"""Validity criterion of a half turn about an axis, source Table 2.

    One criterion covers the four cases: the turned differences
    :math:`d_i + P_k r_i`, with :math:`P_k r` the part of r normal to the axis, are
    parallel or zero. It is the table's for case D; for A, B and C the table prints it
    with :math:`d_i = 0` put in, for B and C with AND where OR is right, and with a
    free constant k that has to be 1. It is measured by :math:`|\bar q|` of the turned
    problem, which vanishes with the cross product of the two differences.

    Parameters
    ----------
    b1, b2 : array_like
        Body vectors, (..., 3).
    r1, r2 : array_like
        Reference vectors, (..., 3).
    axis : int
        0, 1 or 2: x, y or z.
    tolerance : float, default 1e-12
        How close to parallel, as a share of :math:`|r_1 \times r_2|`.

    Returns
    -------
    Array
        Booleans: the turned problem is singular too, (...).

    Raises
    ------
    InputError, GeometryError
        As `two_vector_quaternion`; also if the axis is out of range.
    """
    axis = whole_number("axis", axis, 0, 2)
    _require_tolerance(tolerance)
    (v1, v2, u1, u2), shape = valid_batch(b1, b2, r1, r2)
    across = np.arange(3) != axis
    d1 = (v1 - u1) / 2 + across * u1
    d2 = (v2 - u2) / 2 + across * u2
    qbar = _plain_norm(v1, u1 - 2.0 * across * u1, d1, d2)
    singular: Mask = (qbar <= tolerance * _norm(cross(u1, u2)))[:, 0]
    return singular.reshape(shape)
