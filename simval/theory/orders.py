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

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.theory.expansion import ScaledErrorMoments


def tangent_projector(q: Float[Array, "4"]) -> Float[Array, "4 4"]:
    r"""Projector :math:`\Pi = I - q q^T` onto the plane tangent to the sphere at q."""
    return np.eye(4) - np.outer(q, q)


def normalization_matrix(q: Float[Array, "4"]) -> Float[Array, "4 4"]:
    """Matrix Q of source eq. (50)."""
    return np.eye(4) - 3.0 * np.outer(q, q)


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


def quadratic_form(q: Float[Array, "4"]) -> Float[Array, "4 4 4"]:
    """Tensor T of the second-order term of (O1): component b is x' T[b] x."""
    half = 0.5 * np.eye(4)[:, :, None] * q
    return half + half.swapaxes(1, 2) + 0.5 * q[:, None, None] * normalization_matrix(q)


def quadratic_covariance(
    q: Float[Array, "4"], P: Float[Array, "4 4"]
) -> Float[Array, "4 4"]:
    """Covariance of Q2(x1, x1): Terms 1 to 6 of source section 5, less the mean."""
    scaled = quadratic_form(q) @ P
    covariance: Array = (
        2.0 * scaled.reshape(4, 16) @ (scaled.swapaxes(1, 2).reshape(4, 16).T)
    )
    return covariance


def paper_fourth_covariance(
    q: Float[Array, "4"], P: Float[Array, "4 4"]
) -> Float[Array, "4 4"]:
    """The source's fourth-order covariance, its section 5, misprints put right."""
    return second_order_covariance(q, P) + quadratic_covariance(q, P)


def complete_fourth_covariance(moments: ScaledErrorMoments) -> Float[Array, "4 4"]:
    """Covariance of q - qhat through fourth order, eq. (O2)."""
    q, P, G = moments.q, moments.P, moments.G
    T = quadratic_form(q)
    projector = tangent_projector(q)
    bilinear = projector @ moments.V @ projector
    # E[Pi x2 Q2'], E[x1 2 Q2(x1, x2)'] and E[x1 Q3']
    mixed = projector @ G.reshape(4, 16) @ T.reshape(4, 16).T
    second_third = 2.0 * np.einsum("bcd,dac->ab", T, G)
    third = P @ _mean_cubic_gradient(q, P)
    half = mixed + projector @ (second_third + third)
    return paper_fourth_covariance(q, P) + bilinear + half + half.T


def complete_fourth_bias(moments: ScaledErrorMoments) -> Float[Array, "4"]:
    """Mean of q - qhat through fourth order."""
    q, P = moments.q, moments.P
    from_bilinear = quadratic_form(q).reshape(4, 16) @ moments.V.reshape(16)
    return (
        second_order_bias(q, P)
        + from_bilinear
        + _cubic_bias(q, moments.G)
        + _quartic_bias(q, P)
    )


def _mean_cubic_gradient(
    q: Float[Array, "4"], P: Float[Array, "4 4"]
) -> Float[Array, "4 4"]:
    # E of the derivative of Q3's component b along c, (4, 4) as [c, b]
    Pq, trace = P @ q, np.trace(P)
    along = q @ Pq
    return (
        3.0 * np.outer(q, Pq)
        - P
        + (1.5 * along - 0.5 * trace) * np.eye(4)
        - np.outer((7.5 * along - 1.5 * trace) * q - 3.0 * Pq, q)
    )


def _cubic_bias(q: Float[Array, "4"], G: Float[Array, "4 4 4"]) -> Float[Array, "4"]:
    # E[3 Q3(x1, x1, x2)]: the gradient of Q3 at x1 along x2
    qG = q @ G.reshape(4, 16)  # contracts x2 with q
    qG = qG.reshape(4, 4)
    contracted = np.trace(G, axis1=0, axis2=1)  # E[(x1.x2) x1]
    along = G @ q @ q  # E[x2 u^2]
    squared = np.trace(G, axis1=1, axis2=2)  # E[x2 r]
    inside = 7.5 * (q @ qG @ q) - 1.5 * np.trace(qG) - 3.0 * (q @ contracted)
    bias: Array = 3.0 * (q @ qG) - contracted + 1.5 * along - 0.5 * squared - inside * q
    return bias


def _quartic_bias(q: Float[Array, "4"], P: Float[Array, "4 4"]) -> Float[Array, "4"]:
    # E[Q4(x1, x1, x1, x1)] by Isserlis' theorem
    Pq, trace = P @ q, np.trace(P)
    along = q @ Pq
    vector = (7.5 * along - 1.5 * trace) * Pq - 3.0 * P @ Pq
    inside = (
        105.0 * along**2
        - 30.0 * (along * trace + 2.0 * Pq @ Pq)
        + 3.0 * (trace**2 + 2.0 * np.sum(P * P))
    )
    bias: Array = vector - inside / 8.0 * q
    return bias
