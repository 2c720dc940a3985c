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

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np
from scipy import special

from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.theory.two_vector import TwoVectorGeometry

# Azimuth nodes, with twice as many polar ones, about the direction of d2. The first
# rule only checks the second.
_ABOUT_D2: Final = (22, 32)
# Where they disagree, m passes zero inside the density: at u along d1, within an angle
# tau1. Then polar nodes per panel and azimuth nodes about the direction of d1, on
# panels that grow fourfold away from it; there w depends on the azimuth alone, and
# varies within |d1|/|s1| of azimuth; the density varies within 1/k across the pole. The
# azimuth nodes are a multiple of what resolves both.
_ABOUT_D1: Final = ((12, 12.0), (16, 20.0), (24, 30.0), (32, 40.0))
_AZIMUTHS: Final = (64, 4096)
# Agreement of successive rules. The error falls geometrically with the nodes, so the
# finer one is then good to 1e-12 or better.
_TOLERANCE: Final = 1e-9
# The density falls below e^{-9.5^2/2} = 3e-20 of its peak at 9.5/k from the pole.
_CUT: Final = 9.5
# Below this rho the closed forms of A and B cancel (eps / rho^3); the series below
# leave out terms of rho^4 / 140, so both sides hold 1e-10 here.
_SERIES_RHO: Final = 1e-2


def exact_moments(geometry: TwoVectorGeometry, noise: Array) -> tuple[Array, Array]:
    """Exact bias and covariance of q - qhat in the turned frame.

    Parameters
    ----------
    geometry : TwoVectorGeometry
        The noise-free vectors.
    noise : Array
        Isotropic covariances of b1, b2, r1, r2, (4, 3, 3).

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
        If the finest two rules do not agree within 1e-9.
    """
    tau1, tau2 = _isotropic_halves(noise)
    previous: tuple[Array, ...] | None = None
    gap = np.inf
    for directions, weights in _rules(geometry, tau1, tau2):
        total = weights.sum()
        found = _moments_given_directions(geometry, tau1, directions, weights / total)
        if previous is not None:
            gap = max(_relative(a, b) for a, b in zip(previous, found, strict=True))
            gap = max(gap, abs(float(total) - 1.0))  # the density must integrate to 1
            if gap <= _TOLERANCE:
                return found
        previous = found
    msg = (
        f"the quadrature still changes the moments by {gap:.1e} relative with its last "
        f"rule, needed {_TOLERANCE:g}: |qbar| is {geometry.norm:.2e} and the noise of "
        f"the halved pairs {tau1:.2e} and {tau2:.2e}; use another frame"
    )
    raise RefusedError(msg)


def _rules(
    geometry: TwoVectorGeometry, tau1: float, tau2: float
) -> Iterator[tuple[Array, Array]]:
    for count in _ABOUT_D2:
        yield _about_d2(geometry.d2, tau2, (2 * count, count))
    d1 = np.linalg.norm(geometry.d1)
    across = np.linalg.norm(np.cross(geometry.d1, geometry.d2)) / d1  # |d2| sin angle
    scale = max(1.0, float(np.linalg.norm(geometry.s1) / d1))
    if tau2 > 0.0:
        scale = max(scale, 0.4 * float(across) / tau2)
    for polar, factor in _ABOUT_D1:
        azimuths = int(np.clip(factor * scale, *_AZIMUTHS))
        yield _about_d1(geometry, tau1, tau2, (polar, azimuths))


def _relative(a: Array, b: Array) -> float:
    scale = float(np.linalg.norm(b))
    return float(np.linalg.norm(a - b)) / scale if scale > 0.0 else 0.0


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


def _about_d2(d2: Array, tau: float, nodes: tuple[int, int]) -> tuple[Array, Array]:
    # directions u (n, 3) and weights (n,) of the density (E2) around its own centre
    pole = d2 / np.linalg.norm(d2)
    if tau == 0.0:
        return pole[None, :], np.ones(1)
    k = float(np.linalg.norm(d2)) / tau
    theta, polar = _panel(0.0, min(np.pi, _CUT / k) if k >= 12.0 else np.pi, nodes[0])
    directions, azimuth = _grid(pole, theta, nodes[1])
    polar = polar * np.sin(theta) * _density(k, np.cos(theta), np.sin(theta))
    return directions, np.repeat(polar * azimuth, nodes[1])


