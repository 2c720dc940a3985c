r"""Second-order bias and covariance of TRIAD, which fits the first pair exactly.

With :math:`b_i = A r_i` and the noise :math:`\nu_i = n_{bi} - A n_{ri}` of a pair, the
estimate :math:`(I - [\theta\times]) A` takes the first reference to the first body
vector, :math:`b_1 \times \theta = \nu_1`, and the second into their plane,
:math:`n^T (b_2 \times \theta - \nu_2) = 0`, n the unit normal along
:math:`b_1 \times b_2`. With sine s and cosine c of the angle between the vectors,

.. math:: \theta = -b_1 \times \nu_1 + b_1\, (c\, n^T \nu_1 - n^T \nu_2) / s. \tag{TR1}

The frame of noisy vectors v1, v2 is turned by a rotation vector whose mean is, along
:math:`e_1 = v_1`, :math:`e_2 = e_3 \times e_1` and the normal :math:`e_3`, with
:math:`C_i` the covariances in these axes,

.. math:: \bar\phi = \begin{bmatrix}
   (c s\,C_{1,13} - c^2 C_{1,23} - C_{2,23}) / s^2 - C_{1,23} / 2 \\
   C_{1,13} - c\,C_{1,23} / (2 s) \\ -C_{1,12} - c\,C_{1,33} / (2 s) \end{bmatrix},
   \quad E[\theta] = A \bar\phi_r - \bar\phi_b. \tag{TR2}

It is the expansion of :math:`v_1/|v_1|` and of the normal to second order; body and
reference frames have the same mean, and the estimate none, where their noise is equal.
"""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.geometry import cross_matrix
from simval.shapes import Float
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


def triad_bias(q: Any, r1: Any, r2: Any, noise_std: Any) -> Float[Array, "3"]:
    """Mean of TRIAD's body-frame rotation error by (TR2), rad.

    Raises
    ------
    InputError
        If an argument has a wrong shape or value.
    GeometryError
        If the vectors are parallel.
    """
    _, vectors, A = true_vectors(q, r1, r2)
    noise = noise_covariances(noise_std)
    body, reference = (_mean_turn(vectors[i : i + 2], noise[i : i + 2]) for i in (0, 2))
    return A @ reference - body


def _mean_turn(v: Float[Array, "2 3"], noise: Float[Array, "2 3 3"]) -> Array:
    # mean rotation vector of the frame of two vectors, in the axes of the vectors
    normal = np.cross(v[0], v[1])
    s, c = float(np.linalg.norm(normal)), float(v[0] @ v[1])
    axes = np.stack([v[0], np.cross(normal / s, v[0]), normal / s], axis=1)
    first, second = axes.T @ noise @ axes
    about_first = (c * s * first[0, 2] - c * c * first[1, 2] - second[1, 2]) / s**2
    turn = np.array(
        [
            about_first - first[1, 2] / 2.0,
            first[0, 2] - c * first[1, 2] / (2.0 * s),
            -first[0, 1] - c * first[2, 2] / (2.0 * s),
        ]
    )
    mean: Array = axes @ turn
    return mean
