"""The theorem on (63) of docs/errata.md: each step of its proof, without rounding.

What second order misses is an identity of polynomials in the geometry and the noises.
It is evaluated modulo the prime 2^61 - 1, at random vectors of unit length there: an
identity of degree 1000 that is wrong is seen with a probability of 1 - 1e-15. What
follows from it is algebra in symbols.
"""

from collections import Counter
from functools import cache
from itertools import count
from math import prod

import numpy as np
import sympy as sp

from errata.claim import claims

SOURCE = "quaternion"
PRIME = 2**61 - 1


def over(number):
    """One over a number, modulo the prime."""
    return pow(int(number), -1, PRIME)


HALF = over(2)


class Noisy(Counter):
    """A polynomial in independent standard normals, up to degree 3."""

    def __mul__(self, other):
        found = Noisy()
        for a, x in self.items():
            for b, y in (other if isinstance(other, Noisy) else {(): other}).items():
                if len(a) + len(b) <= 3:
                    key = tuple(sorted(a + b))
                    found[key] = (found[key] + x * y) % PRIME
        return found

    def __add__(self, other):
        total = Noisy(self)
        total.update(other if isinstance(other, Noisy) else {(): other})
        return total

    def __sub__(self, other):
        return self + other * -1

    __rmul__, __radd__ = __mul__, __add__


ONE = Noisy({(): 1})


def mean(a, b, *degrees):
    """E{a b} of the terms of two degrees: moments are 1, 0, 1, 0, 3 of one normal."""
    one, two = (
        {names: x for names, x in polynomial.items() if len(names) == degree}
        for polynomial, degree in zip((a, b), degrees, strict=True)
    )
    return sum(
        x * y * prod((1, 0, 1, 0, 3)[n] for n in Counter(names + more).values())
        for names, x in one.items()
        for more, y in two.items()
    )


@cache
def moments(seed):
    """Of a geometry and four noises what (52) is, what second order misses, p to w.

    By (43) and (44) the error is nu x + (1 - nu) q, nu = (1 - eps)^(-1/2). Vectors are
    |qbar| times as long here, and t is b times as long.
    """
    rng = np.random.default_rng(seed)

    def drawn(size):
        return rng.integers(1, PRIME, size).astype(object)

    def direction():  # stereographic
        m, n = drawn(2)
        return np.array([2 * m, 2 * n, m * m + n * n - 1]) * over(m * m + n * n + 1)

    b1, b2, r1, r2 = (direction() % PRIME for _ in range(4))
    std, number = drawn(4), count()
    db1, db2, dr1, dr2 = (
        np.array([Noisy({(next(number),): s}) for _ in range(3)]) for s in std
    )
    d1, d2, s1 = (b1 - r1) * HALF, (b2 - r2) * HALF, (b1 + r1) * HALF
    dd1, dd2, ds1 = (db1 - dr1) * HALF, (db2 - dr2) * HALF, (db1 + dr1) * HALF
    q = np.append(np.cross(d1, d2), s1 @ d2) % PRIME
    cross = np.cross(dd1, d2) + np.cross(d1, dd2) + np.cross(dd1, dd2)
    x = np.append(cross, ds1 @ d2 + s1 @ dd2 + ds1 @ dd2) * -1
    length = over(q @ q)  # of one over |qbar|^2
    eps = (q @ x * 2 - x @ x) * length
    nu = ONE + eps * HALF + eps * eps * (3 * over(8)) + eps * eps * eps * (5 * over(16))
    e = x * nu + q * (ONE - nu)
    m = np.array([mean(ONE, e_i, 0, 2) % PRIME for e_i in e], dtype=object)
    a = q @ m * length % PRIME
    t = (m - a * q) % PRIME
    along, across = q @ e, t @ e

    def missing(u, v):
        orders = sum(mean(u, v, *pair) for pair in ((2, 2), (1, 3), (3, 1)))
        return orders - mean(ONE, u, 0, 2) * mean(ONE, v, 0, 2)

    pairs = (along, along), (along, across), (across, across)
    trace = sum(mean(e_i, e_i, 1, 1) for e_i in e)
    h, d2d2 = d1 @ d1, d2 @ d2
    s = 1 - (s1 @ d2) ** 2 * over(1 - h) * length
    p, r = ((std[i] ** 2 + std[i + 2] ** 2) * over(4) * length for i in (0, 1))
    letters = (p * d2d2, r, over(length) * over(d2d2), h, s, s + h * (1 - s))
    return (
        [a, trace * length * HALF % PRIME, t @ t * length % PRIME],
        [missing(*pair) * length**2 % PRIME for pair in pairs],
        [int(letter) % PRIME for letter in letters],
    )


