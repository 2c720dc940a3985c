"""Peng and Choukroun, section 3: singular cases, Table 1, eqs. (16) to (28)."""

import numpy as np
from scipy.spatial.transform import Rotation

from errata.claim import MISPRINTED, claim
from errata.geometry import (
    Pair,
    attitude,
    directions,
    pair,
    qbar,
    quaternion,
    turn,
    unit,
)

of = claim("quaternion")
ZERO = 1e-9  # below: a vector that should vanish; random ones are far above


def singular_pairs(rng):
    """A pair of each of the cases A to D, half turns too, and regular ones."""
    r1, r2 = directions(2, rng)
    plane = r1 + 0.4 * r2
    axes = [r1, r1, r1, r2, r2, plane, plane, np.cross(r1, r2), rng.standard_normal(3)]
    angles = [0, 1.1, np.pi, -0.8, np.pi, 2.0, np.pi, 1.0, 0.7]
    return [Pair(turn(*x), r1, r2) for x in zip(axes, angles, strict=True)]


def vanishes(v):
    """Whether a vector is zero."""
    return bool(np.linalg.norm(v) < ZERO)


@of("Table 1: cases A to D are all there are")
def table_1(rng):
    pairs = singular_pairs(rng) + [pair(rng) for _ in range(5)]
    truth = [vanishes(qbar(g.vectors)) for g in pairs]
    printed = [
        (vanishes(g.d1) and vanishes(g.d2))
        or (vanishes(g.d1) and not vanishes(g.d2))
        or (not vanishes(g.d1) and vanishes(g.d2))
        or (vanishes(np.cross(g.d1, g.d2)) and not vanishes(g.d1))
        for g in pairs
    ]
    return truth, printed


def rotation(g):
    """Axis times sine of the half angle, up to sign, from the attitude itself."""
    return np.outer(g.q[:3], g.q[:3])


@of("Table 1 and after (17): case A is the zero attitude")
def case_a(rng):
    pairs = [pair(rng), *singular_pairs(rng)]
    truth = [vanishes(g.q[:3]) for g in pairs]
    printed = [vanishes(g.d1) and vanishes(g.d2) for g in pairs]
    return truth, printed


@of("(16)")
def eq_16(rng):
    g = singular_pairs(rng)[0]
    printed = g.b1
    return g.r1, printed


@of("(17)")
def eq_17(rng):
    g = singular_pairs(rng)[0]
    printed = g.b2
    return g.r2, printed


@of("Table 1, B: a rotation around the first vector; d2 is normal to it")
def case_b(rng):
    q, (r1, r2) = quaternion(rng), directions(2, rng)
    axis = unit(q[:3])
    g = Pair(turn(axis, 1.1), axis, r2)
    free = Pair(turn(r1, 1.1), r2, axis)
    other = vanishes(free.d1)
    printed = [vanishes(g.d1), vanishes([g.d2 @ g.r1])]
    return [True, True, False], [*printed, other]


@of("Table 1, C: a rotation around the second vector")
def case_c(rng):
    q, (r1, r2) = quaternion(rng), directions(2, rng)
    axis = unit(q[:3])
    g = Pair(turn(axis, 1.1), r1, axis)
    free = Pair(turn(r1, 1.1), r1, r2)
    other = vanishes(free.d2)
    printed = [vanishes(g.d2), vanishes([g.d1 @ g.r2])]
    return [True, True, False], [*printed, other]


def normal_pair(angle, rng, second=False):
    """A turn about one of two perpendicular vectors."""
    r1, r2 = directions(2, rng)
    r2 = unit(np.cross(r1, r2))
    return Pair(turn(r2 if second else r1, angle), r1, r2)


@of("(18)")
def eq_18(rng):
    angle = rng.uniform(0, np.pi)
    g = normal_pair(angle, rng)
    printed = np.linalg.norm(g.d2)
    return np.sin(angle / 2), printed


@of("(19)")
def eq_19(rng):
    angle = rng.uniform(0, np.pi)
    g = normal_pair(angle, rng)
    printed = np.linalg.norm(g.s2)
    return np.cos(angle / 2), printed


@of("(20)")
def eq_20(rng):
    (r,), angle = directions(1, rng), rng.uniform(0, np.pi)
    v = unit(np.cross(r, rng.standard_normal(3)))
    truth = np.concatenate([r, np.cos(angle) * v - np.sin(angle) * np.cross(r, v)])
    printed = np.append(r * np.sin(angle / 2), np.cos(angle / 2))
    A = attitude(printed)
    return truth, np.concatenate([A @ r, A @ v])


