"""Peng and Choukroun, section 3.1: sequential rotations, Table 2."""

from copy import deepcopy

import numpy as np

from errata.claim import MISPRINTED, add, claim
from errata.geometry import AXES, Pair, directions, multiply, pair, qbar, turn, unit
from errata.singular import vanishes

of = claim("quaternion")


@of("section 3.1, half turn about x")
def half_turn_x(rng):
    q1, q2, q3, q4 = q = pair(rng).q
    printed = [q4, -q3, q2, -q1]
    return multiply([1, 0, 0, 0], q), printed


@of("section 3.1, half turn about y")
def half_turn_y(rng):
    q1, q2, q3, q4 = q = pair(rng).q
    printed = [q3, q4, -q1, -q2]
    return multiply([0, 1, 0, 0], q), printed


@of("section 3.1, third half turn, labelled x †", MISPRINTED)
def half_turn_z(rng):
    q1, q2, q3, q4 = q = pair(rng).q
    truth = [-q2, q1, q4, -q3]
    printed = multiply([1, 0, 0, 0], q)
    right = multiply([0, 0, 1, 0], q)
    return truth, printed, right


def turned(g, axis):
    """The vectors with the reference frame turned by 180 degrees about an axis."""
    R = 2 * np.outer(axis, axis) - np.eye(3)
    return np.stack([g.b1, g.b2, R @ g.r1, R @ g.r2])


@of("section 3.1: R to C, then C to B, composed, is R to B")
def composed(rng):
    r1, r2 = directions(2, rng)
    g = Pair(turn(r1, 1.0), r1, r2)  # singular as it is
    from_c = [(np.append(axis, 0), turned(g, axis)) for axis in AXES.values()]
    e, vectors = max(from_c, key=lambda x: np.linalg.norm(qbar(x[1])))
    printed = multiply(e, unit(qbar(vectors)))
    return np.outer(g.q, g.q), np.outer(printed, printed)


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


@of("Table 2, A, and its differences")
def table_2_a(rng):
    pairs = [(axis, g) for axis in AXES.values() for g in case_a_pairs(axis, rng)]
    truth = [singular_when_turned(g, axis) for axis, g in pairs]
    printed = [
        parallel(g.b1, axis)
        or parallel(g.b2, axis)
        or parallel(across(g.r1, axis), across(g.r2, axis))
        for axis, g in pairs
    ]
    return truth, printed


def second_condition(sum2, r1, k):
    """(b2y + r2y) r1z = k (b2z + r2z) r1y of Table 2, x in the last place."""
    return abs(sum2[0] * r1[1] - k * sum2[1] * r1[0]) < 1e-9


def in_plane(v, axis):
    """The two components of a vector normal to an axis."""
    return [c for c, a in zip(v, axis, strict=True) if a == 0]


def table_2_b(rng, form, second=False):
    """Truth and a form of Table 2, B or C, over all axes and pairs."""
    truth, found = [], []
    for axis in AXES.values():
        for g in case_b_pairs(axis, rng, second):
            truth.append(singular_when_turned(g, axis))
            one, b, r = (g.b2, g.b1, g.r1) if second else (g.b1, g.b2, g.r2)
            plane = in_plane(b + r, axis), in_plane(one, axis)
            along = vanishes([(b - r) @ axis])
            found.append(form(parallel(one, axis), plane, along))
    return truth, found


def as_printed(first, plane, along):
    """First AND second condition, k = 1."""
    return first and second_condition(*plane, 1.0)


def any_constant(first, plane, along):
    """First OR second condition, with some k that makes it true."""
    (a, b), (c, d) = plane
    return first or second_condition(*plane, a * d / (b * c))


def put_right(first, plane, along):
    """First OR second condition, k = 1, and no difference along the axis."""
    return first or (second_condition(*plane, 1.0) and along)


def enter_table_2(name, place, form, second=False):
    """The claim that a form of the conditions is misprinted."""

    def evaluate(rng):
        copy, other = deepcopy(rng), deepcopy(rng)
        truth = table_2_b(rng, put_right, second)[0]
        printed = table_2_b(copy, form, second)[1]
        right = table_2_b(other, put_right, second)[1]
        return truth, printed, right

    add("quaternion", f"Table 2, {place}", MISPRINTED, evaluate, name)


def without_along(first, plane, along):
    """As put right, but for the component along the axis."""
    return first or second_condition(*plane, 1.0)


enter_table_2("table_2_b_and", "B: AND between the conditions", as_printed)
enter_table_2("table_2_b_constant", "B: an arbitrary constant k", any_constant)
enter_table_2("table_2_c_and", "C: AND between the conditions", as_printed, second=True)
enter_table_2("table_2_c_constant", "C: an arbitrary constant k", any_constant, True)
# after a half turn about r1 the sum b2 + r2 is along r1, and nothing is singular
enter_table_2(
    "table_2_along", "B and C: the conditions without b2x = r2x", without_along
)


def case_d_pairs(axis, rng):
    """Turns in the plane of the vectors, the second with a column that vanishes."""
    r1, r2 = directions(2, rng)
    u = unit(r1 + 0.6 * r2)
    n = np.cross(r1, r2)
    angle = 2 * np.arctan2(n @ axis, -np.cross(n, u) @ axis)
    for a in (0.8, angle, np.pi):
        yield Pair(turn(u, a), r1, r2)


@of("Table 2, D")
def table_2_d(rng):
    pairs = [
        (axis, g)
        for axis in AXES.values()
        for g in [*case_d_pairs(axis, rng), *case_b_pairs(axis, rng)]
    ]
    truth = [singular_when_turned(g, axis) for axis, g in pairs]
    printed = [
        parallel(g.d1 + across(g.r1, axis), g.d2 + across(g.r2, axis))
        for axis, g in pairs
    ]
    return truth, printed


@of("section 3.1, the differences d1C, d2C in the four cases")
def turned_differences(rng):
    g = pair(rng)
    b1, b2, r1, r2 = turned(g, AXES["x"])
    truth = [(b1 - r1) / 2, (b2 - r2) / 2]
    (bx, by, bz), (rx, ry, rz) = g.b1, g.r1
    (cx, cy, cz), (sx, sy, sz) = g.b2, g.r2
    printed = [
        [(bx - rx) / 2, (by + ry) / 2, (bz + rz) / 2],
        [(cx - sx) / 2, (cy + sy) / 2, (cz + sz) / 2],
    ]
    return truth, printed


@of("section 3.1, d1C = [0, r1y, r1z] where d1 = 0")
def turned_difference_of_none(rng):
    r1, r2 = directions(2, rng)
    b1, _, r1_c, _ = turned(Pair(turn(r1, 1.0), r1, r2), AXES["x"])
    printed = [0, r1[1], r1[2]]
    return (b1 - r1_c) / 2, printed
