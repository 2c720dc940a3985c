r"""Second-order moments of the quaternion errors, source eqs. (50) to (65).

P is the covariance of the scaled error :math:`\Delta\check q`, eq. (62),
:math:`\Pi = I - q q^T` and :math:`Q = I - 3 q q^T`. Nothing here is special to the
estimator but P itself, and no distribution is assumed; an error of mean zero is.
"""

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.theory.errors_exact import multiplicative_matrix
from simval.theory.expansion import half_noise, linear_maps
from simval.theory.two_vector import TwoVectorGeometry


def unnormalized_covariance(
    geometry: TwoVectorGeometry, noise: Float[Array, "4 3 3"]
) -> Float[Array, "4 4"]:
    r"""First-order covariance of :math:`\Delta\bar q`, source eqs. (54) to (60).

    Eq. (60) is printed without the correlation of s1 and d1, which is
    :math:`(P_{b1} - P_{r1})/4`; this has it.
    """
    J1, J2 = linear_maps(geometry)
    C1, C2 = half_noise(geometry, noise)
    return geometry.norm**2 * (J1 @ C1 @ J1.T + J2 @ C2 @ J2.T)


def isotropic_unnormalized_covariance(
    geometry: TwoVectorGeometry, noise_std: float
) -> Float[Array, "4 4"]:
    r"""Covariance of :math:`\Delta\bar q`, equal isotropic noise, source eq. (61)."""
    d1, d2, s1 = geometry.d1, geometry.d2, geometry.s1
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = (d1 @ d1 + d2 @ d2) * np.eye(3)
    covariance[:3, :3] -= np.outer(d1, d1) + np.outer(d2, d2)
    covariance[:3, 3] = covariance[3, :3] = np.cross(d1, s1)
    covariance[3, 3] = d2 @ d2 + s1 @ s1
    return 0.5 * noise_std**2 * covariance


def tangent_projector(q: Float[Array, "4"]) -> Float[Array, "4 4"]:
    r"""Projector :math:`\Pi = I - q q^T` onto the plane tangent to the sphere at q."""
    return np.eye(4) - np.outer(q, q)


def normalization_matrix(q: Float[Array, "4"]) -> Float[Array, "4 4"]:
    """Matrix Q of source eq. (50)."""
    return np.eye(4) - 3.0 * np.outer(q, q)


def mean_norm_ratio(q: Float[Array, "4"], P: Float[Array, "4 4"]) -> float:
    """Mean of the ratio nu of the norms, source eq. (51)."""
    return 1.0 - 0.5 * float(np.trace(normalization_matrix(q) @ P))


def second_order_bias(
    q: Float[Array, "4"], P: Float[Array, "4 4"]
) -> Float[Array, "4"]:
    """Mean of q - qhat, source eq. (52)."""
    half_trace = 0.5 * np.trace(normalization_matrix(q) @ P)
    bias: Array = P @ q + half_trace * q
    return bias


def second_order_covariance(
    q: Float[Array, "4"], P: Float[Array, "4 4"]
) -> Float[Array, "4 4"]:
    """Covariance of q - qhat, source eq. (63) without its last term."""
    projector = tangent_projector(q)
    covariance: Array = projector @ P @ projector
    return covariance


def second_order_second_moment(
    q: Float[Array, "4"], P: Float[Array, "4 4"]
) -> Float[Array, "4 4"]:
    """Mean square of q - qhat, source eqs. (63) and (65) as printed.

    The source calls it the covariance; its last term, bias times bias', makes it the
    second moment about zero.
    """
    bias = second_order_bias(q, P)
    return second_order_covariance(q, P) + np.outer(bias, bias)


def multiplicative_bias(
    q: Float[Array, "4"], bias: Float[Array, "4"]
) -> Float[Array, "4"]:
    """Mean of q^-1 * qhat, source eq. (53), from that of q - qhat."""
    mean: Array = multiplicative_matrix(q) @ bias + np.array([0.0, 0.0, 0.0, 1.0])
    return mean


def multiplicative_covariance(
    q: Float[Array, "4"], covariance: Float[Array, "4 4"]
) -> Float[Array, "4 4"]:
    """Covariance of q^-1 * qhat, source eq. (64), from that of q - qhat."""
    M = multiplicative_matrix(q)
    rotated: Array = M @ covariance @ M.T
    return rotated