@of("before (18): (20) brings b2 to r2 around r1")
def brings_b2_to_r2(rng):
    g = normal_pair(rng.uniform(-3.0, 3.0), rng)
    printed = Rotation.from_quat(g.q).apply([g.b1, g.b2])
    return [g.r1, g.r2], printed


@of("(21), a turn by either sign", MISPRINTED)
def eq_21(rng):
    g = normal_pair(-rng.uniform(0.2, 3.0), rng)
    sign = np.sign(g.r1 @ np.cross(g.b2, g.r2))
    printed = np.append(g.r1 * np.linalg.norm(g.d2), np.linalg.norm(g.s2))
    right = np.append(sign * g.r1 * np.linalg.norm(g.d2), np.linalg.norm(g.s2))
    return g.q, printed, right


@of("(21), a turn from 0 to 180 degrees, 180 included, where (5) is 0 / 0")
def eq_21_positive(rng):
    pairs = [normal_pair(a, rng) for a in (0.0, rng.uniform(0, np.pi), np.pi)]
    truth = [np.outer(g.q, g.q) for g in pairs]
    printed = [
        np.append(g.r1 * np.linalg.norm(g.d2), np.linalg.norm(g.s2)) for g in pairs
    ]
    breaks = np.append(-np.cross(pairs[2].s2, pairs[2].d2), pairs[2].s2 @ pairs[2].s2)
    return [*truth, np.zeros((4, 4))], [
        *(np.outer(q, q) for q in printed),
        np.outer(breaks, breaks),
    ]


def skew_pair(angle, rng, second=False):
    """A turn about one of two vectors that are not perpendicular."""
    while True:
        r1, r2 = directions(2, rng)
        if 0.2 < abs(r1 @ r2) < 0.8:
            return Pair(turn(r2 if second else r1, angle), r1, r2)


@of("after (21): the cross product takes the place of the second vector", MISPRINTED)
def case_b_cross_product(rng):
    # the cross product as it is, which is shorter than 1; case C says "normalized"
    g = skew_pair(rng.uniform(0.2, 3.0), rng)
    b3, r3 = np.cross(g.b1, g.b2), np.cross(g.r1, g.r2)
    printed = np.append(
        g.r1 * np.linalg.norm((b3 - r3) / 2), np.linalg.norm((b3 + r3) / 2)
    )
    right = np.append(
        g.r1 * np.linalg.norm((unit(b3) - unit(r3)) / 2),
        np.linalg.norm((unit(b3) + unit(r3)) / 2),
    )
    return g.q, printed, right


@of("(22) as an identity, a turn by either sign", MISPRINTED)
def eq_22(rng):
    angle = rng.uniform(0.2, 3.0)
    pairs = [normal_pair(angle, rng), normal_pair(-angle, rng)]
    truth = [np.cross(g.d2, g.s2) / np.linalg.norm(g.s2) for g in pairs]
    signs = [np.sign(g.r1 @ np.cross(g.b2, g.r2)) for g in pairs]
    printed = [g.r1 * np.linalg.norm(g.d2) for g in pairs]
    right = [s * g.r1 * np.linalg.norm(g.d2) for s, g in zip(signs, pairs, strict=True)]
    return truth, printed, right


@of("(22), its right side is the vector part of (5) and has the sign")
def eq_22_right_side(rng):
    g = normal_pair(rng.uniform(-3.0, 3.0), rng)
    printed = np.cross(g.d2, g.s2) / np.linalg.norm(g.s2)
    return g.q[:3], printed


@of("(23), a turn by either sign", MISPRINTED)
def eq_23(rng):
    g = normal_pair(-rng.uniform(0.2, 3.0), rng, second=True)
    sign = np.sign(g.r2 @ np.cross(g.b1, g.r1))
    printed = np.append(g.r2 * np.linalg.norm(g.d1), np.linalg.norm(g.s1))
    right = np.append(sign * g.r2 * np.linalg.norm(g.d1), np.linalg.norm(g.s1))
    return g.q, printed, right


@of("(23), a turn from 0 to 180 degrees; the normalised cross product otherwise")
def eq_23_positive(rng):
    g = skew_pair(rng.uniform(0, np.pi), rng, second=True)
    b3, r3 = unit(np.cross(g.b1, g.b2)), unit(np.cross(g.r1, g.r2))
    d1, s1 = (b3 - r3) / 2, (b3 + r3) / 2
    printed = np.append(g.r2 * np.linalg.norm(d1), np.linalg.norm(s1))
    return g.q, printed
