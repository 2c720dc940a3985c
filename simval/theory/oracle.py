r"""Exact moments of the normalised quaternion for isotropic independent noise.

Write :math:`\bar q = |d_2| [d_1 \times u; s_1^T u]` with :math:`u = d_2/|d_2|`.
Given u, :math:`\bar q/|d_2|` is an isotropic Gaussian of standard deviation
:math:`\tau_1 = \sqrt{\sigma_{b1}^2 + \sigma_{r1}^2}/2` in the three-dimensional
space spanned by the (a x u, 0) and (0, 1), with mean
:math:`m = [d_1^t \times u; s_1^{tT} u]`. With :math:`w = m/|m|`,
:math:`\rho = |m|/\tau_1`, :math:`R = \mathrm{diag}(I - uu^T, 1)`,

.. math::
   E[\hat q|u] = A w,\quad
   A = \sqrt{2/\pi}\, e^{-\rho^2/2}/\rho
   + (1 - 1/\rho^2)\,\mathrm{erf}(\rho/\sqrt 2), \\
   E[\hat q \hat q^T|u] = B w w^T + (1 - B)/2\, (R - w w^T),\quad
   B = 1 - 2/\rho^2 + 2\sqrt 2 D(\rho/\sqrt 2)/\rho^3,  \tag{E1}

D being Dawson's function. What is left is an integral over the sphere of u against
the projected normal density of :math:`d_2`, with
:math:`k = |d_2^t|/\tau_2`, :math:`t = k\cos\theta`,

.. math:: (2\pi)^{-3/2} e^{-(k^2 - t^2)/2}
   [(1 + t^2)\sqrt{2\pi}\,\Phi(t) + t e^{-t^2/2}],  \tag{E2}

by Gauss-Legendre in the polar angle and the trapezoidal rule in azimuth. The moments
of :math:`q - \hat q` are formed from small differences, so that they keep their digits
at small noise. No expansion in the noise is made anywhere.
"""

from typing import Final

import numpy as np
from scipy import special

from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.theory.two_vector import TwoVectorGeometry

NODES: Final = (64, 32)  # polar and azimuth
# The density falls below e^{-9.5^2/2} = 3e-20 of its peak at 9.5/k from the pole.
_CUT: Final = 9.5
# Below this rho the closed forms of A and B cancel (eps / rho^3); the series below
# leave out terms of rho^4 / 140, so both sides hold 1e-10 here.
_SERIES_RHO: Final = 1e-2


def exact_moments(
    geometry: TwoVectorGeometry, noise: Array, nodes: tuple[int, int] = NODES
) -> tuple[Array, Array]:
    """Exact bias and covariance of q - qhat in the turned frame.

    Parameters
    ----------
    geometry : TwoVectorGeometry
        The noise-free vectors.
    noise : Array
        Isotropic covariances of b1, b2, r1, r2, (4, 3, 3).
    nodes : tuple of int, default (64, 32)
        Nodes in polar angle and azimuth.

    Returns
    -------
    tuple of Array
        Bias (4,) and covariance (4, 4) of truth minus estimate, the estimate with
        its raw sign.

    Raises
    ------
    InputError
        If a covariance is not a multiple of the identity.
    RefusedError
        If the quadrature does not integrate its own density to 1 within 1e-9.
    """
    tau1, tau2 = _isotropic_halves(noise)
    directions, weights = _projected_normal(geometry.d2, tau2, nodes)
    total = weights.sum()
    if not abs(total - 1.0) <= 1e-9:
        msg = (
            f"the quadrature's density integrates to 1 {total - 1.0:+.1e}, needed "
            f"within 1e-9; give more than {nodes} nodes"
        )
        raise RefusedError(msg)
    return _moments_given_directions(geometry, tau1, directions, weights / total)


def _isotropic_halves(noise: Array) -> tuple[float, float]:
    # Standard deviations tau1 of d1 (and s1) and tau2 of d2, per axis
    variances = noise[:, 0, 0]
    if not np.allclose(noise, variances[:, None, None] * np.eye(3), rtol=1e-12, atol=0):
        msg = (
            "`noise_std` holds covariances that are not isotropic; order='exact' "
            "exists for isotropic noise only, so use order=4 or `cubature_moments`"
        )
        raise InputError(msg)
    tau1 = 0.5 * np.sqrt(variances[0] + variances[2])
    tau2 = 0.5 * np.sqrt(variances[1] + variances[3])
    return float(tau1), float(tau2)


