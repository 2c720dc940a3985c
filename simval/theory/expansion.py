r"""Error of the two-vector quaternion, expanded in powers of the noise.

**Gaussian moments of the scaled error x.**
With :math:`z_1 = (\Delta d_1, \Delta s_1)` and :math:`z_2 = \Delta d_2`, independent
and Gaussian, eq. (39) of Peng and Choukroun divided by :math:`|\bar q^t|` is

.. math:: x = x_1 + x_2,\quad x_1 = J_1 z_1 + J_2 z_2,\quad
   (x_2)_a = z_1^T B_a z_2.  \tag{X1}

All that the expansions to fourth order need of x are

.. math:: P = E[x_1 x_1^T],\quad V = E[x_2 x_2^T],\quad
   G_{abc} = E[(x_2)_a (x_1)_b (x_1)_c];  \tag{X2}

the mean of x and every odd moment vanish.

Where the two pairs are correlated, :math:`z_1` and :math:`z_2` are, with a covariance
:math:`C_{12}`, and x has a mean :math:`\bar x_a = \mathrm{tr}(B_a^T C_{12})`. With
:math:`A_1, A_2` the covariances of :math:`z_1, z_2` with :math:`x_1`, V and G about
that mean are

.. math:: V_{ab} = \mathrm{tr}\big((C_1 B_a C_2 + C_{12} B_a^T C_{12})^T B_b\big),
   \quad G_a = A_1^T B_a A_2 + (A_1^T B_a A_2)^T.  \tag{X3}

**Bias and covariance of the normalised error, order by order.**
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

To second order the bias is :math:`\Pi \bar x + P q + \tfrac12\mathrm{tr}(Q P) q` with
:math:`Q = I - 3 q q^T` and the covariance :math:`\Pi P \Pi`, P the covariance of x;
nothing there is special to the estimator but P itself and the mean, and no distribution
is assumed, only noise of mean zero.

Source: Peng and Choukroun, sections 4 and 5. Its fourth-order covariance keeps
:math:`Q_2(x_1, x_1)` only; the other terms of (O2) are of the same order, so it is
accurate to second order, like the linear one (docs/attitude.md).

**Bias and covariance of any unit estimate.**
Truth and estimate have length 1, so sample by sample
:math:`|q - \hat q|^2 = 2 - 2 q^T\hat q = 2 q^T (q - \hat q)`. With the mean m and the
covariance C of :math:`q - \hat q`,

.. math:: \mathrm{tr}\,C + m^T m = 2 q^T m,  \tag{L1}

whatever the estimator, the noise and its size. An approximation of m and C can be held
to it without any oracle: what it misses by is of the order of what it leaves out. It
also says which way a bias points: inward, by half of the mean square.

**The combined four-column estimator, to second order.**
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

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from simval.arrays import Array, Scalars, outer
from simval.geometry import cross, cross_matrix
from simval.moments import Moments
from simval.shapes import Float, Shaped
from simval.theory.two_vector import (
    Noise,
    TwoVectorGeometry,
    column_maps,
    tangent_projector,
)

# eps[j, a, k] with (v x w)_a = sum eps[j, a, k] v_j w_k
_LEVI_CIVITA = np.stack([cross_matrix(row) for row in np.eye(3)])
# B but for |qbar|
_BILINEAR = np.zeros((4, 6, 3))
_BILINEAR[:3, :3] = -_LEVI_CIVITA.swapaxes(0, 1)
_BILINEAR[3, 3:] = -np.eye(3)


class ScaledErrorMoments(NamedTuple):
    """Second moments of x and its cross moment of fourth order, eq. (X2).

    Attributes
    ----------
    q : Array
        True quaternion in the frame of x.
    P : Array
        Covariance of the linear part.
    V : Array
        Covariance of the bilinear part.
    G : Array
        Mean of the bilinear part times the linear part twice.
    mean : Array
        Mean of the bilinear part, 0 for pairs that are not correlated; V and G are
        about it.
    """

    q: Float[Array, "... 4"]
    P: Float[Array, "... 4 4"]
    V: Float[Array, "... 4 4"]
    G: Float[Array, "... 4 4 4"]
    mean: Float[Array, "... 4"]


def linear_maps(
    geometry: TwoVectorGeometry,
) -> tuple[Float[Array, "... 4 6"], Float[Array, "... 4 3"]]:
    """Matrices J1 and J2 of eq. (X1), source eqs. (54) to (58)."""
    batch = geometry.q.shape[:-1]
    J1, J2 = np.zeros((*batch, 4, 6)), np.zeros((*batch, 4, 3))
    J1[..., :3, :3] = cross_matrix(geometry.d2)
    J1[..., 3, 3:] = -geometry.d2
    J2[..., :3, :] = -cross_matrix(geometry.d1)
    J2[..., 3, :] = -geometry.s1
    norm = geometry.norm[..., None, None]
    return J1 / norm, J2 / norm


def bilinear_map(geometry: TwoVectorGeometry) -> Float[Array, "... 4 6 3"]:
    """Tensor B of eq. (X1), the last terms of source eq. (39)."""
    return _BILINEAR / geometry.norm[..., None, None, None]


def half_noise(
    geometry: TwoVectorGeometry,
    noise: Noise,
) -> tuple[
    Float[Array, "... 6 6"], Float[Array, "... 3 3"], Float[Array, "... 6 3"] | None
]:
    """Covariances of (dd1, ds1), of dd2, and between them; None for 0."""
    if noise.shape[-1] == 12:
        half = 0.5 * np.eye(3)
        turned = half * geometry.turn[..., None, :]
        none = np.zeros_like(turned)
        rows = [
            [half + none, none, -turned, none],
            [half + none, none, turned, none],
            [none, half + none, none, -turned],
        ]
        halves = np.block(rows)
        C = halves @ noise @ halves.mT
        return C[..., :6, :6], C[..., 6:, 6:], C[..., :6, 6:]
    turn = outer(geometry.turn, geometry.turn)
    b1, b2 = noise[..., 0, :, :], noise[..., 1, :, :]
    r1, r2 = turn * noise[..., 2, :, :], turn * noise[..., 3, :, :]
    own, cross = (b1 + r1) / 4.0, (b1 - r1) / 4.0
    return np.block([[own, cross], [cross, own]]), (b2 + r2) / 4.0, None


def mean_linear_error(
    geometry: TwoVectorGeometry, means: Float[Array, "... 4 3"]
) -> Float[Array, "... 4"]:
    """Mean of the linear part of x if the noise has a mean."""
    J1, J2 = linear_maps(geometry)
    b1, b2 = means[..., 0, :], means[..., 1, :]
    r1, r2 = geometry.turn * means[..., 2, :], geometry.turn * means[..., 3, :]
    first = np.concatenate([(b1 - r1) / 2, (b1 + r1) / 2], axis=-1)
    return np.matvec(J1, first) + np.matvec(J2, (b2 - r2) / 2)


def scaled_error_moments(
    geometry: TwoVectorGeometry,
    noise: Noise,
) -> ScaledErrorMoments:
    """Moments P, V and G of eqs. (X2) and (X3)."""
    J1, J2 = linear_maps(geometry)
    B = bilinear_map(geometry)
    C1, C2, C12 = half_noise(geometry, noise)
    batch = geometry.q.shape[:-1]
    P = J1 @ C1 @ J1.mT + J2 @ C2 @ J2.mT
    spread = C1[..., None, :, :] @ B @ C2[..., None, :, :]  # (4, 6, 3)
    flat, mean = (*batch, 4, 18), np.zeros((*batch, 4))
    half = J1[..., None, :, :] @ spread @ J2[..., None, :, :].mT
    if C12 is not None:
        across = J1 @ C12 @ J2.mT
        P = P + across + across.mT
        mean = np.sum(B * C12[..., None, :, :], axis=(-2, -1))
        A1 = J1 @ C1 + J2 @ C12.mT
        A2 = C2 @ J2.mT + C12.mT @ J1.mT
        half = A1[..., None, :, :] @ B @ A2[..., None, :, :]
        mixed = C12[..., None, :, :]
        spread = spread + mixed @ B.mT @ mixed
    V = spread.reshape(flat) @ B.reshape(flat).mT
    return ScaledErrorMoments(q=geometry.q, P=P, V=V, G=half + half.mT, mean=mean)


def normalization_matrix(q: Float[Array, "... 4"]) -> Float[Array, "... 4 4"]:
    """Matrix Q of source eq. (50)."""
    return np.eye(4) - 3.0 * outer(q, q)


def second_order_bias(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4"]:
    """Mean of q - qhat where x has none, source eq. (52)."""
    half_trace = 0.5 * _trace(normalization_matrix(q) @ P)
    return np.matvec(P, q) + half_trace[..., None] * q


def second_order_length(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Scalars, "..."]:
    """Mean of |q|/|q - x| less 1 where x has no mean, source eq. (51)."""
    return -0.5 * _trace(normalization_matrix(q) @ P)


def second_order_covariance(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4 4"]:
    """Covariance of q - qhat, source eq. (63) without its last term."""
    projector = tangent_projector(q)
    return projector @ P @ projector


def quadratic_form(q: Float[Array, "... 4"]) -> Float[Array, "... 4 4 4"]:
    """Tensor T of the second-order term of (O1): component b is x' T[b] x."""
    half = 0.5 * np.eye(4)[:, :, None] * q[..., None, None, :]
    square = q[..., :, None, None] * normalization_matrix(q)[..., None, :, :]
    return half + half.mT + 0.5 * square


