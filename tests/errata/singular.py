"""Peng and Choukroun, section 3: singular cases, Table 1, eqs. (16) to (28)."""

import numpy as np

from errata.claim import MISPRINTED, claims
from errata.geometry import (
    Pair,
    attitude,
    directions,
    pair,
    qbar,
    turn,
    unit,
)

SOURCE = "quaternion"
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


def turned_about(angle, rng, second=False, normal=True):
    """A turn about one of two vectors, which are perpendicular, or far from it."""
    while True:
        r1, r2 = directions(2, rng)
        r2 = unit(np.cross(r1, r2)) if normal else r2
        if normal or 0.2 < abs(r1 @ r2) < 0.8:
            return Pair(turn(r2 if second else r1, angle), r1, r2)


def norm(v):
    """Length of a vector."""
    return np.linalg.norm(v)


@claims(
    SOURCE,
    table_1="Table 1: cases A to D are all there are",
    case_a="Table 1 and after (17): case A is the zero attitude",
    case_b="Table 1, B: a rotation around the first vector; d2 is normal to it",
    case_c="Table 1, C: a rotation around the second vector",
)
def cases(rng):
    pairs = singular_pairs(rng) + [pair(rng) for _ in range(5)]
    table_1 = (
        [vanishes(qbar(g.vectors)) for g in pairs],
        [
            (vanishes(g.d1) and vanishes(g.d2))
            or (vanishes(g.d1) and not vanishes(g.d2))
            or (not vanishes(g.d1) and vanishes(g.d2))
            or (vanishes(np.cross(g.d1, g.d2)) and not vanishes(g.d1))
            for g in pairs
        ],
    )
    case_a = (
        [vanishes(g.q[:3]) for g in pairs],
        [vanishes(g.d1) and vanishes(g.d2) for g in pairs],
    )
    g = pairs[0]
    eq_16 = g.r1, g.b1
    eq_17 = g.r2, g.b2
    (axis, free), about = directions(2, rng), [True, True, False]
    g, other = Pair(turn(axis, 1.1), axis, free), Pair(turn(axis, 1.1), free, axis)
    case_b = about, [vanishes(g.d1), vanishes([g.d2 @ g.r1]), vanishes(other.d1)]
    g, other = other, g
    case_c = about, [vanishes(g.d2), vanishes([g.d1 @ g.r2]), vanishes(other.d2)]
    return locals()


@claims(
    SOURCE,
    brings_b2_to_r2="before (18): (20) brings b2 to r2 around r1",
    eq_21=("(21), a turn by either sign", MISPRINTED),
    eq_21_positive=(
        "(21), a turn from 0 to 180 degrees, 180 included, where (5) is 0 / 0"
    ),
    case_b_cross_product=(
        "after (21): the cross product takes the place of the second vector",
        MISPRINTED,
    ),
    eq_22=("(22) as an identity, a turn by either sign", MISPRINTED),
    eq_22_right_side="(22), its right side is the vector part of (5) and has the sign",
    eq_23=("(23), a turn by either sign", MISPRINTED),
    eq_23_positive=(
        "(23), a turn from 0 to 180 degrees; the normalised cross product otherwise"
    ),
)
def turns_about_a_vector(rng):
    angle = rng.uniform(0.2, 3.0)
    g, back = turned_about(angle, rng), turned_about(-angle, rng)
    eq_18 = np.sin(angle / 2), norm(g.d2)
    eq_19 = np.cos(angle / 2), norm(g.s2)
    r, v = g.r1, g.r2
    half = np.append(r * np.sin(angle / 2), np.cos(angle / 2))
    eq_20 = g.q, np.append(r * np.sin(angle / 2), np.cos(angle / 2))
    A = attitude(half)
    moved = np.cos(angle) * v - np.sin(angle) * np.cross(r, v)
    brings_b2_to_r2 = [r, v, moved], [A.T @ g.b1, A.T @ g.b2, A @ v]
    sign = np.sign(back.r1 @ np.cross(back.b2, back.r2))
    eq_21 = (
        back.q,
        np.append(back.r1 * norm(back.d2), norm(back.s2)),
        np.append(sign * back.r1 * norm(back.d2), norm(back.s2)),
    )
    none, full = turned_about(0.0, rng), turned_about(np.pi, rng)
    breaks = np.append(-np.cross(full.s2, full.d2), full.s2 @ full.s2)
    eq_21_positive = (
        [*np.abs([none.q, g.q, full.q]), np.zeros(4)],
        [
            *[
                np.abs(np.append(x.r1 * norm(x.d2), norm(x.s2)))
                for x in (none, g, full)
            ],
            breaks,
        ],
    )
    # the cross product as it is, which is shorter than 1; case C says "normalized"
    skewed = turned_about(angle, rng, normal=False)
    b3, r3 = np.cross(skewed.b1, skewed.b2), np.cross(skewed.r1, skewed.r2)
    case_b_cross_product = (
        skewed.q,
        np.append(skewed.r1 * norm((b3 - r3) / 2), norm((b3 + r3) / 2)),
        np.append(
            skewed.r1 * norm((unit(b3) - unit(r3)) / 2),
            norm((unit(b3) + unit(r3)) / 2),
        ),
    )
    pairs = [g, back]
    signs = [np.sign(x.r1 @ np.cross(x.b2, x.r2)) for x in pairs]
    eq_22 = (
        [np.cross(x.d2, x.s2) / norm(x.s2) for x in pairs],
        [x.r1 * norm(x.d2) for x in pairs],
        [s * x.r1 * norm(x.d2) for s, x in zip(signs, pairs, strict=True)],
    )
    eq_22_right_side = back.q[:3], np.cross(back.d2, back.s2) / norm(back.s2)
    other = turned_about(-angle, rng, second=True)
    sign = np.sign(other.r2 @ np.cross(other.b1, other.r1))
    eq_23 = (
        other.q,
        np.append(other.r2 * norm(other.d1), norm(other.s1)),
        np.append(sign * other.r2 * norm(other.d1), norm(other.s1)),
    )
    skewed = turned_about(angle, rng, second=True, normal=False)
    b3, r3 = unit(np.cross(skewed.b1, skewed.b2)), unit(np.cross(skewed.r1, skewed.r2))
    d1, s1 = (b3 - r3) / 2, (b3 + r3) / 2
    eq_23_positive = skewed.q, np.append(skewed.r2 * norm(d1), norm(s1))
    return locals()
