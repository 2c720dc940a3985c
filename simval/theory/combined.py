r"""Second-order bias and covariance of the combined four-column estimator.

With the symmetric scalar part the four columns, mapped back to the original frame,
are a matrix M that is bilinear in the pairs :math:`(b_1, r_1)` and
:math:`(b_2, r_2)`; without noise :math:`M = q p^T` with :math:`|p| = |r_1 \times r_2|`.
The estimate is the direction of :math:`M M^T c`, c the greatest column: one power step
towards the top left singular vector. To first order in the change dM of M both are

.. math:: \Delta\hat q = -\Pi\, dM\, p/|p|^2,\quad \Pi = I - q q^T,  \tag{C1}

whichever column c is. With :math:`dM_j` the change along component j of the noise on
the four vectors and :math:`\Sigma_{jk}` its covariance, the covariance is

.. math:: P = \Pi \Big(\sum_{jk} \Sigma_{jk}\, dM_j\, p\, p^T dM_k^T\Big) \Pi / |p|^4,
   \tag{C2}

and second-order perturbation of the eigenvector of :math:`M M^T` gives the bias

.. math:: -\Pi \sum_{jk} \Sigma_{jk} \left(dM_j dM_k^T q
   - 2\, dM_j p\, p^T dM_k^T q/|p|^2\right)/|p|^2 + \tfrac12 \mathrm{tr}(P)\, q.
   \tag{C3}

The power step leaves out terms of third order in the tangent plane, so (C2) and (C3)
hold for it too. Which column is the greatest matters from the third order on: near a
tie of two columns the fourth-order remainder is not smooth in the noise.
"""

from typing import Final

import numpy as np

from simval.arrays import Array
from simval.shapes import Float, Shaped
from simval.theory.orders import tangent_projector
from simval.theory.two_vector import column_maps


def column_matrix(
    b1: Shaped[Array, "... 3"],
    b2: Shaped[Array, "... 3"],
    r1: Shaped[Array, "... 3"],
    r2: Shaped[Array, "... 3"],
) -> Shaped[Array, "... 4 4"]:
    """Four columns with the symmetric scalar, mapped back, from any vectors."""
    columns = []
    for turn, back in column_maps():
        d1, s1 = (b1 - turn * r1) / 2, (b1 + turn * r1) / 2
        d2, s2 = (b2 - turn * r2) / 2, (b2 + turn * r2) / 2
        scalar = np.sum(s1 * d2 - s2 * d1, axis=-1, keepdims=True) / 2
        qbar = np.concatenate([np.cross(d1, d2), scalar], axis=-1)
        columns.append(qbar @ back.T)
    return np.stack(columns, axis=-1)


def combined_moments(
    vectors: Float[Array, "... 4 3"],
    q: Float[Array, "... 4"],
    noise: Float[Array, "... 4 3 3"],
    means: Float[Array, "... 4 3"],
) -> tuple[Float[Array, "... 4"], Float[Array, "... 4 4"]]:
    """Bias and covariance of q - qhat of the combined estimator, to second order."""
    M, changes = _bilinear(vectors)
    p = np.vecmat(q, M)
    squared = np.vecdot(p, p)[..., None, None]
    projector = tangent_projector(q)
    # dM p / |p|^2 and dM' q, one row for each of 12 components of the noise
    moved = np.matvec(changes, p[..., None, :]) / squared
    turned = np.vecmat(q[..., None, :], changes)
    spread = _weighted(noise, moved)
    across = moved @ projector
    P = across.swapaxes(-1, -2) @ spread @ projector
    bent = np.sum(np.matvec(changes, _weighted(noise, turned)), axis=-2)
    bent = bent / squared[..., 0] - 2.0 * np.vecmat(np.matvec(moved, q), spread)
    bent = bent + np.vecmat(means.reshape(*means.shape[:-2], 12), moved)
    inward = 0.5 * np.trace(P, axis1=-2, axis2=-1)[..., None] * q
    return inward - np.matvec(projector, bent), (P + P.swapaxes(-1, -2)) / 2.0


def _weighted(
    noise: Float[Array, "... 4 3 3"], rows: Float[Array, "... 12 4"]
) -> Float[Array, "... 12 4"]:
    # Sigma times the rows, vector by vector: their noise is independent
    apart = rows.reshape(*rows.shape[:-2], 4, 3, 4)
    return (noise @ apart).reshape(rows.shape)


def _bilinear(
    vectors: Float[Array, "... 4 3"],
) -> tuple[Float[Array, "... 4 4"], Float[Array, "... 12 4 4"]]:
    # M, and its change along each component of b1, b2, r1, r2
    batch = vectors.shape[:-2]
    first = vectors[..., ::2, :].reshape(*batch, 6)
    second = vectors[..., 1::2, :].reshape(*batch, 6)
    by_first = second @ _TENSOR.swapaxes(0, 1).reshape(6, 96)
    by_second = first @ _TENSOR.reshape(6, 96)
    changes = np.stack([by_first, by_second], axis=-2).reshape(*batch, 2, 2, 3, 4, 4)
    M = np.vecmat(first, by_first.reshape(*batch, 6, 16)).reshape(*batch, 4, 4)
    return M, changes.swapaxes(-5, -4).reshape(*batch, 12, 4, 4)


def _tensor() -> Float[Array, "6 6 4 4"]:
    # M by the components of (b1, r1) and of (b2, r2), in both of which it is linear
    first, second = np.eye(6)[:, None], np.eye(6)[None]
    return column_matrix(
        first[..., :3], second[..., :3], first[..., 3:], second[..., 3:]
    )


_TENSOR: Final = _tensor()
