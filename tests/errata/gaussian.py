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


# q, r1, r2, and the directions of the noise of b1, b2, r1, r2
RANK_ONE = [
    [0.46, 0.42, -0.27, -0.73],
    [0.59, -0.71, 0.38],
    [0.42, 0.55, -0.72],
    [-0.43, -0.47, 0.77],
    [0.867, 0.01, 0.498],
    [0.42, 0.907, 0.022],
    [0.606, 0.358, 0.711],
]


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


def small_noise(rng):
    """Geometries with noises of four sizes, up to a thousand times apart.

    The bias m of (52), what second order misses at fourth, q, the direction of m across
    q, and p, r, c, h, w, a, b of the page.
    """
    for g, length in geometries(12, rng):
        noise = 1e-3 * length * 10 ** rng.uniform(-3, 0, 4)
        given = g.q, g.r1, g.r2, noise
        second, fourth = (attitude_moments(*given, n, "plain") for n in (2, 4))
        m, q = second.bias, g.q
        b1, b2, r1, r2 = noise**2 / (4 * length**2)
        p, r = (b1 + r1) * g.d2 @ g.d2, b2 + r2
        c, h = length**2 / (g.d2 @ g.d2), g.d1 @ g.d1
        s = 1 - (g.s1 @ g.d2) ** 2 / (1 - h) / length**2
        w = s + h * (1 - s)
        a, b = p + r * w / 2, r * (1 - h) * np.sqrt(s * (1 - s))
        D, size = fourth.covariance - second.covariance, a**2 + b**2
        yield D / size, m, q, unit(m - q * (q @ m)), size, (p, r, c, h, w, a, b)


@of(
    "(63), any isotropic noise: what it misses in the plane of q and the bias", tol=1e-6
)
def eq_63_missing(rng):
    truth, forms = [], []
    for D, _, q, t, size, (p, r, c, h, w, _, b) in small_noise(rng):
        truth.append([q @ D @ q, q @ D @ t, t @ D @ t])
        printed = [
            p**2 + (1 - c) * p * r * w + r**2 * w**2 / 2,
            b * ((5 - c) * p + 4 * r * w),
            -(1 - c) * p**2
            + (3 + 3 * h - 7 * w - c * (1 - w)) * p * r
            + 3 * (h - w**2) * r**2
            + 8 * b**2,
        ]
        forms.append(np.array(printed) / size)
    return truth, forms


@of("(63), any isotropic noise, small: nearer to the exact covariance by it", tol=1e-6)
def eq_63_nearer(rng):
    # what (63) gains, 2 m'Dm - |m|^4, is a sum of terms that are not negative
    truth, forms = [], []
    for D, m, _, _, size, (p, r, c, h, w, a, b) in small_noise(rng):
        truth.append((2 * m @ D @ m * size - (m @ m) ** 2) / size**2)
        printed = [
            a**2 * (p**2 + (1 - 2 * c) * p * r * w + 3 / 4 * r**2 * w**2),
            b**2 * (16 - 2 * c) * p**2,
            b**2 * (10 * w + 6 + 6 * h - 2 * c) * p * r,
            b**2 * (3 / 2 * w**2 + 6 * h) * r**2,
            15 * b**4,
        ]
        assert min(printed) >= 0
        forms.append(sum(printed) / size**2)
    return truth, forms


def gain(g, noise):
    """By how much (63) is nearer than second order, over the square of the bias."""
    second, exact = (
        attitude_moments(g.q, g.r1, g.r2, noise, order=n, frame="plain")
        for n in (2, "exact")
    )
    miss = [
        np.linalg.norm(second.covariance + added - exact.covariance)
        for added in (0, np.outer(second.bias, second.bias))
    ]
    return (miss[0] - miss[1]) / (second.bias @ second.bias), miss


@of("(63), isotropic noise: nearer while |qbar| is two of its standard deviations")
def eq_63_far(rng):
    printed = [gain(g, 0.5 * length)[0] > 0 for g, length in geometries(8, rng)]
    near = [gain(g, 2.0 * length)[0] > 0 for g, length in geometries(8, rng)]
    return [True] * 8 + [False] * 8, printed + near


@of("(63), noise of rank one: not nearer for any noise", seeds=1, tol=1e-3)
def eq_63_rank_one(rng):
    # the four covariances are 0.01^2 v v'; errors of second order and of (63), by 1e-8
    q, *vectors = map(unit, RANK_ONE)
    r1, r2, *noise = vectors
    S = 1e-4 * np.array([np.outer(v, v) for v in noise])
    printed = [2.932, 3.110]
    return np.array(gain(Pair(q, r1, r2), S)[1]) * 1e8, printed


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


@of(
    'abstract and section 6: "alleviates issues related to singularity"', FALSE, seeds=1
)
def alleviates_singularity(rng):
    # noise of a sixth of |qbar|, and of all of it: how often is the paper's nearer,
    # and is its trace beyond 1, as of no unit quaternion's covariance?
    far, near = (
        [
            Compared(g, s * length)
            for g, length in geometries(20, np.random.default_rng(7))
        ]
        for s in (1 / 6, 1.0)
    )
    nearer = [sum(c.error(c.paper) < c.error(c.second) for c in x) for x in (far, near)]
    beyond = [sum(np.trace(c.paper) > 1 for c in x) for x in (far, near)]
    printed = nearer[1] > nearer[0]
    right = nearer[1] < nearer[0] / 2 and beyond[0] < beyond[1] / 2
    return True, bool(printed), bool(right)