def quadratic_covariance(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4 4"]:
    """Covariance of Q2(x1, x1): Terms 1 to 6 of source section 5, less the mean."""
    scaled = quadratic_form(q) @ P[..., None, :, :]
    return 2.0 * _flat(scaled) @ _flat(scaled.mT).mT


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
    mixed = projector @ _flat(G) @ _flat(T).mT
    # sum over c and d of G[d, a, c] T[b, c, d]
    by_a = _flat(np.moveaxis(_about_zero(moments), -3, -1))
    second_third = 2.0 * by_a @ _flat(T).mT
    half = mixed + projector @ (second_third + P @ _mean_cubic_gradient(q, P))
    return paper_fourth_covariance(q, P) + bilinear + half + half.mT


def complete_fourth_bias(moments: ScaledErrorMoments) -> Float[Array, "... 4"]:
    """Mean of q - qhat through fourth order."""
    q, P = moments.q, moments.P
    V = moments.V + outer(moments.mean, moments.mean)
    from_bilinear = np.sum(quadratic_form(q) * V[..., None, :, :], axis=(-2, -1))
    return (
        second_order_bias(q, P)
        + np.matvec(tangent_projector(q), moments.mean)
        + from_bilinear
        + _cubic_bias(q, _about_zero(moments))
        + _quartic_bias(q, P)
    )


def _about_zero(moments: ScaledErrorMoments) -> Float[Array, "... 4 4 4"]:
    # G with the mean of the bilinear part in it
    return moments.G + moments.mean[..., None, None] * moments.P[..., None, :, :]


def _mean_cubic_gradient(
    q: Float[Array, "... 4"], P: Float[Array, "... 4 4"]
) -> Float[Array, "... 4 4"]:
    # E of the derivative of Q3's component b along c, (4, 4) as [c, b]
    Pq, trace = np.matvec(P, q), _trace(P)[..., None]
    along = _dot(q, Pq)
    return (
        3.0 * outer(q, Pq)
        - P
        + (1.5 * along - 0.5 * trace)[..., None] * np.eye(4)
        - outer((7.5 * along - 1.5 * trace) * q - 3.0 * Pq, q)
    )


def _cubic_bias(
    q: Float[Array, "... 4"], G: Float[Array, "... 4 4 4"]
) -> Float[Array, "... 4"]:
    # E[3 Q3(x1, x1, x2)]: the gradient of Q3 at x1 along x2
    qG = np.vecmat(q, _flat(G)).reshape(*q.shape, 4)  # contracts x2 with q
    contracted = np.trace(G, axis1=-3, axis2=-2)  # E[(x1.x2) x1]
    along = np.matvec(np.matvec(G, q[..., None, :]), q)  # E[x2 u^2]
    squared = np.linalg.trace(G)  # E[x2 r]
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


def _trace(matrices: Array) -> Any:
    return np.linalg.trace(matrices)


def _dot(a: Array, b: Array) -> Array:
    # (..., 1), to multiply vectors with
    return np.vecdot(a, b)[..., None]


def _flat(tensor: Float[Array, "... 4 4 4"]) -> Float[Array, "... 4 16"]:
    return tensor.reshape(*tensor.shape[:-2], 16)


EPS = float(np.finfo(np.float64).eps)
_LEAST = EPS**2
"""A mean square below this is one of rounding errors."""


def unit_length_defect(mean_square: float, inward: float) -> float:
    """Relative difference of both sides of (L1), for given moments."""
    return (mean_square - 2.0 * inward) / max(mean_square, _LEAST)


def predicted_defect(predicted: Moments, q: Float[Array, "4"]) -> float:
    """Relative defect of (L1) for a predicted bias and covariance."""
    square = float(np.trace(predicted.second_moment))
    return unit_length_defect(square, float(q @ predicted.bias))


def unit_length_rounding(mean_square: float, off: float = 0.0) -> float:
    r"""Size of the defect that rounding alone makes.

    A normalised quaternion has a squared length within 8 roundings of 1 (squares, sum,
    root, division), 4 eps; so has the truth. Each error and mean is rounded by its own
    size at most, which is the RMS: eps times the RMS in each of four components, times
    the depth of the sums, 16 and less by pairs. What else the squared length of an
    estimate may be off by is `off`.
    """
    rms = float(np.sqrt(mean_square))
    return (8.0 * EPS + 64.0 * EPS * rms + off) / max(mean_square, _LEAST)


def mapped_column(
    b1: Shaped[Array, "... 3"],
    b2: Shaped[Array, "... 3"],
    r1: Shaped[Array, "... 3"],
    r2: Shaped[Array, "... 3"],
    place: int,
    *,
    symmetric: bool,
) -> Shaped[Array, "... 4"]:
    """One column mapped back, for numbers or power series."""
    turn, back = column_maps()[place]
    d1, s1 = (b1 - turn * r1) / 2, (b1 + turn * r1) / 2
    d2, s2 = (b2 - turn * r2) / 2, (b2 + turn * r2) / 2
    scalar = np.sum(s1 * d2, axis=-1, keepdims=True)
    if symmetric:
        scalar = np.sum(s1 * d2 - s2 * d1, axis=-1, keepdims=True) / 2
    qbar = np.concatenate([cross(d1, d2), scalar], axis=-1)
    return qbar @ back.T


def column_matrix(
    b1: Shaped[Array, "... 3"],
    b2: Shaped[Array, "... 3"],
    r1: Shaped[Array, "... 3"],
    r2: Shaped[Array, "... 3"],
) -> Shaped[Array, "... 4 4"]:
    """All four columns mapped back, with the symmetric scalar."""
    columns = [mapped_column(b1, b2, r1, r2, k, symmetric=True) for k in range(4)]
    return np.stack(columns, axis=-1)


def two_vector_direction(
    place: int, *, frame: str | None, normalized: bool, sign: float = 1.0
) -> Callable[..., Shaped[Array, "... 4"]]:
    """Arithmetic of one column, of all combined, or of the optimum."""

    def estimate(*vectors: Shaped[Array, "... 3"]) -> Shaped[Array, "... 4"]:
        b1, b2, r1, r2 = (unit(v) for v in vectors) if normalized else vectors
        if frame == "optimal":  # (K3) of the estimator's kernel
            b1, b2, r1, r2 = map(unit, (b1 - b2, b1 + b2, r1 - r2, r1 + r2))
        if frame != "combined":
            return sign * unit(mapped_column(b1, b2, r1, r2, place, symmetric=False))
        M = column_matrix(b1, b2, r1, r2)
        step = M @ (M.mT @ M[..., place, None])
        return sign * unit(step[..., 0])

    return estimate


def unit(v: Shaped[Array, "... m"]) -> Shaped[Array, "... m"]:
    """Vectors divided by their length, for numbers or power series."""
    return v * np.sum(v * v, axis=-1, keepdims=True) ** -0.5


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
    P = (moved @ projector).mT @ spread @ projector
    bent = np.sum(np.matvec(changes, _weighted(noise, turned)), axis=-2)
    bent = bent / squared[..., 0] - 2.0 * np.vecmat(np.matvec(moved, q), spread)
    bent = bent + np.vecmat(means.reshape(*means.shape[:-2], 12), moved)
    inward = 0.5 * np.linalg.trace(P)[..., None] * q
    return inward - np.matvec(projector, bent), (P + P.mT) / 2.0


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
