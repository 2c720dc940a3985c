r"""Attitude from two or more weighted vector pairs: Wahba's problem, batched.

The weighted least-squares attitude minimises

.. math:: L(q) = \tfrac12 \sum_i a_i |b_i - A(q) r_i|^2
   = \sum_i a_i - q^T K q  \tag{W1}

over unit vectors, so q is the eigenvector of the greatest eigenvalue of Davenport's K
(Wahba 1965; Keat 1977). With :math:`a_i = 1/\sigma_i^2` and
:math:`\sigma_i^2 = \sigma_{bi}^2 + \sigma_{ri}^2` it is the maximum-likelihood estimate
for isotropic noise. The first-order covariance of its error in body axes is

.. math:: M^{-1} \Big(\sum_i a_i^2 \sigma_i^2 (I - b_i b_i^T)\Big) M^{-1}, \quad
   M = \sum_i a_i (I - b_i b_i^T),  \tag{W2}

which is :math:`M^{-1}` for those weights (Shuster and Oh 1981), and twice the smallest
loss is then chi-square with :math:`2n - 3` degrees of freedom, two for each direction
less the three of the attitude (Shuster's TASTE test).
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy

from simval.arrays import LEAST, Array, finite_array, outer, shaped_array
from simval.errors import InputError
from simval.geometry import attitude_matrix, cross, normalize
from simval.imu.attitude.estimator import (
    LENGTHS,
    MIN_SINE,
    AttitudeEstimate,
    Codes,
    Mask,
    Validity,
    estimate_attitude,
    pair_weights,
    refuse,
    share_of_samples,
)
from simval.shapes import Float
from simval.text import shown

# Rounding turns q by eps times the sum of the weights over the gap of the eigenvalues.
MIN_GAP: Final = 1e-12
INSTEAD: Final = "wahba_estimate"
_SPREAD: Final = 1e9  # of standard deviations; their fourth powers stay in range


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Consistency:
    """Consistency of the pairs of each sample with one attitude and the stated noise.

    Attributes
    ----------
    statistic : Array
        Twice Wahba's loss at its minimum, with the inverse variances as weights, (...).
    freedom : int
        Degrees of freedom of its chi-square law, 2n - 3.
    probability : Array
        Probability of a greater statistic if the stated noise is all there is, (...).
    """

    statistic: Float[Array, "..."]
    freedom: int
    probability: Float[Array, "..."]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WahbaEstimate(AttitudeEstimate):
    """Attitudes of a batch from n pairs, with the validity of each sample.

    Attributes
    ----------
    covariance : Array or None
        First-order covariance of the rotation error in body axes, rad^2, (..., 3, 3);
        NaN where the sample is not valid, None without `noise_std`.
    consistency : Consistency or None
        Test of each sample; NaN where it cannot be made, None without `noise_std`.
    """

    covariance: Float[Array, "... 3 3"] | None
    consistency: Consistency | None


def wahba_quaternion(b: Any, r: Any, weights: Any = None) -> Float[Array, "... 4"]:
    """Weighted least-squares attitude from n >= 2 vector pairs, eq. (W1).

    Parameters
    ----------
    b : array_like
        Vectors in the body frame, (..., n, 3).
    r : array_like
        The same vectors in the reference frame, (..., n, 3); leading axes broadcast.
        All are normalised, so that pairs in different units weigh what `weights` say.
    weights : array_like, optional
        Weight of each pair, (n,) or (..., n), above zero; default equal. The inverse
        of the summed variances of b and r is best.

    Returns
    -------
    Array
        Unit quaternions, reference to body, vector first, (..., 4); the scalar is not
        negative.

    Raises
    ------
    InputError
        If a shape or a value is wrong.
    GeometryError
        If the vectors of a sample do not fix the attitude.
    """
    estimate = wahba_estimate(b, r, weights)
    refuse(estimate.validity.reshape(-1), estimate.validity.shape, INSTEAD)
    return estimate.q


def wahba_estimate(
    b: Any,
    r: Any,
    weights: Any = None,
    *,
    noise_std: Any = None,
    false_alarm: float = 1e-6,
) -> WahbaEstimate:
    """`wahba_quaternion` with a validity per sample instead of an error.

    With the noise it is `wahba_covariance` and `consistency` of each sample too.

    Parameters
    ----------
    b : array_like
        Vectors in the body frame, (..., n, 3).
    r : array_like
        The same vectors in the reference frame, (..., n, 3).
    weights : array_like, optional
        As in `wahba_quaternion`; default the inverse variances if there is
        `noise_std`, else equal.
    noise_std : array_like, optional
        As in `wahba_covariance`. With it, a sample whose pairs fit no common attitude
        is not valid.
    false_alarm : float, default 1e-6
        Share of good samples that this test may refuse.

    Returns
    -------
    WahbaEstimate
        Attitudes and validity; one bad sample leaves the others alone.

    Raises
    ------
    InputError
        If a shape, a weight, the noise or the share is wrong.
    """
    rate = share_of_samples(false_alarm)
    body, reference, codes = _pairs(b, r)
    if noise_std is None:
        q, close = _optimum(body, reference, pair_weights(weights, body.shape[:-1]))
        covariance = tested = None
    else:
        variance = _variances(noise_std, body.shape[-2])
        a = (
            1.0 / variance
            if weights is None
            else pair_weights(weights, body.shape[:-1])
        )
        q, close = _optimum(body, reference, a)
        covariance = _first_order(body, a, variance)
        tested, ambiguous = _tested(body, reference, variance)
        close |= ambiguous
    codes[(codes == 0) & close] = Validity.AMBIGUOUS
    if covariance is not None and tested is not None:
        tested.statistic[codes != 0] = tested.probability[codes != 0] = np.nan
        codes[tested.probability < rate] = Validity.INCONSISTENT
        covariance[codes != 0] = np.nan
    q[codes != 0] = np.nan
    return WahbaEstimate(q=q, validity=codes, covariance=covariance, consistency=tested)


def wahba_covariance(
    b: Any, r: Any, noise_std: Any, weights: Any = None
) -> Float[Array, "... 3 3"]:
    """First-order covariance of `wahba_quaternion` from measured vectors, eq. (W2).

    Parameters
    ----------
    b : array_like
        Vectors in the body frame, (..., n, 3).
    r : array_like
        The same vectors in the reference frame, (..., n, 3).
    noise_std : array_like
        Standard deviation for each axis of the unit vectors: one number, or (2, n) for
        b and r. A reference without noise has 0.
    weights : array_like, optional
        As in `wahba_quaternion`; default the inverse variances.

    Returns
    -------
    Array
        Covariance of the rotation error in body axes, rad^2, (..., 3, 3).

    Raises
    ------
    InputError
        If a shape or a value is wrong.
    GeometryError
        If the vectors of a sample do not fix the attitude.
    """
    body, _, codes = _pairs(b, r)
    refuse(codes.reshape(-1), codes.shape, INSTEAD)
    variance = _variances(noise_std, body.shape[-2])
    a = 1.0 / variance if weights is None else pair_weights(weights, body.shape[:-1])
    return _first_order(body, a, variance)


def consistency(b: Any, r: Any, noise_std: Any) -> Consistency:
    """Test whether the pairs of each sample fit one attitude: Shuster's TASTE.

    A wrong star, a disturbed magnetometer or the Moon taken for the Sun turns the
    angles between body vectors away from those of the reference by more than noise.

    Parameters
    ----------
    b : array_like
        Vectors in the body frame, (..., n, 3), n >= 2.
    r : array_like
        The same vectors in the reference frame, (..., n, 3).
    noise_std : array_like
        As in `wahba_covariance`.

    Returns
    -------
    Consistency
        Statistic, degrees of freedom and probability of each sample.

    Raises
    ------
    InputError
        If a shape or a value is wrong.
    GeometryError
        If the vectors of a sample do not fix the attitude.

    Notes
    -----
    First order in the noise, which must be small against one radian.
    """
    body, reference, codes = _pairs(b, r)
    tested, close = _tested(body, reference, _variances(noise_std, body.shape[-2]))
    codes[(codes == 0) & close] = Validity.AMBIGUOUS
    refuse(codes.reshape(-1), codes.shape, INSTEAD)
    return tested


def profile_matrix(
    b: Float[Array, "... n 3"],
    r: Float[Array, "... n 3"],
    weights: Float[Array, "... n"],
) -> Float[Array, "... 4 4"]:
    """Davenport's K: `q' K q` is the weighted sum of `b' A(q) r`."""
    profile = np.einsum("...n,...ni,...nj->...ij", weights, b, r)
    trace = np.linalg.trace(profile)
    K = np.empty((*profile.shape[:-2], 4, 4))
    K[..., :3, :3] = profile + profile.swapaxes(-1, -2)
    K[..., [0, 1, 2], [0, 1, 2]] -= trace[..., None]
    turn = np.sum(weights[..., None] * cross(b, r), axis=-2)
    K[..., :3, 3] = K[..., 3, :3] = turn
    K[..., 3, 3] = trace
    return K


