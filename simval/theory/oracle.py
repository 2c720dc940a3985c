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

D being Dawson's function. What is left is an average over the direction u, by the
rules of `simval.theory.directions`. The moments of :math:`q - \hat q` are formed from
small differences, so that they keep their digits at small noise: a standard deviation
is good to 1e-15 absolute. No expansion in the noise is made anywhere.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Final

import numpy as np
import scipy

from simval.arrays import Array
from simval.errors import InputError, RefusedError
from simval.shapes import Float
from simval.theory.directions import direction_rules
from simval.theory.two_vector import TwoVectorGeometry

# Agreement of successive rules. The error falls geometrically with the nodes, so the
# finer one is then good to 1e-12 or better.
_TOLERANCE: Final = 1e-9
# Below this rho the closed forms of A and B cancel (eps / rho^3); the series below
# leave out terms of rho^4 / 140, so both sides hold 1e-10 here.
_SERIES_RHO: Final = 1e-2


def exact_moments(
    geometry: TwoVectorGeometry, noise: Float[Array, "4 3 3"]
) -> tuple[Float[Array, "4"], Float[Array, "4 4"]]:
    """Exact bias and covariance of q - qhat in the turned frame.

    Raises
    ------
    InputError
        If a covariance is not a multiple of the identity.
    RefusedError
        If the finest two rules do not agree within 1e-9.
    """
    tau1, tau2 = _isotropic_halves(noise)
    rules = direction_rules(geometry, tau1, tau2)
    given = partial(_moments_given_directions, geometry, tau1)
    bias, covariance = converged(rules, given, float(geometry.norm), (tau1, tau2))
    return bias, covariance


def converged(
    rules: Iterable[tuple[Array, Array]],
    functional: Callable[[Array, Array], tuple[Array, ...]],
    norm: float,
    spread: tuple[float, float],
) -> tuple[Array, ...]:
    """Functional of directions and weights, by rules that refine until two agree.

    Raises
    ------
    RefusedError
        If the finest two rules do not agree within 1e-9.
    """
    previous: tuple[Array, ...] | None = None
    gap = np.inf
    for directions, weights in rules:
        total = weights.sum()
        found = functional(directions, weights / total)
        if previous is not None:
            gap = max(_relative(a, b) for a, b in zip(previous, found, strict=True))
            gap = max(gap, abs(float(total) - 1.0))  # the density must integrate to 1
            if gap <= _TOLERANCE:
                return found
        previous = found
    msg = (
        f"the quadrature still changes its result by {gap:.1e} relative with its last "
        f"rule, needed {_TOLERANCE:g}: |qbar| is {norm:.2e} and the noise of the "
        f"halved pairs {spread[0]:.2e} and {spread[1]:.2e}; use another frame"
    )
    raise RefusedError(msg)


def _relative(a: Array, b: Array) -> float:
    # q - w is rounded to 1e-16, so at noise below 1e-7 a mean cannot agree better than
    # 1e-15, nor a covariance better than 1e-15 standard deviations
    scale = float(np.linalg.norm(b))
    floor = 1e-6 if b.ndim == 1 else 1e-6 * np.sqrt(scale) + 1e-21
    return float(np.linalg.norm(a - b) / (scale + floor))


def isotropic(noise: Float[Array, "4 3 3"]) -> bool:
    """Whether every covariance is a multiple of the identity, but for rounding."""
    multiples = noise[:, 0, 0, None, None] * np.eye(3)
    return np.allclose(noise, multiples, rtol=1e-12, atol=0)


def _isotropic_halves(noise: Float[Array, "4 3 3"]) -> tuple[float, float]:
    # Standard deviations tau1 of d1 (and s1) and tau2 of d2, per axis
    variances = noise[:, 0, 0]
    if not isotropic(noise):
        msg = (
            "`noise_std` holds covariances that are not isotropic; this integral is "
            "for isotropic noise, so use `attitude_moments` with order='exact'"
        )
        raise InputError(msg)
    tau1 = 0.5 * np.sqrt(variances[0] + variances[2])
    tau2 = 0.5 * np.sqrt(variances[1] + variances[3])
    return _unless_tiny(float(tau1)), _unless_tiny(float(tau2))


def _unless_tiny(tau: float) -> float:
    # below this the square of the inverse overflows, and moments of tau^2 underflow
    return tau if tau > 1e-140 else 0.0


def _moments_given_directions(
    geometry: TwoVectorGeometry,
    tau1: float,
    directions: Float[Array, "n 3"],
    weights: Float[Array, " n"],
) -> tuple[Array, ...]:
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


def one_minus_a(rho: Float[Array, " n"]) -> Float[Array, " n"]:
    """1 - A of eq. (E1): the shortening of the mean of a projected Gaussian."""
    safe = np.maximum(rho, _SERIES_RHO)
    squared = safe * safe
    closed = (
        scipy.special.erfc(safe / np.sqrt(2.0))
        + scipy.special.erf(safe / np.sqrt(2.0)) / squared
        - np.sqrt(2.0 / np.pi) * np.exp(-0.5 * squared) / safe
    )
    small = np.minimum(rho, _SERIES_RHO)
    series = 1.0 - np.sqrt(2.0 / np.pi) * (2.0 * small / 3.0 - small**3 / 15.0)
    return np.where(rho < _SERIES_RHO, series, closed)


def one_minus_b(rho: Float[Array, " n"]) -> Float[Array, " n"]:
    """1 - B of eq. (E1): the share of the second moment across the mean."""
    safe = np.maximum(rho, _SERIES_RHO)
    dawson = scipy.special.dawsn(safe / np.sqrt(2.0))
    closed = 2.0 / safe**2 - 2.0 * np.sqrt(2.0) * dawson / safe / safe**2
    series = 2.0 / 3.0 - 2.0 * np.minimum(rho, _SERIES_RHO) ** 2 / 15.0
    return np.where(rho < _SERIES_RHO, series, closed)
