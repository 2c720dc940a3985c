r"""Second-order bias and covariance of the combined four-column estimator.

With the symmetric scalar part the four columns, mapped back to the original frame,
are a matrix M that is bilinear in the pairs :math:`(b_1, r_1)` and
:math:`(b_2, r_2)`; without noise :math:`M = q p^T` with :math:`|p| = |r_1 \times r_2|`.
The estimate is the direction of :math:`M M^T c`, c the greatest column: one power step
towards the top left singular vector. To first order in the change dM of M both are

.. math:: \Delta\hat q = -\Pi\, dM\, p/|p|^2,\quad \Pi = I - q q^T,  \tag{C1}

whichever column c is, so the covariance is a sum over independent noise directions j,

.. math:: P = \Pi \Big(\sum_j dM_j\, p\, p^T dM_j^T\Big) \Pi / |p|^4,  \tag{C2}

and second-order perturbation of the eigenvector of :math:`M M^T` gives the bias

.. math:: -\Pi \sum_j \left(dM_j dM_j^T q - 2\, dM_j p\, p^T dM_j^T q/|p|^2\right)
   /|p|^2 + \tfrac12 \mathrm{tr}(P)\, q.  \tag{C3}

The power step leaves out terms of third order in the tangent plane, so (C2) and (C3)
hold for it too. Which column is the greatest matters from the third order on: near a
tie of two columns the fourth-order remainder is not smooth in the noise.
"""

import numpy as np
from jaxtyping import Float, Shaped

from simval.arrays import Array
from simval.theory.cubature import covariance_roots
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
    vectors: Float[Array, "4 3"],
    q: Float[Array, "4"],
    noise: Float[Array, "4 3 3"],
    means: Float[Array, "4 3"],
) -> tuple[Float[Array, "4"], Float[Array, "4 4"]]:
    """Bias and covariance of q - qhat of the combined estimator, to second order."""
    M = column_matrix(*vectors)
    changes = _changes(vectors, _noise_directions(noise))
    p = q @ M
    squared = float(p @ p)
    projector = tangent_projector(q)
    moved = changes @ p / squared  # dM p / |p|^2, one row per noise direction
    tangent = moved @ projector
    P = tangent.T @ tangent
    turned = np.einsum("jab,a->jb", changes, q)  # dM' q
    bent = np.einsum("jab,jb->a", changes, turned) / squared
    bent -= 2.0 * (moved @ q) @ moved
    bent += _changes(vectors, means[None])[0] @ p / squared
    return 0.5 * np.trace(P) * q - projector @ bent, P


def _noise_directions(noise: Float[Array, "4 3 3"]) -> Float[Array, "12 4 3"]:
    # the 12 independent directions of the noise, each a change of the four vectors
    directions = np.zeros((12, 4, 3))
    for i, root in enumerate(covariance_roots(noise)):
        directions[3 * i : 3 * i + 3, i] = root.T
    return directions


def _changes(
    vectors: Float[Array, "4 3"], directions: Float[Array, "j 4 3"]
) -> Float[Array, "j 4 4"]:
    # first-order change of M along each direction (j, 4, 3)
    b1, b2, r1, r2 = vectors
    db1, db2, dr1, dr2 = directions.swapaxes(0, 1)
    changes: Array = column_matrix(db1, b2, dr1, r2) + column_matrix(b1, db2, r1, dr2)
    return changes
