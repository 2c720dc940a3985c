"""Peng and Choukroun, (63) and what the fourth order is said to bring."""

from functools import cache

import numpy as np

from errata.claim import FALSE, WORDING, add, claim
from errata.geometry import (
    Pair,
    directions,
    gaussian_mean,
    jacobian,
    mean_square,
    qbar,
    turn,
    unit,
)
from errata.moments import normal_matrix
from simval.theory import attitude_moments

SOURCE = "quaternion"
of = claim(SOURCE)
add(
    SOURCE,
    "(63), a hat for the check of P inside: as printed it is circular †",
    WORDING,
)


def quadratic(q, x):
    """The second-order term of (49)."""
    return q @ x * x + 0.5 * x @ normal_matrix(q) @ x * q


class Compared:
    """Covariances of one geometry, isotropic noise, and the exact one."""

    def __init__(self, g, sigma):
        J = jacobian(qbar, g.vectors) / np.linalg.norm(qbar(g.vectors))
        q, P = g.q, sigma**2 * J @ J.T
        projector = np.eye(4) - np.outer(q, q)
        self.q, self.second = q, projector @ P @ projector
        self.bias = gaussian_mean(lambda x: quadratic(q, x), P)
        square = mean_square(lambda x: quadratic(q, x), P)
        self.with_square = self.second + np.outer(self.bias, self.bias)  # (63)
        self.paper = self.second + square - np.outer(self.bias, self.bias)
        found = attitude_moments(q, g.r1, g.r2, sigma, order="exact", frame="plain")
        self.exact, self.exact_bias = found.covariance, found.bias

    def error(self, covariance):
        """Distance of a covariance from the exact one."""
        return np.linalg.norm(covariance - self.exact)


def geometries(n, rng):
    """Random geometries, the singular ones left out."""
    while n:
        q, (r1, r2) = unit(rng.standard_normal(4)), directions(2, rng)
        e_n = q[:3] @ np.cross(r1, r2)
        if abs(e_n) > 0.05:
            n -= 1
            yield Pair(q * np.sign(e_n), r1, r2), abs(e_n)


@cache
def sample():
    """Thirty random geometries at a noise of 2 % of |qbar|."""
    rng = np.random.default_rng(14)
    return [Compared(g, 0.02 * length) for g, length in geometries(30, rng)]


@of("(63) with (65): the added term is of the covariance", FALSE, tol=1e-4)
def eq_63(rng):
    # along q the covariance begins with the variance of |e|^2 / 2, tr(C C) / 2, while
    # the added term is the square of its mean, tr(C)^2 / 4; noise of 0.5 % leaves 3e-5
    ((g, length),) = geometries(1, rng)
    one = Compared(g, 0.005 * length)
    q, scale = one.q, np.trace(one.second) ** 2
    truth = q @ one.exact @ q / scale
    printed = (q @ one.bias) ** 2 / scale
    right = 0.5 * np.trace(one.second @ one.second) / scale
    return truth, printed, right


@of("(63): no order higher than without the added term")
def eq_63_order(rng):
    ((g, length),) = geometries(1, rng)
    coarse, fine = (Compared(g, s * length) for s in (0.02, 0.01))
    printed = [c.second + np.outer(c.bias, c.bias) for c in (coarse, fine)]
    gaps = coarse.error(printed[0]), fine.error(printed[1])
    return 4.0, round(np.log2(gaps[0] / gaps[1]), 1)


@of("(63): nearer to the exact covariance than without the added term", seeds=1)
def eq_63_nearer(rng):
    truth, found = [True] * 30 + [False] * 30, sample()
    plain = [c.error(c.second) for c in found]
    printed = [c.second + np.outer(c.bias, c.bias) for c in found]
    opposite = [c.second - 3 * np.outer(c.bias, c.bias) for c in found]
    errors = [c.error(x) for c, x in zip(found * 2, printed + opposite, strict=True)]
    return truth, [a < b for a, b in zip(errors, plain * 2, strict=True)]


@of("(63): at least half of the added term is there along q")
def eq_63_reason(rng):
    # of numbers below 1 that sum to 1 the squares sum to 1/3 or more: Cauchy-Schwarz
    shares = rng.dirichlet(np.ones(3), 200)
    printed = np.sum(shares**2, axis=1) / 2 > 0.25 / 2
    return [True] * 200, printed


@of('abstract, sections 4 and 4.3: covariance "exact to the fourth order"', FALSE)
def exact_to_fourth_order(rng):
    ((g, length),) = geometries(1, rng)
    coarse, fine = (Compared(g, s * length) for s in (0.01, 0.005))
    truth = round(np.log2(coarse.error(coarse.paper) / fine.error(fine.paper)), 1)
    printed = 6.0  # what is left of a covariance that is right to fourth order
    right = 4.0
    return truth, printed, right


@of('abstract, sections 4 and 6: "increased accuracy"', FALSE, seeds=1)
def increased_accuracy(rng):
    farther = [c.error(c.paper) > c.error(c.second) for c in sample()]
    printed = not any(farther)
    right = 15 < sum(farther) < 30  # usually not, sometimes yes
    return True, printed, right


@of('abstract and section 6: "alleviates issues related to singularity"', FALSE)
def alleviates_singularity(rng):
    # |qbar| of the size of the noise: the exact trace is 1 - |mean|^2, so below 1
    r1, r2 = directions(2, rng)
    plane, n = unit(r1 + 0.4 * r2), unit(np.cross(r1, r2))
    one, off = (
        Compared(Pair(turn(plane + tilt * n, 1.5), r1, r2), 0.02)
        for tilt in (0.01, 0.1)
    )
    traces = [np.trace(x) for x in (one.exact, one.second, one.paper)]
    helps = off.error(off.paper) < off.error(off.second)
    printed = one.error(one.paper) < one.error(one.second)
    right = helps and traces[0] < 1 < traces[1] < traces[2]
    return True, bool(printed), bool(right)
