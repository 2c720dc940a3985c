"""Peng and Choukroun, abstract to section 2: the estimator, eqs. (1) to (15)."""

import numpy as np

from errata.claim import WORDING, add, claim
from errata.geometry import (
    Pair,
    attitude,
    directions,
    multiply,
    pair,
    quaternion,
    skew,
    turn,
    unit,
)

SOURCE = "quaternion"
of = claim(SOURCE)


@of("section 1: a quaternion is free of singularities, and minimal among such")
def singularity_free(rng):
    # a step of the quaternion turns by twice its length, in any direction and anywhere
    q = [*np.eye(4), *unit(rng.standard_normal((4, 4)))]
    steps = [unit(v - x * (x @ v)) for x in q for v in [rng.standard_normal(4)]]
    turned = [
        np.linalg.norm(attitude(x + 1e-6 * v) @ attitude(x).T - np.eye(3)) / np.sqrt(2)
        for x, v in zip(q, steps, strict=True)
    ]
    printed = 2e-6
    return np.array(turned) * 1e6, [printed * 1e6] * 8


add(
    SOURCE,
    'section 1: "none of the above-mentioned works feature some error analysis"; '
    "the page before cites [4] and [7] for theirs",
    WORDING,
)
add(SOURCE, 'section 1: "This raises the quaternion errors, and of whether"', WORDING)
add(SOURCE, 'section 2.2: "As noted in Section 2", which is the same section', WORDING)
add(SOURCE, "reference [19] is not cited", WORDING)
add(SOURCE, 'section 1: "[Chap. 5][9]" for "[9, Chap. 5]"', WORDING)
add(
    SOURCE,
    'language: "the plan spanned", "along with the x axis", "is follows", "can be get"',
    WORDING,
)
add(
    SOURCE,
    "E is an expectation and (55), H is (1) and (58), alpha a scalar part and an angle",
    WORDING,
)


add(SOURCE, "reference [13] bears the DOI of [8], 10.2514/1.22452", WORDING)
add(
    SOURCE,
    'reference [8] is "Survey of Nonlinear Attitude Estimation Methods"',
    WORDING,
)


def plane_of_attitudes(b, r, q):
    """Projector onto all quaternions that take r to b: two of them and their span."""
    two = np.stack([q, multiply(turn(r, 1.0), q)], axis=1)
    basis = np.linalg.qr(two)[0]
    return basis @ basis.T


def one_vector(rng):
    """A vector in both frames, with s and d, and the plane of its attitudes."""
    q, r = quaternion(rng), directions(1, rng)[0]
    b = attitude(q) @ r
    return (b + r) / 2, (b - r) / 2, b, r, plane_of_attitudes(b, r, q)


@of("(1)")
def eq_1(rng):
    s, d, _, _, plane = one_vector(rng)
    printed = np.block([[-skew(s), d[:, None]], [-d[None], np.zeros((1, 1))]]) @ plane
    return np.zeros((4, 4)), printed


@of("(2)")
def eq_2(rng):
    q, r = quaternion(rng), directions(1, rng)[0]
    b = attitude(q) @ r
    # the half turn about s takes r to b, and |s| is the cosine of half the angle
    truth = np.append(b, np.cos(np.arccos(b @ r) / 2))
    printed = (b + r) / 2
    return truth, np.append(attitude([*printed, 0]) @ r, np.linalg.norm(printed))


@of("(3)")
def eq_3(rng):
    q, r = quaternion(rng), directions(1, rng)[0]
    b = attitude(q) @ r
    truth = np.append(b, np.sin(np.arccos(b @ r) / 2))
    printed = (b - r) / 2
    return truth, np.append(r + 2 * printed, np.linalg.norm(printed))


@of("(4)")
def eq_4(rng):
    s, _, b, r, _ = one_vector(rng)
    truth = np.append(b, 1.0)
    printed = np.append(s, 0) / np.linalg.norm(s)
    return truth, np.append(attitude(printed) @ r, np.linalg.norm(printed))


@of("(5)")
def eq_5(rng):
    s, d, b, r, _ = one_vector(rng)
    truth = np.append(b, 1.0)
    printed = np.append(-np.cross(s, d), s @ s) / np.linalg.norm(s)
    return truth, np.append(attitude(printed) @ r, np.linalg.norm(printed))


@of("after (5): q1 and q2 are an orthonormal basis of the kernel")
def kernel(rng):
    s, d, _, _, plane = one_vector(rng)
    basis = np.stack([np.append(s, 0), np.append(-np.cross(s, d), s @ s)])
    printed = basis.T @ basis / (s @ s)
    return plane, printed


@of("(6)")
def eq_6(rng):
    s, d, _, _, plane = one_vector(rng)
    printed = np.append(d, 0) / np.linalg.norm(d)
    q4 = unit(np.append(np.cross(s, d), d @ d))
    return np.eye(4) - plane, np.outer(printed, printed) + np.outer(q4, q4)


