r"""Bias and covariance of the normalised quaternion error, order by order.

The estimate is :math:`\hat q = (q - x)/|q - x|`, and the Legendre series of
:math:`1/|q - x|` gives the terms of the error :math:`q - \hat q`, with
:math:`u = q^T x` and :math:`r = x^T x`,

.. math::
   & x - u q, \\
   & u x + (r/2 - 3u^2/2) q, \\
   & (3u^2/2 - r/2) x - (5u^3/2 - 3ur/2) q, \\
   & (5u^3/2 - 3ur/2) x - (35u^4 - 30u^2 r + 3r^2)/8\, q.  \tag{O1}

Polarised forms of degree n are written :math:`Q_n`. With :math:`x = x_1 + x_2`
(X1) and Gaussian noise, through fourth order in the noise,

.. math::
   e_2 = \Pi x_2 + Q_2(x_1, x_1),\quad e_3 = 2 Q_2(x_1, x_2) + Q_3(x_1, x_1, x_1),
   \\ C = \Pi P \Pi + \mathrm{cov}(e_2) + E[e_1 e_3^T] + E[e_3 e_1^T].  \tag{O2}

To second order the bias is :math:`P q + \tfrac12\mathrm{tr}(Q P) q` with
:math:`Q = I - 3 q q^T` and the covariance :math:`\Pi P \Pi`, P the covariance of x;
nothing there is special to the estimator but P itself, and no distribution is assumed,
only an error of mean zero.

Source: Peng and Choukroun, sections 4 and 5. Its fourth-order covariance keeps
:math:`Q_2(x_1, x_1)` only; the other terms of (O2) are of the same order, so it is
accurate to second order, like the linear one (docs/attitude.md).
"""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.shapes import Float
from simval.theory.expansion import ScaledErrorMoments


def tangent_projector(q: Float[Array, "... 4"]) -> Float[Array, "... 4 4"]:
    r"""Projector :math:`\Pi = I - q q^T` onto the plane tangent to the sphere at q."""
    return np.eye(4) - _outer(q, q)


def normalization_matrix(q: Float[Array, "... 4"]) -> Float[Array, "... 4 4"]:
    """Matrix Q of source eq. (50)."""
    return np.eye(4) - 3.0 * _outer(q, q)


