r"""Exact relations between the errors of the quaternion estimate, and their expansion.

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

from simval.arrays import Array
from simval.geometry import cross_matrix


def unnormalized_error(
    true: tuple[Array, Array, Array], noise: tuple[Array, Array, Array]
) -> Array:
    """Error of qbar, exact, source eq. (39).

    Parameters
    ----------
    true : tuple of Array
        True d1, s1, d2, (..., 3) each.
    noise : tuple of Array
        Their errors measured minus true, from `half_errors`, (..., 3) each.

    Returns
    -------
    Array
        True minus measured qbar, (..., 4).
    """
    d1, s1, d2 = true
    dd1, ds1, dd2 = noise
    vector = np.cross(d2, dd1) - np.cross(d1, dd2) - np.cross(dd1, dd2)
    scalar = -np.sum(d2 * ds1 + s1 * dd2 + ds1 * dd2, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def half_errors(
    db1: Array, db2: Array, dr1: Array, dr2: Array
) -> tuple[Array, Array, Array]:
    """Errors of d1, s1 and d2 from those of the vectors, source eqs. (40), (41).

    Parameters
    ----------
    db1, db2, dr1, dr2 : Array
        Measured minus true vectors, (..., 3).

    Returns
    -------
    tuple of Array
        Errors of d1, s1 and d2, (..., 3) each.
    """
    return (db1 - dr1) / 2, (db1 + dr1) / 2, (db2 - dr2) / 2


def norm_ratio(q: Array, scaled: Array) -> Array:
    """True over measured length of qbar, exact, source eqs. (42), (43).

    Parameters
    ----------
    q : Array
        True quaternions, (..., 4).
    scaled : Array
        Scaled errors, (..., 4).

    Returns
    -------
    Array
        The ratio nu, (...).
    """
    along = np.sum(q * scaled, axis=-1)
    return 1.0 / np.sqrt(1.0 - 2.0 * along + np.sum(scaled * scaled, axis=-1))


def norm_ratio_second_order(q: Array, scaled: Array) -> Array:
    """True over measured length of qbar to second order, source eqs. (48), (50).

    Parameters
    ----------
    q : Array
        True quaternions, (..., 4).
    scaled : Array
        Scaled errors, (..., 4).

    Returns
    -------
    Array
        nu less terms of third order, (...).
    """
    along = np.sum(q * scaled, axis=-1)
    return 1.0 + along - 0.5 * np.sum(scaled * scaled, axis=-1) + 1.5 * along**2


def normalized_error(q: Array, scaled: Array) -> Array:
    """Error of the normalised estimate, exact, source eq. (44).

    Parameters
    ----------
    q : Array
        True quaternions, (..., 4).
    scaled : Array
        Scaled errors, (..., 4).

    Returns
    -------
    Array
        q minus qhat, (..., 4).
    """
    nu = norm_ratio(q, scaled)[..., None]
    return nu * scaled + (1.0 - nu) * q


def normalized_error_second_order(q: Array, scaled: Array) -> Array:
    """Error of the normalised estimate to second order, source eq. (49).

    Parameters
    ----------
    q : Array
        True quaternions, (..., 4).
    scaled : Array
        Scaled errors, (..., 4).

    Returns
    -------
    Array
        q minus qhat less terms of third order, (..., 4).
    """
    along = np.sum(q * scaled, axis=-1, keepdims=True)
    squared = np.sum(scaled * scaled, axis=-1, keepdims=True)
    radial = -along + 0.5 * squared - 1.5 * along**2
    return (1.0 + along) * scaled + radial * q


def multiplicative_matrix(q: Array) -> Array:
    """Matrix M with q^-1 * v = -M v, source eq. (47).

    Parameters
    ----------
    q : Array
        Unit quaternions, (..., 4).

    Returns
    -------
    Array
        Orthogonal matrices, (..., 4, 4).
    """
    e, s = q[..., :3], q[..., 3]
    M = np.empty((*q.shape[:-1], 4, 4))
    M[..., :3, :3] = cross_matrix(e) - s[..., None, None] * np.eye(3)
    M[..., :3, 3] = e
    M[..., 3, :3] = -e
    M[..., 3, 3] = -s
    return M


def multiplicative_error(q: Array, normalized: Array) -> Array:
    """Multiplicative error from the additive one, exact, source eqs. (45), (46).

    Parameters
    ----------
    q : Array
        True quaternions, (..., 4).
    normalized : Array
        q minus qhat, (..., 4).

    Returns
    -------
    Array
        q^-1 * qhat, (..., 4); the identity quaternion without error.
    """
    rotated = np.einsum("...ij,...j->...i", multiplicative_matrix(q), normalized)
    return rotated + np.array([0.0, 0.0, 0.0, 1.0])