def _optimum(
    body: Array, reference: Array, weights: Array
) -> tuple[Float[Array, "... 4"], Mask]:
    # the top eigenvector, and where the next eigenvalue is too close. Of two pairs by
    # (K3): rounding then costs eps over the sine between them, not over its square
    if body.shape[-2] == 2:
        shares = np.maximum(weights / weights.max(axis=-1, keepdims=True), LEAST)
        (b1, b2), (r1, r2) = (np.moveaxis(v, -2, 0) for v in (body, reference))
        found = estimate_attitude(b1, b2, r1, r2, weights=shares)
        return found.q, np.asarray(~found.valid)
    values, vectors = np.linalg.eigh(profile_matrix(body, reference, weights))
    gap = (values[..., 3] - values[..., 2]) / np.sum(weights, axis=-1)
    q = vectors[..., 3]
    return np.where(q[..., 3:] < 0.0, -q, q), np.asarray(~(gap >= MIN_GAP))


def _first_order(body: Array, a: Array, variance: Array) -> Float[Array, "... 3 3"]:
    # covariance (W2) for weights a
    planes = np.eye(3) - outer(body, body)
    M = np.sum(a[..., None, None] * planes, axis=-3)
    spread = np.sum((a**2 * variance)[..., None, None] * planes, axis=-3)
    inverse = np.linalg.inv(M)
    covariance = inverse @ spread @ inverse
    result: Array = (covariance + covariance.swapaxes(-1, -2)) / 2.0
    return result


