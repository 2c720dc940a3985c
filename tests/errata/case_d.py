"""Peng and Choukroun, section 3, case D: eqs. (24) to (28)."""

import numpy as np

from errata.claim import FALSE, MISPRINTED, claim
from errata.geometry import (
    Pair,
    attitude,
    directions,
    multiply,
    pair,
    qbar,
    turn,
    unit,
)
from errata.singular import vanishes

of = claim("quaternion")


def plane_pair(angle, rng):
    """A turn about an axis in the plane of the two vectors."""
    r1, r2 = directions(2, rng)
    return Pair(turn(unit(r1) + rng.uniform(0.3, 2) * r2, angle), r1, r2)


@of("(24)")
def eq_24(rng):
    pairs = [plane_pair(2.0, rng), plane_pair(np.pi, rng)]
    printed = np.array([np.cross(g.d1, g.d2) for g in pairs])
    return np.zeros((2, 3)), printed


@of("case D: every turn is one about b1 x b2 and one about an axis in the plane")
def twist_and_swing(rng):
    g = pair(rng)
    n = unit(np.cross(g.r1, g.r2))
    twist = unit(np.append(n * (n @ g.q[:3]), g.q[3]))
    swing = multiply(g.q, twist * [-1, -1, -1, 1])
    printed = n @ swing[:3]
    return 0.0, printed


@of("case D: a turn about b1 x b2 does not leave d1 and d2 parallel; Fig. 4")
def normal_turn(rng):
    r1, r2 = directions(2, rng)
    g = Pair(turn(np.cross(r1, r2), rng.uniform(0.2, 3.1)), r1, r2)
    printed = vanishes(np.cross(g.d1, g.d2))
    return False, printed


@of("Fig. 3, left: about b1 + b2, d1 and d2 are opposite")
def figure_3_left(rng):
    b1, b2 = directions(2, rng)
    g = Pair(turn(b1 + b2, 1.2), b1, b2)  # from b to r is as good: d changes its sign
    printed = -g.d2
    return g.d1, printed


@of("Fig. 3, right: about b1 - b2, d1 and d2 are the same")
def figure_3_right(rng):
    b1, b2 = directions(2, rng)
    g = Pair(turn(b1 - b2, 1.2), b1, b2)
    printed = g.d2
    return g.d1, printed


@of("case D: the general case is a composition of these two", FALSE)
def composition_of_two(rng):
    r1, r2 = directions(2, rng)
    first, second = rng.uniform(0.4, 2.6, 2)
    two = multiply(turn(r1 + r2, first), turn(r1 - r2, second))
    # about an axis that is a combination of the two the differences are parallel
    one = turn(first * unit(r1 + r2) + second * unit(r1 - r2), 1.0)
    composed, combined = Pair(two, r1, r2), Pair(one, r1, r2)
    printed = vanishes(qbar(composed.vectors))
    right = vanishes(qbar(combined.vectors))
    return True, printed, right


@of("case D: the turn is about the line in which both planes meet")
def line_of_the_planes(rng):
    g = plane_pair(2.0, rng)
    printed = np.cross(np.cross(g.b1, g.b2), np.cross(g.r1, g.r2))
    return np.outer(unit(g.q[:3]), unit(g.q[:3])), np.outer(
        unit(printed), unit(printed)
    )


@of("(25), denominator †", MISPRINTED)
def eq_25(rng):
    g = plane_pair(rng.uniform(0.3, 2.8), rng)
    b3, r3 = unit(np.cross(g.b1, g.b2)), unit(np.cross(g.r1, g.r2))
    printed = np.cross(b3, r3) / np.linalg.norm(np.cross(g.b2, g.r2))
    right = np.cross(b3, r3) / np.linalg.norm(np.cross(b3, r3))
    return unit(g.q[:3]), printed, right


@of("(25), a half turn", MISPRINTED)
def eq_25_half_turn(rng):
    # both planes are one: b3 x r3 = 0; the axis is normal to d, and in the plane
    g = plane_pair(np.pi, rng)
    n = unit(np.cross(g.r1, g.r2))
    longer = max((g.d1, g.d2), key=np.linalg.norm)
    b3, r3 = unit(np.cross(g.b1, g.b2)), unit(np.cross(g.r1, g.r2))
    printed = np.outer(np.cross(b3, r3), np.cross(b3, r3))
    right = np.outer(unit(np.cross(longer, n)), unit(np.cross(longer, n)))
    return np.outer(g.q[:3], g.q[:3]), printed, right


@of("(26) †", MISPRINTED)
def eq_26(rng):
    angle = rng.uniform(0.3, 2.8)
    g = plane_pair(angle, rng)
    b3, r3 = unit(np.cross(g.b1, g.b2)), unit(np.cross(g.r1, g.r2))
    printed = g.b2 @ r3
    right = b3 @ r3
    return np.cos(angle), printed, right


@of("(27)")
def eq_27(rng):
    g = pair(rng)
    printed = np.cross(g.b1, g.b2) / np.linalg.norm(np.cross(g.b1, g.b2))
    return attitude(g.q) @ unit(np.cross(g.r1, g.r2)), printed


@of("(28)")
def eq_28(rng):
    g = pair(rng)
    printed = np.cross(g.r1, g.r2) / np.linalg.norm(np.cross(g.r1, g.r2))
    return attitude(g.q).T @ unit(np.cross(g.b1, g.b2)), printed


@of("case D, end: unambiguous from the cross product alone, half turns too", FALSE)
def unambiguous(rng):
    r1, r2 = directions(2, rng)
    two = [Pair(turn(axis, np.pi), r1, r2) for axis in (r1 + r2, r1 - 0.5 * r2)]
    b3 = [unit(np.cross(g.b1, g.b2)) for g in two]
    d1 = [g.d1 for g in two]
    printed = not vanishes(np.diff(b3, axis=0))  # two attitudes show the same vector
    right = not vanishes(np.diff(d1, axis=0))  # the differences tell them apart
    return True, printed, right