def _about_d1(
    geometry: TwoVectorGeometry, tau1: float, tau2: float, nodes: tuple[int, int]
) -> tuple[Array, Array]:
    # the same on panels about the direction of d1, where m vanishes
    if tau2 == 0.0:
        return _about_d2(geometry.d2, tau2, nodes)
    pole = geometry.d1 / np.linalg.norm(geometry.d1)
    length = float(np.linalg.norm(geometry.d2))
    centre, k = geometry.d2 / length, length / tau2
    edges = _graded_edges(tau1, k, float(np.arccos(np.clip(pole @ centre, -1, 1))))
    panels = [_panel(a, b, nodes[0]) for a, b in pairwise(edges)]
    theta, polar = (np.concatenate(part) for part in zip(*panels, strict=True))
    directions, azimuth = _grid(pole, theta, nodes[1])
    across = np.linalg.norm(np.cross(directions, centre), axis=1)
    weights = np.repeat(polar * np.sin(theta) * azimuth, nodes[1])
    weights *= _density(k, directions @ centre, across)
    kept = weights > 1e-30
    return directions[kept], weights[kept]


def _graded_edges(tau1: float, k: float, angle: float) -> list[float]:
    # fourfold growth from both poles, and panels of three widths 1/k of the density
    # around its centre at the given angle, as far as the density reaches
    steps = [2.0 * max(tau1, 1e-6) * 4.0**i for i in range(12)]
    steps = [step for step in steps if step < 0.5 * np.pi]
    edges = {0.0, 0.5 * np.pi, np.pi, *steps, *(np.pi - step for step in steps)}
    low, high = max(0.0, angle - _CUT / k), min(np.pi, angle + _CUT / k)
    if k < 12.0:
        low, high = 0.0, np.pi
    edges |= {low, high, *(angle + 3.0 * i / k for i in range(-3, 4))}
    return sorted(edge for edge in edges if low <= edge <= high)


def _panel(low: float, high: float, count: int) -> tuple[Array, Array]:
    x, w = np.polynomial.legendre.leggauss(count)
    return low + 0.5 * (high - low) * (x + 1.0), 0.5 * (high - low) * w


def _grid(pole: Array, theta: Array, count: int) -> tuple[Array, float]:
    # unit vectors at polar angles theta and even azimuths; the weight of an azimuth
    phi = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    across = np.linalg.svd(pole[None, :])[2][1:]  # two unit vectors normal to the pole
    ring = np.cos(phi)[:, None] * across[0] + np.sin(phi)[:, None] * across[1]
    directions = np.cos(theta)[:, None, None] * pole + (
        np.sin(theta)[:, None, None] * ring
    )
    return directions.reshape(-1, 3), 2.0 * np.pi / count


def _density(k: float, cosine: Array, sine: Array) -> Array:
    # (E2): e^{-(k^2 - t^2)/2} and its product with e^{-t^2/2}, without cancellation
    t = k * cosine
    tilted = np.exp(-0.5 * (k * sine) ** 2)
    bulk = (1.0 + t * t) * np.sqrt(2.0 * np.pi) * special.ndtr(t)
    density: Array = tilted * bulk + t * np.exp(-0.5 * k * k)
    return density * (2.0 * np.pi) ** -1.5


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
    small = np.minimum(rho, _SERIES_RHO)
    series = 1.0 - np.sqrt(2.0 / np.pi) * (2.0 * small / 3.0 - small**3 / 15.0)
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
    series = 2.0 / 3.0 - 2.0 * np.minimum(rho, _SERIES_RHO) ** 2 / 15.0
    return np.where(rho < _SERIES_RHO, series, closed)
