"""Peng and Choukroun, section 3.1: sequential rotations, Table 2."""

import numpy as np

from errata.claim import MISPRINTED, claims
from errata.geometry import AXES, Pair, directions, multiply, pair, qbar, turn, unit
from errata.singular import vanishes

SOURCE = "quaternion"


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


@claims(
    SOURCE,
    table_2_b_and=("Table 2, B: AND between the conditions", MISPRINTED),
    table_2_b_constant=("Table 2, B: an arbitrary constant k", MISPRINTED),
    table_2_c_and=("Table 2, C: AND between the conditions", MISPRINTED),
    table_2_c_constant=("Table 2, C: an arbitrary constant k", MISPRINTED),
    # after a half turn about r1 the sum b2 + r2 is along r1, and nothing is singular
    table_2_along=(
        "Table 2, B and C: the conditions without b2x = r2x",
        MISPRINTED,
    ),
)
def turns_about_a_vector(rng):
    (b, B), (c, C) = conditions(rng, False), conditions(rng, True)
    # x: b1 || axis; y, k: the second condition with 1 or with a free k; z: along
    table_2_b_and = (
        b,
        [x and y for x, y, _, _ in B],
        [x or (y and z) for x, y, _, z in B],
    )
    table_2_b_constant = (
        b,
        [x or k for x, _, k, _ in B],
        [x or (y and z) for x, y, _, z in B],
    )
    table_2_c_and = (
        c,
        [x and y for x, y, _, _ in C],
        [x or (y and z) for x, y, _, z in C],
    )
    table_2_c_constant = (
        c,
        [x or k for x, _, k, _ in C],
        [x or (y and z) for x, y, _, z in C],
    )
    table_2_along = (
        b + c,
        [x or y for x, y, _, _ in B + C],
        [x or (y and z) for x, y, _, z in B + C],
    )
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