def second_order_bias(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4"]:
    """Mean of q - qhat, source eq. (52)."""
    half_trace = 0.5 * _trace(normalization_matrix(q) @ P)
    return np.matvec(P, q) + half_trace[..., None] * q


def second_order_covariance(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4 4"]:
    """Covariance of q - qhat, source eq. (63) without its last term."""
    projector = tangent_projector(q)
    covariance: Array = projector @ P @ projector
    return covariance


def quadratic_form(q: Float[Array, "... 4"]) -> Float[Array, "... 4 4 4"]:
    """Tensor T of the second-order term of (O1): component b is x' T[b] x."""
    half = 0.5 * np.eye(4)[:, :, None] * q[..., None, None, :]
    square = q[..., :, None, None] * normalization_matrix(q)[..., None, :, :]
    return half + half.swapaxes(-1, -2) + 0.5 * square


def quadratic_covariance(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4 4"]:
    """Covariance of Q2(x1, x1): Terms 1 to 6 of source section 5, less the mean."""
    scaled = quadratic_form(q) @ P[..., None, :, :]
    turned = _flat(scaled.swapaxes(-1, -2))
    covariance: Array = 2.0 * _flat(scaled) @ turned.swapaxes(-1, -2)
    return covariance


def paper_fourth_covariance(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4 4"]:
    """The source's fourth-order covariance, its section 5, misprints put right."""
    return second_order_covariance(q, P) + quadratic_covariance(q, P)


def complete_fourth_covariance(moments: ScaledErrorMoments) -> Float[Array, "... 4 4"]:
    """Covariance of q - qhat through fourth order, eq. (O2)."""
    q, P, G = moments.q, moments.P, moments.G
    T = quadratic_form(q)
    projector = tangent_projector(q)
    bilinear = projector @ moments.V @ projector
    # E[Pi x2 Q2'], E[x1 2 Q2(x1, x2)'] and E[x1 Q3']
    mixed = projector @ _flat(G) @ _flat(T).swapaxes(-1, -2)
    # sum over c and d of G[d, a, c] T[b, c, d]
    by_a = _flat(np.moveaxis(G, -3, -1))
    second_third = 2.0 * by_a @ _flat(T).swapaxes(-1, -2)
    third = P @ _mean_cubic_gradient(q, P)
    half = mixed + projector @ (second_third + third)
    return paper_fourth_covariance(q, P) + bilinear + half + half.swapaxes(-1, -2)


def complete_fourth_bias(moments: ScaledErrorMoments) -> Float[Array, "... 4"]:
    """Mean of q - qhat through fourth order."""
    q, P = moments.q, moments.P
    from_bilinear = np.sum(
        quadratic_form(q) * moments.V[..., None, :, :], axis=(-2, -1)
    )
    return (
        second_order_bias(q, P)
        + from_bilinear
        + _cubic_bias(q, moments.G)
        + _quartic_bias(q, P)
    )


def _mean_cubic_gradient(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4 4"]:
    # E of the derivative of Q3's component b along c, (4, 4) as [c, b]
    Pq, trace = np.matvec(P, q), _trace(P)[..., None]
    along = _dot(q, Pq)
    return (
        3.0 * _outer(q, Pq)
        - P
        + (1.5 * along - 0.5 * trace)[..., None] * np.eye(4)
        - _outer((7.5 * along - 1.5 * trace) * q - 3.0 * Pq, q)
    )


def _cubic_bias(
    q: Float[Array, "... 4"], G: Float[Array, "... 4 4 4"]
) -> Float[Array, "... 4"]:
    # E[3 Q3(x1, x1, x2)]: the gradient of Q3 at x1 along x2
    qG = np.vecmat(q, _flat(G)).reshape(*q.shape, 4)  # contracts x2 with q
    contracted = np.trace(G, axis1=-3, axis2=-2)  # E[(x1.x2) x1]
    along = np.matvec(np.matvec(G, q[..., None, :]), q)  # E[x2 u^2]
    squared = np.trace(G, axis1=-2, axis2=-1)  # E[x2 r]
    turned = np.vecmat(q, qG)
    inside = 7.5 * _dot(turned, q) - 1.5 * _trace(qG)[..., None]
    inside = inside - 3.0 * _dot(q, contracted)
    return 3.0 * turned - contracted + 1.5 * along - 0.5 * squared - inside * q


def _quartic_bias(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4"]:
    # E[Q4(x1, x1, x1, x1)] by Isserlis' theorem
    Pq, trace = np.matvec(P, q), _trace(P)[..., None]
    along = _dot(q, Pq)
    vector = (7.5 * along - 1.5 * trace) * Pq - 3.0 * np.matvec(P, Pq)
    inside = (
        105.0 * along**2
        - 30.0 * (along * trace + 2.0 * _dot(Pq, Pq))
        + 3.0 * (trace**2 + 2.0 * np.sum(P * P, axis=(-2, -1))[..., None])
    )
    return vector - inside / 8.0 * q


def _outer(a: Array, b: Array) -> Array:
    return a[..., :, None] * b[..., None, :]


def _trace(matrices: Array) -> Any:
    return np.trace(matrices, axis1=-2, axis2=-1)


def _dot(a: Array, b: Array) -> Array:
    # (..., 1), to multiply vectors with
    return np.vecdot(a, b)[..., None]


def _flat(tensor: Float[Array, "... 4 4 4"]) -> Float[Array, "... 4 16"]:
    return tensor.reshape(*tensor.shape[:-2], 16)
