r"""Cramér-Rao bound of an attitude from pairs of noisy vectors.

The measurements are :math:`b_i = A(q) r_i^t + n_{bi}` and :math:`r_i = r_i^t + n_{ri}`;
the unknowns are the attitude, three small body-frame angles :math:`\theta` with
:math:`A = (I - [\theta\times]) A(q)`, and the true reference directions, two angles
each, which nobody asked for. With W the inverse noise covariances,

.. math:: J = \sum_i \begin{bmatrix} B_i^T W_{bi} B_i & B_i^T W_{bi} A T_i \\ \cdot &
   T_i^T (A^T W_{bi} A + W_{ri}) T_i \end{bmatrix},\quad B_i = [b_i^t \times],
   \tag{R1}

T_i the plane tangent at :math:`r_i^t`, whose rows fall away where it is known exactly;
the bound on :math:`\theta` is the inverse of the Schur complement of the nuisance
block. A quaternion error is :math:`\Delta q = \Xi\, \theta/2` to first order.

The length of a unit vector is known and says nothing of the attitude: B and T are
tangent to the sphere. So noise in the tangent plane alone, which leaves the length
exact, has a bound, and what W is along the vector does not enter it.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simval.arrays import Array, ReadOnly, outer
from simval.errors import InputError
from simval.geometry import attitude_matrix, cross_matrix
from simval.shapes import Float
from simval.theory.two_vector import (
    noise_covariances,
    noise_of_samples,
    own_axes,
    require_apart,
    true_pairs,
    unit_arguments,
    vectors_of,
)

TANGENT: Final = 1e-12
"""Of the trace of a covariance: a product P S P is rounded to 1e-16 of it, and what has
less than this along its vector is tangent."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttitudeBound(ReadOnly):
    """Lowest covariance of an unbiased attitude estimate.

    Attributes
    ----------
    rotation : Array
        Covariance of the body-frame rotation error, rad^2, (..., 3, 3).
    quaternion : Array
        Covariance of the additive quaternion error, (..., 4, 4), of rank 3.
    """

    rotation: Float[Array, "... 3 3"]
    quaternion: Float[Array, "... 4 4"]


def attitude_bound(q: Any, r1: Any, r2: Any, noise_std: Any) -> AttitudeBound:
    """Cramer-Rao bound (R1) of the two-vector problem.

    Parameters
    ----------
    q : array_like
        True quaternion, (..., 4).
    r1, r2 : array_like
        True reference vectors, (..., 3).
    noise_std : array_like
        As in `simval.theory.attitude_moments`, without correlations between vectors;
        full covariances must be regular or have noise in all of the plane normal to
        their vector, but a reference may have no noise at all.

    Returns
    -------
    AttitudeBound
        The bound; sigma^2 (or the scale of the covariances) enters linearly.

    Raises
    ------
    InputError
        If an argument is wrong or a noise covariance is singular.
    GeometryError
        If the vectors are parallel.
    """
    noise = noise_of_samples(noise_std)
    if len(own_axes(noise)) == 2:
        msg = (
            f"`noise_std` has shape {noise.shape}; the bound is for vectors that are "
            "independent of each other, so give (..., 4, 3, 3) covariances"
        )
        raise InputError(msg)
    unit = unit_arguments(q, r1, r2, noise.shape[:-3])
    require_apart(*unit[1:])
    return _bound_of(unit[0], vectors_of(*unit), noise)


def wahba_bound(q: Any, references: Any, noise_std: Any) -> AttitudeBound:
    """Cramér-Rao bound of an attitude from n vector pairs; see `attitude_bound`.

    Parameters
    ----------
    q : array_like
        True quaternion, (4,).
    references : array_like
        True reference vectors, (n, 3), n >= 2.
    noise_std : array_like
        As in `wahba_moments`; full covariances as in `attitude_bound`.

    Returns
    -------
    AttitudeBound
        The bound.

    Raises
    ------
    InputError
        If an argument is wrong or a noise covariance is singular.
    GeometryError
        If the vectors are parallel.
    """
    unit_q, vectors = true_pairs(q, references)
    return _bound_of(unit_q, vectors, noise_covariances(noise_std, len(vectors)))


def _bound_of(
    unit_q: Float[Array, "... 4"],
    vectors: Float[Array, "... m 3"],
    noise: Float[Array, "... m 3 3"],
) -> AttitudeBound:
    # from true body vectors, then as many reference vectors
    count, A = noise.shape[-3], attitude_matrix(unit_q)
    n = count // 2
    known = [i >= n and not noise[..., i, :, :].any() for i in range(count)]
    # noise along a vector does not enter, so there is some: a solution is then regular
    along = outer(vectors, vectors)
    size = np.linalg.trace(noise)[..., None, None]
    left = np.max(np.abs(noise @ along), axis=(-2, -1), keepdims=True)
    noise = noise + np.where(left <= TANGENT * size, size, 0.0) * along
    if not np.all((np.linalg.eigvalsh(noise)[..., 0] > 0.0) | known):
        msg = (
            "`noise_std` has a direction across a vector without noise, whose "
            "information is infinite; the bound needs noise in the plane normal to "
            "each vector, or references without any noise, so give each direction some"
        )
        raise InputError(msg)
    information = np.zeros((*unit_q.shape[:-1], 3, 3))
    for i in range(n):
        b, r = vectors[..., i, :], vectors[..., n + i, :]
        B = cross_matrix(b)
        own = B.mT @ np.linalg.solve(noise[..., i, :, :], B)
        pair = noise[..., i, :, :], noise[..., n + i, :, :]
        information += own if known[n + i] else own - _lost(B, A, r, *pair)
    rotation = np.linalg.solve(information, np.eye(3))
    rotation = (rotation + rotation.mT) / 2.0
    e, s = unit_q[..., :3], unit_q[..., 3, None, None]
    rows = s * np.eye(3) + cross_matrix(e), -e[..., None, :]
    half_xi = 0.5 * np.concatenate(rows, axis=-2)
    return AttitudeBound(rotation=rotation, quaternion=half_xi @ rotation @ half_xi.mT)


def _lost(B: Array, A: Array, r: Array, body: Array, reference: Array) -> Array:
    # information that the unknown direction of r takes away
    T = np.linalg.svd(r[..., None, :])[2][..., 1:, :].mT
    AT = A @ T
    W_AT = np.linalg.solve(body, AT)
    nuisance = AT.mT @ W_AT
    nuisance += T.mT @ np.linalg.solve(reference, T)
    mixed = B.mT @ W_AT
    return mixed @ np.linalg.solve(nuisance, mixed.mT)