def _projected_normal(
    mean: Array, tau: float, nodes: tuple[int, int]
) -> tuple[Array, Array]:
    # Directions u (n, 3) and weights (n,) of the density (E2), around the mean
    length = float(np.linalg.norm(mean))
    pole = mean / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    if tau == 0.0:
        return pole[None, :], np.ones(1)
    k = length / tau
    x, w = np.polynomial.legendre.leggauss(nodes[0])
    reach = min(np.pi, _CUT / k) if k >= 12.0 else np.pi
    theta = 0.5 * reach * (x + 1.0)
    t = k * np.cos(theta)
    # e^{-(k^2 - t^2)/2} and its product with e^{-t^2/2}, without cancellation
    tilted = np.exp(-0.5 * (k * np.sin(theta)) ** 2)
    bulk = (1.0 + t * t) * np.sqrt(2.0 * np.pi) * special.ndtr(t)
    density = (2.0 * np.pi) ** -1.5 * (tilted * bulk + t * np.exp(-0.5 * k * k))
    polar = 0.5 * reach * w * np.sin(theta) * density
    phi = 2.0 * np.pi * (np.arange(nodes[1]) + 0.5) / nodes[1]
    across = np.linalg.svd(pole[None, :])[2][1:]  # two unit vectors normal to the pole
    ring = np.cos(phi)[:, None] * across[0] + np.sin(phi)[:, None] * across[1]
    directions = np.cos(theta)[:, None, None] * pole + (
        np.sin(theta)[:, None, None] * ring
    )
    weights = np.repeat(polar * 2.0 * np.pi / nodes[1], nodes[1])
    return directions.reshape(-1, 3), weights


def _moments_given_directions(
    geometry: TwoVectorGeometry, tau1: float, directions: Array, weights: Array
) -> tuple[Array, Array]:
    # Bias and covariance from eq. (E1) averaged over the directions
    q = geometry.q
    m = np.concatenate(
        [np.cross(geometry.d1, directions), (directions @ geometry.s1)[:, None]], axis=1
    )
    length = np.linalg.norm(m, axis=1)
    w = m / np.where(length > 0.0, length, 1.0)[:, None]
    rho = np.full_like(length, np.inf) if tau1 == 0.0 else length / tau1
    a, b = one_minus_a(rho), one_minus_b(rho)
    gap = q - w
    bias = weights @ (gap + a[:, None] * w)
    # E[e e'|u] = gap gap' + a (q w' + w q') - b w w' + b/2 (R - w w')
    mean_w = (weights * a) @ w
    second = (weights[:, None] * gap).T @ gap
    second += np.outer(q, mean_w) + np.outer(mean_w, q)
    half = 0.5 * weights * b
    second -= 3.0 * (half[:, None] * w).T @ w
    rest = half.sum() * np.eye(4)
    rest[:3, :3] -= (half[:, None] * directions).T @ directions
    return bias, second + rest - np.outer(bias, bias)


def one_minus_a(rho: Array) -> Array:
    """1 - A of eq. (E1): the shortening of the mean of a projected Gaussian.

    Parameters
    ----------
    rho : Array
        Length of the mean over the standard deviation, 0 to inf, (n,).

    Returns
    -------
    Array
        1 at rho = 0, 1/rho^2 for large rho, (n,).
    """
    safe = np.maximum(rho, _SERIES_RHO)
    squared = safe * safe
    closed = (
        special.erfc(safe / np.sqrt(2.0))
        + special.erf(safe / np.sqrt(2.0)) / squared
        - np.sqrt(2.0 / np.pi) * np.exp(-0.5 * squared) / safe
    )
    series = 1.0 - np.sqrt(2.0 / np.pi) * (2.0 * rho / 3.0 - rho**3 / 15.0)
    return np.where(rho < _SERIES_RHO, series, closed)


def one_minus_b(rho: Array) -> Array:
    """1 - B of eq. (E1): the share of the second moment across the mean.

    Parameters
    ----------
    rho : Array
        Length of the mean over the standard deviation, 0 to inf, (n,).

    Returns
    -------
    Array
        2/3 at rho = 0, 2/rho^2 for large rho, (n,).
    """
    safe = np.maximum(rho, _SERIES_RHO)
    dawson = special.dawsn(safe / np.sqrt(2.0))
    closed = 2.0 / safe**2 - 2.0 * np.sqrt(2.0) * dawson / safe / safe**2
    series = 2.0 / 3.0 - 2.0 * rho**2 / 15.0
    return np.where(rho < _SERIES_RHO, series, closed)