@claims(
    SOURCE,
    theorem_bias="the theorem on (63): m is a along q and b across it",
    theorem_missing="the theorem on (63): what second order misses, for any noises",
)
def steps(rng):
    found, missed, (p, r, c, h, s, w) = moments(int(rng.integers(1000)))
    b2 = found[2]
    theorem_bias = (
        found,
        [
            x % PRIME
            for x in (
                p + HALF * r * w,
                p + HALF * r * w,
                r**2 * (1 - h) ** 2 * s * (1 - s),
            )
        ],
    )
    theorem_missing = (
        missed,
        [
            x % PRIME
            for x in (
                p**2 + (1 - c) * p * r * w + HALF * r**2 * w**2,
                b2 * ((5 - c) * p + 4 * r * w),
                b2
                * (
                    -(1 - c) * p**2
                    + (3 + 3 * h - 7 * w - c * (1 - w)) * p * r
                    + 3 * (h - w**2) * r**2
                    + 8 * b2
                ),
            )
        ],
    )
    return locals()


@claims(
    SOURCE,
    theorem_ranges="the theorem on (63): c, s and w are from 0 to 1",
    theorem_gain="the theorem on (63): the gain, and every term of it is positive",
)
def algebra(rng):
    # axes along d1, s1 and their normal; h is |d1|^2, and 1 - h is |s1|^2
    h, x, y, z, p, r, c, w, b = sp.symbols("h x y z p r c w b", positive=True)
    d1, s1 = sp.Matrix([sp.sqrt(h), 0, 0]), sp.Matrix([0, sp.sqrt(1 - h), 0])
    d2 = sp.Matrix([x, y, z])
    cross = d1.cross(d2)
    square = sp.expand(cross.dot(cross) + s1.dot(d2) ** 2)  # of qbar
    share, s = square / d2.dot(d2), 1 - s1.dot(d2) ** 2 / (1 - h) / square
    theorem_ranges = (
        [sp.cancel(v) for v in (share, 1 - share, s, 1 - s, s + h * (1 - s))],
        [
            sp.cancel(v)
            for v in (
                (y**2 + h * z**2) / (x**2 + y**2 + z**2),
                (x**2 + (1 - h) * z**2) / (x**2 + y**2 + z**2),
                h * z**2 / (y**2 + h * z**2),
                y**2 / (y**2 + h * z**2),
                (h * z**2 + h * y**2) / (y**2 + h * z**2),
            )
        ],
    )
    a, u = p + r * w / 2, 1 - c
    along = p**2 + u * p * r * w + r**2 * w**2 / 2
    mixed = b * ((5 - c) * p + 4 * r * w)
    across = (
        -u * p**2
        + (3 + 3 * h - 7 * w - c * (1 - w)) * p * r
        + 3 * (h - w**2) * r**2
        + 8 * b**2
    )
    twice = 2 * (a**2 * along + 2 * a * b * mixed + b**2 * across)
    # squares, and products of what is not negative
    theorem_gain = (
        [sp.expand(twice - (a**2 + b**2) ** 2)],
        [
            sp.expand(
                a**2 * ((p - r * w / 2) ** 2 + r**2 * w**2 / 2 + 2 * u * p * r * w)
                + b**2
                * (
                    (14 + 2 * u) * p**2
                    + (4 + 10 * w + 6 * h + 2 * u) * p * r
                    + (3 * w**2 / 2 + 6 * h) * r**2
                )
                + 15 * b**4
            )
        ],
    )
    return locals()
