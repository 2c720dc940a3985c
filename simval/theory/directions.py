r"""Quadrature over the direction of a Gaussian vector, for the exact oracle.

The density of :math:`u = d_2/|d_2|` for :math:`d_2 \sim N(d_2^t, \tau_2^2 I)` on the
sphere, with :math:`k = |d_2^t|/\tau_2` and :math:`t = k \cos\theta`, is

.. math:: (2\pi)^{-3/2} e^{-(k^2 - t^2)/2}
   [(1 + t^2)\sqrt{2\pi}\,\Phi(t) + t e^{-t^2/2}].  \tag{U1}

Rules are products of Gauss-Legendre in the polar angle and the trapezoidal rule in
azimuth, about the direction of :math:`d_2^t` or, where the integrand varies quickly
near the direction of :math:`d_1^t`, about that.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
import scipy

from simval.arrays import Array, frozen
from simval.shapes import Float
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
# Where more would be needed than the upper bound, which is for the memory, the rules
# disagree and `oracle` refuses.
_AZIMUTHS: Final = (64, 4096)
# The density falls below e^{-9.5^2/2} = 3e-20 of its peak at 9.5/k from the pole.
_CUT: Final = 9.5


def direction_rules(
    geometry: TwoVectorGeometry, tau1: float, tau2: float
) -> Iterator[tuple[Array, Array]]:
    """Rules that refine, the cheapest first."""
    for count in _ABOUT_D2:
        yield about_d2(geometry.d2, tau2, (2 * count, count))
    d1 = np.linalg.norm(geometry.d1)
    across = np.linalg.norm(np.cross(geometry.d1, geometry.d2)) / d1  # |d2| sin angle
    scale = max(1.0, float(np.linalg.norm(geometry.s1) / d1))
    if tau2 > 0.0:
        scale = max(scale, 0.4 * float(across) / tau2)
    for polar, factor in _ABOUT_D1:
        azimuths = int(np.clip(factor * scale, *_AZIMUTHS))
        yield _about_d1(geometry, tau1, tau2, (polar, azimuths))


def about_d2(
    d2: Float[Array, "3"], tau: float, nodes: tuple[int, int]
) -> tuple[Float[Array, "n 3"], Float[Array, " n"]]:
    """Directions and weights of the density (U1) around its own centre."""
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
) -> tuple[Float[Array, "n 3"], Float[Array, " n"]]:
    # the same on panels about the direction of d1, where m vanishes
    if tau2 <= 1e-9:  # the directions are within 1e-8 of that of d2: nothing to grade
        return about_d2(geometry.d2, tau2, nodes)
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
    kept = weights > 1e-30  # of a sum of 1: all that is left out is below rounding
    return directions[kept], weights[kept]


def _graded_edges(tau1: float, k: float, angle: float) -> list[float]:
    # fourfold growth from both poles, and panels of three widths 1/k of the density
    # around its centre at the given angle, as far as the density reaches
    steps = [2.0 * max(tau1, 1e-6) * 4.0**i for i in range(12)]
    steps = [step for step in steps if step < 0.5 * np.pi]
    edges = {0.0, 0.5 * np.pi, np.pi, *steps, *(np.pi - step for step in steps)}
    low, high = max(0.0, angle - _CUT / k), min(np.pi, angle + _CUT / k)
    if k < 12.0:  # `_CUT` / k is then a quarter of the sphere and more
        low, high = 0.0, np.pi
    edges |= {low, high, *(angle + 3.0 * i / k for i in range(-3, 4))}
    return sorted(edge for edge in edges if low <= edge <= high)


def _panel(
    low: float, high: float, count: int
) -> tuple[Float[Array, " count"], Float[Array, " count"]]:
    x, w = _gauss(count)
    return low + 0.5 * (high - low) * (x + 1.0), 0.5 * (high - low) * w


@lru_cache(maxsize=32)
def _gauss(count: int) -> tuple[Float[Array, " count"], Float[Array, " count"]]:
    # half of the time of an exact answer, if it is worked out anew for each panel
    x, w = np.polynomial.legendre.leggauss(count)
    return frozen(x), frozen(w)


def _grid(
    pole: Float[Array, "3"], theta: Float[Array, " polar"], count: int
) -> tuple[Float[Array, "n 3"], float]:
    # unit vectors at polar angles theta and even azimuths; the weight of an azimuth
    phi = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    across = np.linalg.svd(pole[None, :])[2][1:]  # two unit vectors normal to the pole
    ring = np.cos(phi)[:, None] * across[0] + np.sin(phi)[:, None] * across[1]
    directions = np.cos(theta)[:, None, None] * pole + (
        np.sin(theta)[:, None, None] * ring
    )
    return directions.reshape(-1, 3), 2.0 * np.pi / count


def _density(
    k: float, cosine: Float[Array, " n"], sine: Float[Array, " n"]
) -> Float[Array, " n"]:
    # (U1): e^{-(k^2 - t^2)/2} and its product with e^{-t^2/2}, without cancellation
    t = k * cosine
    tilted = np.exp(-0.5 * (k * sine) ** 2)
    bulk = (1.0 + t * t) * np.sqrt(2.0 * np.pi) * scipy.special.ndtr(t)
    density: Array = tilted * bulk + t * np.exp(-0.5 * k * k)
    return density * (2.0 * np.pi) ** -1.5
