"""Peng and Choukroun, section 3, case D: eqs. (24) to (28)."""

import numpy as np

from errata.claim import FALSE, MISPRINTED, claims
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

SOURCE = "quaternion"


def plane_pair(angle, rng):
    """A turn about an axis in the plane of the two vectors."""
    r1, r2 = directions(2, rng)
    return Pair(turn(unit(r1) + rng.uniform(0.3, 2) * r2, angle), r1, r2)


@claims(
    SOURCE,
    twist_and_swing=(
        "case D: every turn is one about b1 x b2 and one about an axis in the plane"
    ),
    normal_turn=(
        "case D: a turn about b1 x b2 does not leave d1 and d2 parallel; Fig. 4"
    ),
    figure_3_left="Fig. 3, left: about b1 + b2, d1 and d2 are opposite",
    figure_3_right="Fig. 3, right: about b1 - b2, d1 and d2 are the same",
    composition_of_two=(
        "case D: the general case is a composition of these two",
        FALSE,
    ),
    line_of_the_planes="case D: the turn is about the line in which both planes meet",
    eq_25=("(25), denominator †", MISPRINTED),
    eq_25_half_turn=("(25), a half turn", MISPRINTED),
    eq_26=("(26) †", MISPRINTED),
    unambiguous=(
        "case D, end: unambiguous from the cross product alone, half turns too",
        FALSE,
    ),
)
def parallel_differences(rng):
    angle = rng.uniform(0.3, 2.8)
    g, half = plane_pair(angle, rng), plane_pair(np.pi, rng)
    eq_24 = np.zeros((2, 3)), np.array([np.cross(v.d1, v.d2) for v in (g, half)])
    r1, r2 = directions(2, rng)
    n, q = unit(np.cross(r1, r2)), pair(rng).q
    twist = unit(np.append(n * (n @ q[:3]), q[3]))
    twist_and_swing = 0.0, n @ multiply(q, twist * [-1, -1, -1, 1])[:3]
    normal = Pair(turn(n, angle), r1, r2)
    normal_turn = False, vanishes(np.cross(normal.d1, normal.d2))
    # from b to r is as good: d changes its sign
    left, right = (Pair(turn(axis, 1.2), r1, r2) for axis in (r1 + r2, r1 - r2))
    figure_3_left = left.d1, -left.d2
    figure_3_right = right.d1, right.d2
    first, second = rng.uniform(0.4, 2.6, 2)
    two = multiply(turn(r1 + r2, first), turn(r1 - r2, second))
    # about an axis that is a combination of the two the differences are parallel
    one = turn(first * unit(r1 + r2) + second * unit(r1 - r2), 1.0)
    composed, combined = Pair(two, r1, r2), Pair(one, r1, r2)
    composition_of_two = (
        True,
        vanishes(qbar(composed.vectors)),
        vanishes(qbar(combined.vectors)),
    )
    line = unit(np.cross(np.cross(g.b1, g.b2), np.cross(g.r1, g.r2)))
    line_of_the_planes = np.outer(unit(g.q[:3]), unit(g.q[:3])), np.outer(line, line)
    b3, r3 = unit(np.cross(g.b1, g.b2)), unit(np.cross(g.r1, g.r2))
    eq_25 = (
        unit(g.q[:3]),
        np.cross(b3, r3) / np.linalg.norm(np.cross(g.b2, g.r2)),
        np.cross(b3, r3) / np.linalg.norm(np.cross(b3, r3)),
    )
    # both planes are one: b3 x r3 = 0; the axis is normal to d, and in the plane
    longer = max((half.d1, half.d2), key=np.linalg.norm)
    c3, s3 = unit(np.cross(half.b1, half.b2)), unit(np.cross(half.r1, half.r2))
    eq_25_half_turn = (
        np.outer(half.q[:3], half.q[:3]),
        np.outer(np.cross(c3, s3), np.cross(c3, s3)),
        np.outer(unit(np.cross(longer, s3)), unit(np.cross(longer, s3))),
    )
    eq_26 = np.cos(angle), g.b2 @ r3, b3 @ r3
    v, A = pair(rng), attitude
    eq_27 = (
        A(v.q) @ unit(np.cross(v.r1, v.r2)),
        np.cross(v.b1, v.b2) / np.linalg.norm(np.cross(v.b1, v.b2)),
    )
    eq_28 = (
        A(v.q).T @ unit(np.cross(v.b1, v.b2)),
        np.cross(v.r1, v.r2) / np.linalg.norm(np.cross(v.r1, v.r2)),
    )
    halves = [Pair(turn(axis, np.pi), r1, r2) for axis in (r1 + r2, r1 - 0.5 * r2)]
    normals = [unit(np.cross(x.b1, x.b2)) for x in halves]
    d1 = [x.d1 for x in halves]
    unambiguous = (
        True,  # two attitudes show the same vector; the differences tell them apart
        not vanishes(np.diff(normals, axis=0)),
        not vanishes(np.diff(d1, axis=0)),
    )
    return locals()
