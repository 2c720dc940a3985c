r"""Exact moments of the normalised quaternion for Gaussian noise of any covariance.

Given d2, :math:`\bar q` is linear in :math:`z_1 = (d_1, s_1)`, so Gaussian with a mean
m and a covariance S, and in the axes of S, with eigenvalues :math:`\lambda_k`,

.. math::
   E[\hat q|d_2] = \tfrac{2}{\sqrt\pi} \int_0^\infty E[\bar q\,e^{-s^2|\bar q|^2}]\,ds,
   \quad E[\hat q \hat q^T|d_2] =
   \int_0^\infty 2s\,E[\bar q \bar q^T e^{-s^2|\bar q|^2}]\,ds,  \tag{E2} \\
   E[\bar q_k e^{-s^2|\bar q|^2}] = m_k f_k Z, \quad
   E[\bar q_k \bar q_l e^{-s^2|\bar q|^2}]
   = (m_k m_l f_k f_l + \delta_{kl} \lambda_k f_k) Z, \\
   f_k = 1/(1 + 2 s^2 \lambda_k), \quad
   Z = \textstyle\prod_k f_k^{1/2} e^{-s^2 m_k^2 f_k}.  \tag{E3}

The same integrals without noise are w and :math:`w w^T`, :math:`w = m/|m|`; what is
integrated is the difference, :math:`\delta = E[w - \hat q]` and
:math:`D = w w^T - E[\hat q \hat q^T]`, formed without cancellation, so that

.. math:: E[(q - \hat q)(q - \hat q)^T|d_2] = (q - w)(q - w)^T
   + q \delta^T + \delta q^T - D  \tag{E4}

keeps its digits at small noise. The trapezoidal rule in :math:`\log s` converges
geometrically. Only the direction of d2 counts; what is left is an average over it, by
the rules of `simval.theory.directions`. For isotropic noise `simval.theory.oracle` has
the integral over s in closed form, and shares nothing with this but (E4).
"""

from collections.abc import Iterator
from functools import lru_cache, partial
from typing import Final

import numpy as np

from simval.arrays import Array, frozen
from simval.shapes import Float
from simval.theory.cubature import covariance_roots
from simval.theory.directions import about_d2
from simval.theory.expansion import half_noise
from simval.theory.oracle import converged
from simval.theory.two_vector import TwoVectorGeometry

# Of log(s |qbar|), |qbar| its RMS length: to the left an integrand falls as s^2 at
# least, so e^-32 of it is left out; to the right it falls as Z and at least as 1/s.
_LOG_S: Final = (-16.0, 37.0)
_NEGLIGIBLE: Final = -37.0
"""Of log Z; e^-37 is 1e-16."""
# The integrands are analytic for |Im log s| < pi/4: the trapezoidal rule is off by
# e^(-pi^2 / 2 / step) = 1e-18 times what they grow by there, 1e-12 in the tests.
_STEP: Final = 0.12
_AT_ONCE: Final = 256
"""Directions; their integrands take 3 MB, what a cache holds."""
_NODES: Final = (12, 16, 22, 32, 48, 72, 108)
"""Azimuths about d2, and half of the polar angles; half as much again each time."""
_LEAST_WEIGHT: Final = 1e-15
"""Over the greatest; 23 000 nodes below leave out 2e-11 at the most, 1e-14 in fact."""
_FLAT: Final = 1e-6
"""Least over greatest variance of d2 below which whitening it would lose digits."""
_HERMITE: Final = (8, 12, 18, 27)
"""Nodes per axis of the noise of d2 where that is flat."""


def exact_moments_any(
    geometry: TwoVectorGeometry, noise: Float[Array, "4 3 3"]
) -> tuple[Array, Array]:
    """Exact bias and covariance of q - qhat in the turned frame, any covariances.

    Raises
    ------
    RefusedError
        If the finest two rules do not agree within 1e-9.
    """
    C1, C2 = half_noise(geometry, noise)
    rules = _direction_rules(geometry.d2, C2)
    spread = float(np.sqrt(np.trace(C1) / 6.0)), float(np.sqrt(np.trace(C2) / 3.0))
    found = converged(
        rules, partial(_moments, geometry, C1), float(geometry.norm), spread
    )
    return found[0], found[1]


def _direction_rules(d2: Array, C2: Array) -> Iterator[tuple[Array, Array]]:
    # directions of d2 + R x for standard normal x, R R' = C2
    variances, axes = np.linalg.eigh(C2)
    if not variances[-1] > 0.0:
        yield from [(d2[None] / np.linalg.norm(d2), np.ones(1))] * 2
    elif variances[0] > _FLAT * variances[-1]:
        # d2 = R v, and v is isotropic about R^-1 d2
        root = covariance_roots(C2[None])[0]
        centre = np.linalg.solve(root, d2)
        for count in _NODES:
            whitened, weights = about_d2(centre, 1.0, (2 * count, count))
            kept = weights > _LEAST_WEIGHT * weights.max()
            yield _normalized(whitened[kept] @ root.T), weights[kept]
    else:
        for count in _HERMITE:
            yield _hermite_rule(d2, np.maximum(variances, 0.0), axes, count)