@of("(7)")
def eq_7(rng):
    s, d, _, _, plane = one_vector(rng)
    printed = np.append(np.cross(s, d), d @ d) / np.linalg.norm(d)
    q3 = unit(np.append(d, 0))
    return np.eye(4) - plane, np.outer(printed, printed) + np.outer(q3, q3)


@of("after (7): q1 turns by 180 degrees, q2 by the least angle")
def angles_of_the_basis(rng):
    s, *_, plane = one_vector(rng)
    least = np.linalg.norm(plane[3])  # the greatest scalar part in the plane
    printed = [0.0, s @ s / np.linalg.norm(s)]
    return [attitude([*s, 0]).trace() + 1, least], printed  # the trace of a half turn


@of("(8)")
def eq_8(rng):
    g = pair(rng)
    length = np.sqrt(np.sum(np.cross(g.d1, g.d2) ** 2) + (g.s1 @ g.d2) ** 2)
    printed = np.append(np.cross(g.d1, g.d2), g.s1 @ g.d2) / length
    return g.q, printed


@of("(9)")
def eq_9(rng):
    g = pair(rng)
    printed = (g.b1 + g.r1) / 2
    return g.q, unit(np.append(np.cross(g.d1, g.d2), printed @ g.d2))


@of("(10)")
def eq_10(rng):
    g = pair(rng)
    printed = [(b - r) / 2 for b, r in ((g.b1, g.r1), (g.b2, g.r2))]
    return g.q, unit(np.append(np.cross(*printed), g.s1 @ printed[1]))


def conditions(rng):
    """The true quaternion, up to its length, as vector part and scalar part."""
    g = pair(rng)
    return g, 1.7 * g.q[:3], 1.7 * g.q[3]


@of("(11)")
def eq_11(rng):
    g, a, _ = conditions(rng)
    printed = g.d1
    return [0.0, *(g.b1 - g.r1) / 2], [printed @ a, *printed]


@of("(12)")
def eq_12(rng):
    g, a, _ = conditions(rng)
    printed = g.d2
    return [0.0, *(g.b2 - g.r2) / 2], [printed @ a, *printed]


@of("(13)")
def eq_13(rng):
    g, a, alpha = conditions(rng)
    printed = np.cross(g.s1, g.d1) @ a + g.d1 @ g.d1 * alpha
    return 0.0, printed


@of("(14)")
def eq_14(rng):
    g, a, alpha = conditions(rng)
    printed = np.cross(g.s2, g.d2) @ a + g.d2 @ g.d2 * alpha
    return 0.0, printed


@of("after (14): linearly dependent, and q unique up to its length")
def dependent(rng):
    g = pair(rng)
    rows = [np.append(g.d1, 0), np.append(g.d2, 0)]
    rows += [np.append(np.cross(s, d), d @ d) for s, d in ((g.s1, g.d1), (g.s2, g.d2))]
    printed = np.array(rows)
    return 3, np.linalg.matrix_rank(printed, tol=1e-9)


@of("(15)")
def eq_15(rng):
    g, a, _ = conditions(rng)
    printed = np.cross(g.d1, g.d2)
    return np.outer(unit(a), unit(a)), np.outer(unit(printed), unit(printed))


@of("after (15), the second and third line")
def eq_15_lines(rng):
    alpha = rng.standard_normal()
    g = Pair(quaternion(rng), *directions(2, rng), 0.3 * rng.standard_normal((4, 3)))
    truth = np.cross(g.s1, g.d1) @ np.cross(g.d1, g.d2) + g.d1 @ g.d1 * alpha
    printed = [
        g.s1 @ skew(g.d1) @ skew(g.d1) @ g.d2 + g.d1 @ g.d1 * alpha,
        g.s1 @ g.d1 * (g.d1 @ g.d2) - g.d1 @ g.d1 * (g.s1 @ g.d2) + g.d1 @ g.d1 * alpha,
    ]
    return [truth] * 2, printed


@of("after (15), the fourth and fifth line, without noise: alpha = s1'd2")
def eq_15_last_lines(rng):
    g, alpha = pair(rng), rng.standard_normal()
    first = np.cross(g.s1, g.d1) @ np.cross(g.d1, g.d2) + g.d1 @ g.d1 * alpha
    scalar = g.q[:3] @ np.cross(g.r1, g.r2) * g.q[3]
    printed = [g.d1 @ g.d1 * (alpha - g.s1 @ g.d2), g.s1 @ g.d2]
    return [first, scalar], printed


@of("after (15): s1'd2 = -s2'd1")
def scalar_identity(rng):
    g = pair(rng)
    printed = -g.s2 @ g.d1
    return g.q[:3] @ np.cross(g.r1, g.r2) * g.q[3], printed


@of("after (15): (14) in place of (13) gives the same")
def other_condition(rng):
    g = pair(rng)
    a = np.cross(g.d1, g.d2)
    printed = np.append(a, -np.cross(g.s2, g.d2) @ a / (g.d2 @ g.d2))
    return g.q, unit(printed)
