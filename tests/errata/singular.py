"""Peng and Choukroun, section 3: singular cases, sequential rotations, (16) to (28)."""

import numpy as np

from errata.claim import FALSE, MISPRINTED, claims
from errata.geometry import (
    AXES,
    Pair,
    attitude,
    directions,
    multiply,
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
            skewed.r1 * norm((unit(b3) - unit(r3)) / 2), norm((unit(b3) + unit(r3)) / 2)
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


# section 3, case D: eqs. (24) to (28).


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
    normal_turn_breaks=(
        "case D: the turn about the normal necessarily breaks the parallelism",
        FALSE,
    ),
    figure_3_left="Fig. 3, left: about b1 + b2, d1 and d2 are opposite",
    figure_3_right="Fig. 3, right: about b1 - b2, d1 and d2 are the same",
    composition_of_two=(
        "case D: the general case is a composition of these two",
        FALSE,
    ),
    line_of_the_planes="case D: the turn is about the line in which both planes meet",
    line_of_one_plane=(
        "case D: the turn is about the line in which both planes meet, half turns too",
        FALSE,
    ),
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
    # after a half turn in the plane it makes a half turn about another axis there
    swings = [turn(r1 + 0.3 * r2, a) for a in (angle, np.pi)]
    both = [Pair(multiply(swing, turn(n, angle)), r1, r2) for swing in swings]
    normal_turn_breaks = (
        [not vanishes(np.cross(x.d1, x.d2)) for x in both],
        [True, True],
        [abs(q[3]) > ZERO for q in swings],
    )
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
    # both planes are one, and meet in all of it; its axis is one line of it
    normals = np.stack([np.cross(half.b1, half.b2), np.cross(half.r1, half.r2)])
    meeting = np.linalg.svd(normals)[2][np.linalg.matrix_rank(normals, 1e-9) :]
    axis = unit(np.cross(max((half.d1, half.d2), key=np.linalg.norm), normals[1]))
    line_of_one_plane = (
        np.outer(half.q[:3], half.q[:3]),
        meeting.T @ meeting,
        np.outer(axis, axis),
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


# section 3.1: sequential rotations, Table 2.


def turned(g, axis):
    """The vectors with the reference frame turned by 180 degrees about an axis."""
    R = 2 * np.outer(axis, axis) - np.eye(3)
    return np.stack([g.b1, g.b2, R @ g.r1, R @ g.r2])


@claims(
    SOURCE,
    half_turn_x="section 3.1, half turn about x",
    half_turn_y="section 3.1, half turn about y",
    half_turn_z=("section 3.1, third half turn, labelled x †", MISPRINTED),
    composed="section 3.1: R to C, then C to B, composed, is R to B",
)
def half_turns(rng):
    q1, q2, q3, q4 = q = pair(rng).q
    half_turn_x = multiply([1, 0, 0, 0], q), [q4, -q3, q2, -q1]
    half_turn_y = multiply([0, 1, 0, 0], q), [q3, q4, -q1, -q2]
    half_turn_z = (
        [-q2, q1, q4, -q3],
        multiply([1, 0, 0, 0], q),
        multiply([0, 0, 1, 0], q),
    )
    r1, r2 = directions(2, rng)
    g = Pair(turn(r1, 1.0), r1, r2)  # singular as it is
    from_c = [(np.append(axis, 0), turned(g, axis)) for axis in AXES.values()]
    e, vectors = max(from_c, key=lambda x: np.linalg.norm(qbar(x[1])))
    both = multiply(e, unit(qbar(vectors)))
    composed = np.outer(g.q, g.q), np.outer(both, multiply(e, unit(qbar(vectors))))
    return locals()


def parallel(u, v):
    """Whether two vectors are parallel, a zero vector with any."""
    return vanishes(np.cross(u, v))


def across(v, axis):
    """A vector without its component along the axis."""
    return v - axis * (axis @ v)


def case_a_pairs(axis, rng):
    """Identities: a vector along the axis, both in a plane with it, and neither."""
    r1, r2 = directions(2, rng)
    for u, v in ((axis, r2), (r1, axis), (r1, unit(r1 + axis)), (r1, r2)):
        yield Pair([0, 0, 0, 1], u, v)


def case_b_pairs(axis, rng, second=False):
    """Turns about a vector: along the axis; second condition only; and regular ones."""
    r1, r2 = directions(2, rng)
    n = np.cross(r1, r2)
    angle = 2 * np.arctan2(n @ axis, -np.cross(n, r1) @ axis)  # a column that vanishes
    found = [(axis, r2, 0.8), (r1, r2, angle), (r1, r2, np.pi), (r1, r2, 0.8)]
    for u, v, a in found:
        yield Pair(turn(u, a), v, u) if second else Pair(turn(u, a), u, v)


def singular_when_turned(g, axis):
    """The truth of Table 2: whether the estimate in the turned frame is 0 / 0."""
    return vanishes(qbar(turned(g, axis)))


@claims(SOURCE, table_2_a="Table 2, A, and its differences")
def identities(rng):
    pairs = [(axis, g) for axis in AXES.values() for g in case_a_pairs(axis, rng)]
    table_2_a = (
        [singular_when_turned(g, axis) for axis, g in pairs],
        [
            parallel(g.b1, axis)
            or parallel(g.b2, axis)
            or parallel(across(g.r1, axis), across(g.r2, axis))
            for axis, g in pairs
        ],
    )
    return locals()


def second_condition(sum2, r1, k):
    """(b2y + r2y) r1z = k (b2z + r2z) r1y of Table 2, x in the last place."""
    return abs(sum2[0] * r1[1] - k * sum2[1] * r1[0]) < 1e-9


def in_plane(v, axis):
    """The two components of a vector normal to an axis."""
    return [c for c, a in zip(v, axis, strict=True) if a == 0]


def conditions(rng, second):
    """What Table 2, B or C, is about, over all axes and pairs, and the truth."""
    truth, found = [], []
    for axis in AXES.values():
        for g in case_b_pairs(axis, rng, second):
            truth.append(singular_when_turned(g, axis))
            one, b, r = (g.b2, g.b1, g.r1) if second else (g.b1, g.b2, g.r2)
            plane = in_plane(b + r, axis), in_plane(one, axis)
            (p, q), (s, t) = plane
            free = p * t / (q * s) if q * s else 1.0  # a k that makes it true
            known = parallel(one, axis), second_condition(*plane, 1.0)
            along = vanishes([(b - r) @ axis])
            found.append((*known, second_condition(*plane, free), along))
    return truth, found


def either(conditions):
    """Whether one of the conditions holds, the second with b2x = r2x.

    x: b1 || axis; y, k: the second condition with 1 or with a free k; z: b2x = r2x.
    """
    return [x or (y and z) for x, y, _, z in conditions]


@claims(
    SOURCE,
    table_2_b_and=("Table 2, B: AND between the conditions", MISPRINTED),
    table_2_b_constant=("Table 2, B: an arbitrary constant k", MISPRINTED),
    table_2_c_and=("Table 2, C: AND between the conditions", MISPRINTED),
    table_2_c_constant=("Table 2, C: an arbitrary constant k", MISPRINTED),
    # after a half turn about r1 the sum b2 + r2 is along r1, and nothing is singular
    table_2_along=("Table 2, B and C: the conditions without b2x = r2x", MISPRINTED),
)
def conditions_of_turned_frames(rng):
    (b, B), (c, C) = conditions(rng, False), conditions(rng, True)
    table_2_b_and = b, [x and y for x, y, _, _ in B], either(B)
    table_2_b_constant = b, [x or k for x, _, k, _ in B], either(B)
    table_2_c_and = c, [x and y for x, y, _, _ in C], either(C)
    table_2_c_constant = c, [x or k for x, _, k, _ in C], either(C)
    table_2_along = b + c, [x or y for x, y, _, _ in B + C], either(B + C)
    return locals()


def case_d_pairs(axis, rng):
    """Turns in the plane of the vectors, the second with a column that vanishes."""
    r1, r2 = directions(2, rng)
    u = unit(r1 + 0.6 * r2)
    n = np.cross(r1, r2)
    angle = 2 * np.arctan2(n @ axis, -np.cross(n, u) @ axis)
    for a in (0.8, angle, np.pi):
        yield Pair(turn(u, a), r1, r2)


@claims(
    SOURCE,
    table_2_d="Table 2, D",
    turned_differences="section 3.1, the differences d1C, d2C in the four cases",
    turned_difference_of_none="section 3.1, d1C = [0, r1y, r1z] where d1 = 0",
)
def turns_in_the_plane(rng):
    pairs = [
        (axis, g)
        for axis in AXES.values()
        for g in [*case_d_pairs(axis, rng), *case_b_pairs(axis, rng)]
    ]
    table_2_d = (
        [singular_when_turned(g, axis) for axis, g in pairs],
        [
            parallel(g.d1 + across(g.r1, axis), g.d2 + across(g.r2, axis))
            for axis, g in pairs
        ],
    )
    g = pair(rng)
    b1, b2, r1, r2 = turned(g, AXES["x"])
    (bx, by, bz), (rx, ry, rz) = g.b1, g.r1
    (cx, cy, cz), (sx, sy, sz) = g.b2, g.r2
    turned_differences = (
        [(b1 - r1) / 2, (b2 - r2) / 2],
        [
            [(bx - rx) / 2, (by + ry) / 2, (bz + rz) / 2],
            [(cx - sx) / 2, (cy + sy) / 2, (cz + sz) / 2],
        ],
    )
    same = Pair(turn(g.r1, 1.0), g.r1, g.r2)
    b1, _, r1, _ = turned(same, AXES["x"])
    turned_difference_of_none = (b1 - r1) / 2, [0, g.r1[1], g.r1[2]]
    return locals()