@lru_cache(maxsize=32)
def _gauss(count: int) -> tuple[Array, Array]:
    x, w = np.polynomial.hermite_e.hermegauss(count)
    return frozen(x), frozen(w)


def _hermite_rule(
    d2: Array, variances: Array, axes: Array, count: int
) -> tuple[Array, Array]:
    x, w = _gauss(count)
    grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    weights = (w[:, None, None] * w[:, None] * w).ravel() / w.sum() ** 3
    kept = weights > 1e-22
    scaled = grid[kept] * np.sqrt(variances)
    return _normalized(d2 + scaled @ axes.T), weights[kept]


def _normalized(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)


def _moments(
    geometry: TwoVectorGeometry, C1: Array, directions: Array, weights: Array
) -> tuple[Array, ...]:
    # bias and covariance from (E4), averaged over the directions of d2
    maps, basis = _maps(directions)
    m = maps @ np.concatenate([geometry.d1, geometry.s1])
    variances, axes = np.linalg.eigh(maps @ C1 @ maps.swapaxes(1, 2))
    variances = np.maximum(variances, 0.0)
    means = (m[:, None, :] @ axes)[:, 0]
    delta, D = (np.empty((len(m), *shape)) for shape in ((3,), (3, 3)))
    for start in range(0, len(m), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        delta[some], D[some] = _shortening(means[some], variances[some])
    q, axes = geometry.q, basis @ axes
    gap = q - (basis @ _normalized(m)[..., None])[..., 0]
    mean_delta = np.einsum("n,nij,nj->i", weights, axes, delta)
    mean_D = np.tensordot(weights, axes @ D @ axes.swapaxes(1, 2), 1)
    bias = weights @ gap + mean_delta
    half = np.outer(q, mean_delta)
    second = (weights[:, None] * gap).T @ gap + half + half.T - mean_D
    return bias, second - np.outer(bias, bias)


def _maps(u: Float[Array, "n 3"]) -> tuple[Array, Array]:
    # [d1 x u; s1'u] lies in the span of (p, 0), (u x p, 0) and (0, 1), p normal to u:
    # its components there as maps of (d1, s1), and that basis
    least = np.eye(3)[np.argmin(np.abs(u), axis=1)]
    p = _normalized(np.cross(u, least))
    across = np.cross(u, p)
    maps, basis = np.zeros((len(u), 3, 6)), np.zeros((len(u), 4, 3))
    maps[:, 0, :3], maps[:, 1, :3], maps[:, 2, 3:] = across, -p, u
    basis[:, :3, 0], basis[:, :3, 1], basis[:, 3, 2] = p, across, 1.0
    return maps, basis


def _shortening(
    m: Float[Array, "n 3"], variances: Float[Array, "n 3"]
) -> tuple[Array, Array]:
    # delta and D of (E4) in the axes of S: (E2) without noise less (E2) with it
    size = np.sqrt(np.sum(m * m + variances, axis=1, keepdims=True))
    size = np.where(size > 0.0, size, 1.0)
    m, variances = (m / size)[..., None], (variances / size**2)[..., None]
    s = _scales(m, variances)
    s2 = s * s
    double = 2.0 * s2 * variances
    f = 1.0 / (1.0 + double)
    g = double * f  # 1 - f
    clean, noisy = -s2 * np.sum(m * m, axis=1), _log_Z(s2, m, variances)
    with np.errstate(under="ignore"):
        Z0, Z = np.exp(clean), np.exp(noisy)
        # Z - Z0, by the logarithm of their ratio where they are close
        ratio = np.sum(s2 * m * m * g - 0.5 * np.log1p(double), axis=1)
        close = np.abs(ratio) < 0.5
        growth = np.where(close, Z0 * np.expm1(np.where(close, ratio, 0.0)), Z - Z0)
    first, second = 2.0 / np.sqrt(np.pi) * _STEP * s, 2.0 * _STEP * s2
    means = m[..., 0]
    delta = means * np.sum(
        (Z0 * first)[:, None] * g - (growth * first)[:, None] * f, axis=-1
    )
    Z0, growth = (Z0 * second)[:, None], (growth * second)[:, None]
    # 1 - f_k f_l = g_k + g_l - g_k g_l
    one = np.sum(Z0 * g, axis=-1)
    both = (Z0 * g) @ g.swapaxes(1, 2) + (growth * f) @ f.swapaxes(1, 2)
    D = means[:, :, None] * means[:, None, :] * (one[:, :, None] + one[:, None] - both)
    every = np.arange(3)
    D[:, every, every] -= variances[..., 0] * np.sum((Z0 + growth) * f, axis=-1)
    return delta, D


def _scales(m: Array, variances: Array) -> Array:
    # nodes s, as far as Z counts for any of the directions
    logs = np.arange(*_LOG_S, _STEP)
    counts = _log_Z(np.exp(2.0 * logs[::10]), m, variances).max(axis=0) > _NEGLIGIBLE
    last = 10 * int(np.flatnonzero(counts)[-1]) + 11
    return np.exp(logs[:last])


def _log_Z(s2: Array, m: Array, variances: Array) -> Array:
    # logarithm of Z of (E3)
    double = 2.0 * s2 * variances
    return -np.sum(s2 * m * m / (1.0 + double) + 0.5 * np.log1p(double), axis=1)