def _tested(body: Array, reference: Array, variance: Array) -> tuple[Consistency, Mask]:
    # the test of each sample, and where it cannot be made
    n, a = body.shape[-2], 1.0 / variance
    q, close = _optimum(body, reference, np.broadcast_to(a, body.shape[:-1]))
    residual = body - np.matvec(attitude_matrix(q)[..., None, :, :], reference)
    # of unit vectors the residual has no part along b to first order
    statistic = np.asarray(np.sum(a * np.sum(residual**2, axis=-1), axis=-1))
    probability = np.asarray(scipy.special.chdtrc(2 * n - 3, statistic))
    tested = Consistency(
        statistic=statistic, freedom=2 * n - 3, probability=probability
    )
    return tested, close


def _pairs(b: Any, r: Any) -> tuple[Array, Array, Codes]:
    # unit vectors, harmless ones in a sample that cannot be used, and validities
    body, reference = shaped_array("b", b, (None, 3)), shaped_array("r", r, (None, 3))
    n = body.shape[-2]
    if reference.shape[-2] != n or n < 2:
        msg = (
            f"`b` has {n} vectors and `r` {reference.shape[-2]}; give the same number "
            "of both, two or more"
        )
        raise InputError(msg)
    try:
        shape = np.broadcast_shapes(body.shape, reference.shape)
    except ValueError:
        msg = (
            f"`b` has shape {body.shape} and `r` has {reference.shape}; their "
            "leading axes do not match, so give one set for each sample, or "
            "one for all"
        )
        raise InputError(msg) from None
    codes: Codes = np.zeros(shape[:-2], dtype=np.int8)
    # of what is one for all samples once
    checked = [_unit_vectors(vectors) for vectors in (body, reference)]
    units, flaws = zip(*checked, strict=True)
    for code in flaws[0]:
        codes[np.broadcast_to(flaws[0][code] | flaws[1][code], codes.shape)] = code
    unit = [np.broadcast_to(each, shape) for each in units]
    if codes.any():
        unit = [each.copy() for each in unit]
        for each in unit:
            each[codes != 0] = np.eye(3)[np.arange(n) % 3]
    return unit[0], unit[1], codes


def _unit_vectors(vectors: Float[Array, "... n 3"]) -> tuple[Array, dict[int, Any]]:
    # and where they cannot be used, the gravest reason last
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        lengths = np.linalg.norm(vectors, axis=-1)
    inside = (lengths > LENGTHS[0]) & (lengths < LENGTHS[1])
    unit = normalize(np.where(inside[..., None], vectors, 1.0))
    sines = np.linalg.norm(cross(unit[..., :1, :], unit), axis=-1).max(axis=-1)
    return unit, {
        Validity.COLLINEAR: ~(sines >= MIN_SINE),
        Validity.LENGTH: ~inside.all(axis=-1),
        Validity.NOT_FINITE: ~np.isfinite(vectors).all(axis=(-1, -2)),
    }


def _variances(noise_std: Any, n: int) -> Float[Array, " n"]:
    # of b and r together, for each pair
    std = finite_array("noise_std", noise_std, ())
    if std.shape not in ((), (2, n)):
        msg = (
            f"`noise_std` has shape {std.shape}; give one number, or (2, {n}): a row "
            "for b and one for r"
        )
        raise InputError(msg)
    std = np.broadcast_to(std, (2, n))
    total = np.hypot(std[0], std[1])
    least, most = total.min(), total.max()
    if not (
        np.all(std >= 0.0) and least >= LEAST and most <= min(1.0, _SPREAD * least)
    ):
        msg = (
            f"`noise_std` is {shown(noise_std)}; the noise of each pair must be above "
            f"0, below 1 (the vectors have length 1), and within a factor {_SPREAD:g}"
        )
        raise InputError(msg)
    variances: Array = total**2
    return variances
