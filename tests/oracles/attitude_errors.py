r"""The errors of the quaternion estimate as the source writes them, eqs. (31) to (65).

Definitions, Peng and Choukroun eqs. (31) to (37), for the true :math:`\bar q^t` and
the estimate :math:`\bar q`, :math:`q = \bar q^t/|\bar q^t|`:

.. math:: \Delta\bar q = \bar q^t - \bar q,\quad
   \Delta\check q = \Delta\bar q/|\bar q^t|,\quad
   \Delta\hat q = q - \hat q,\quad \delta\hat q = q^{-1} * \hat q,

un-normalised, scaled, normalised and multiplicative. Eq. (38) is printed with the
scalar part of the composition negated; eqs. (45) to (47) need the usual one, which
`simval.geometry.compose` is.
"""

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.geometry import cross_matrix
from simval.theory.two_vector import TwoVectorGeometry


def unnormalized_error(
    true: tuple[Array, Array, Array], noise: tuple[Array, Array, Array]
) -> Float[Array, "... 4"]:
    """Error of qbar, exact, source eq. (39)."""
    d1, s1, d2 = true
    dd1, ds1, dd2 = noise
    vector = np.cross(d2, dd1) - np.cross(d1, dd2) - np.cross(dd1, dd2)
    scalar = -np.sum(d2 * ds1 + s1 * dd2 + ds1 * dd2, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def half_errors(
    db1: Float[Array, "... 3"],
    db2: Float[Array, "... 3"],
    dr1: Float[Array, "... 3"],
    dr2: Float[Array, "... 3"],
) -> tuple[Float[Array, "... 3"], Float[Array, "... 3"], Float[Array, "... 3"]]:
    """Errors of d1, s1 and d2 from those of the vectors, source eqs. (40), (41)."""
    return (db1 - dr1) / 2, (db1 + dr1) / 2, (db2 - dr2) / 2


def norm_ratio(
    q: Float[Array, "... 4"], scaled: Float[Array, "... 4"]
) -> Float[Array, "..."]:
    """True over measured length of qbar, exact, source eqs. (42), (43)."""
    along = np.sum(q * scaled, axis=-1)
    return 1.0 / np.sqrt(1.0 - 2.0 * along + np.sum(scaled * scaled, axis=-1))


def norm_ratio_second_order(
    q: Float[Array, "... 4"], scaled: Float[Array, "... 4"]
) -> Float[Array, "..."]:
    """True over measured length of qbar to second order, source eqs. (48), (50)."""
    along = np.sum(q * scaled, axis=-1)
    return 1.0 + along - 0.5 * np.sum(scaled * scaled, axis=-1) + 1.5 * along**2


def normalized_error(
    q: Float[Array, "... 4"], scaled: Float[Array, "... 4"]
) -> Float[Array, "... 4"]:
    """Error of the normalised estimate, exact, source eq. (44)."""
    nu = norm_ratio(q, scaled)[..., None]
    return nu * scaled + (1.0 - nu) * q


def normalized_error_second_order(
    q: Float[Array, "... 4"], scaled: Float[Array, "... 4"]
) -> Float[Array, "... 4"]:
    """Error of the normalised estimate to second order, source eq. (49)."""
    along = np.sum(q * scaled, axis=-1, keepdims=True)
    squared = np.sum(scaled * scaled, axis=-1, keepdims=True)
    radial = -along + 0.5 * squared - 1.5 * along**2
    return (1.0 + along) * scaled + radial * q


def multiplicative_matrix(q: Float[Array, "... 4"]) -> Float[Array, "... 4 4"]:
    """Matrix M with q^-1 * v = -M v, source eq. (47)."""
    e, s = q[..., :3], q[..., 3]
    M = np.empty((*q.shape[:-1], 4, 4))
    M[..., :3, :3] = cross_matrix(e) - s[..., None, None] * np.eye(3)
    M[..., :3, 3] = e
    M[..., 3, :3] = -e
    M[..., 3, 3] = -s
    return M


def multiplicative_error(
    q: Float[Array, "... 4"], normalized: Float[Array, "... 4"]
) -> Float[Array, "... 4"]:
    """Multiplicative error from the additive one, exact, source eqs. (45), (46)."""
    rotated = np.einsum("...ij,...j->...i", multiplicative_matrix(q), normalized)
    return rotated + np.array([0.0, 0.0, 0.0, 1.0])


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


def mean_norm_ratio(q: Float[Array, "4"], P: Float[Array, "4 4"]) -> float:
    """Mean of the ratio nu of the norms, source eq. (51)."""
    return 1.0 - 0.5 * float(np.trace((np.eye(4) - 3.0 * np.outer(q, q)) @ P))


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


def paper_fourth_terms(
    q: Float[Array, "4"], P: Float[Array, "4 4"]
) -> Float[Array, "6 4 4"]:
    r"""Terms 1 to 6 of source section 5, each by Isserlis' theorem.

    They are the products of :math:`u x`, :math:`r q/2` and :math:`-3u^2 q/2` in pairs;
    Terms 2 and 3 are made symmetric, which the source's are not. Their sum less the
    mean times its transpose is `quadratic_covariance`.
    """
    Pq, trace = P @ q, np.trace(P)
    along = q @ Pq
    radial = np.outer(q, q)
    second = np.outer(Pq, q)
    third = np.outer(trace * Pq + 2.0 * P @ Pq, q)
    return np.stack(
        [
            along * P + 2.0 * np.outer(Pq, Pq),
            -4.5 * along * (second + second.T),
            0.5 * (third + third.T),
            0.25 * (trace**2 + 2.0 * np.sum(P * P)) * radial,
            -1.5 * (along * trace + 2.0 * Pq @ Pq) * radial,
            6.75 * along**2 * radial,
        ]
    )
