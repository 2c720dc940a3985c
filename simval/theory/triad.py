r"""First-order covariance of TRIAD, which fits the first pair exactly.

With :math:`b_i = A r_i` and the noise :math:`\nu_i = n_{bi} - A n_{ri}` of a pair, the
estimate :math:`(I - [\theta\times]) A` takes the first reference to the first body
vector, :math:`b_1 \times \theta = \nu_1`, and the second into their plane,
:math:`n^T (b_2 \times \theta - \nu_2) = 0`, n the unit normal along
:math:`b_1 \times b_2`. With sine s and cosine c of the angle between the vectors,

.. math:: \theta = -b_1 \times \nu_1 + b_1\, (c\, n^T \nu_1 - n^T \nu_2) / s. \tag{TR1}
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.geometry import cross_matrix
from simval.theory.noise import noise_covariances
from simval.theory.two_vector import true_vectors


def triad_covariance(q: Any, r1: Any, r2: Any, noise_std: Any) -> Float[Array, "3 3"]:
    """Covariance of TRIAD's body-frame rotation error by (TR1), rad^2.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel.
    """
    _, (b1, b2, _, _), A = true_vectors(q, r1, r2)
    normal = np.cross(b1, b2)
    sine, cosine = float(np.linalg.norm(normal)), float(b1 @ b2)
    n = normal / sine
    maps = (
        np.outer(b1, n) * (cosine / sine) - cross_matrix(b1),
        -np.outer(b1, n) / sine,
    )
    noise = noise_covariances(noise_std)
    pairs = (noise[i] + A @ noise[2 + i] @ A.T for i in range(2))
    return np.sum([L @ pair @ L.T for L, pair in zip(maps, pairs, strict=True)], axis=0)
