"""Peng and Choukroun, abstract to section 2: the estimator, eqs. (1) to (15)."""

import numpy as np

from errata.claim import claims, unevaluated
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


@claims(
    SOURCE,
    singularity_free=(
        "section 1: a quaternion is free of singularities, and minimal among such"
    ),
)
def representation(rng):
    # a step of the quaternion turns by twice its length, in any direction and anywhere
    q = [*np.eye(4), *unit(rng.standard_normal((4, 4)))]
    steps = [unit(v - x * (x @ v)) for x in q for v in [rng.standard_normal(4)]]
    turned = [
        np.linalg.norm(attitude(x + 1e-6 * v) @ attitude(x).T - np.eye(3)) / np.sqrt(2)
        for x, v in zip(q, steps, strict=True)
    ]
    singularity_free = np.array(turned) / 1e-6, [2] * 8
    return locals()


unevaluated(
    SOURCE,
    'section 1: "none of the above-mentioned works feature some error analysis"; '
    "the page before cites [4] and [7] for theirs",
    'section 1: "This raises the quaternion errors, and of whether"',
    'section 2.2: "As noted in Section 2", which is the same section',
    "reference [19] is not cited",
    'section 1: "[Chap. 5][9]" for "[9, Chap. 5]"',
    'language: "the plan spanned", "along with the x axis", "is follows", "can be get"',
    "E is an expectation and (55), H is (1) and (58), alpha a scalar part and an angle",
    "reference [13] bears the DOI of [8], 10.2514/1.22452",
    'reference [8] is "Survey of Nonlinear Attitude Estimation Methods"',
)


def plane_of_attitudes(r, q):
    """Projector onto all quaternions that take r to b: two of them and their span."""
    basis = np.linalg.qr(np.stack([q, multiply(turn(r, 1.0), q)], axis=1))[0]
    return basis @ basis.T


@claims(
    SOURCE,
    kernel="after (5): q1 and q2 are an orthonormal basis of the kernel",
    angles_of_the_basis="after (7): q1 turns by 180 degrees, q2 by the least angle",
)
def one_vector(rng):
    q, r = quaternion(rng), directions(1, rng)[0]
    b = attitude(q) @ r
    s, d, plane = (b + r) / 2, (b - r) / 2, plane_of_attitudes(r, q)
    # the attitudes solve (1), which is antisymmetric but for the sign of s
    H = np.block([[-skew(s), d[:, None]], [-d[None], np.zeros((1, 1))]])
    eq_1 = np.zeros((4, 4)), H @ plane
    # r turned towards b by half of their angle, and by a right angle more
    half, axis = np.arccos(b @ r) / 2, np.cross(b, r)
    eq_2 = np.cos(half) * attitude(turn(axis, half)) @ r, (b + r) / 2
    eq_3 = np.sin(half) * attitude(turn(axis, half + np.pi / 2)) @ r, (b - r) / 2
    # in the plane, of unit length; the half turn, and what is normal to it
    q1 = unit(plane @ np.append(b, 0))
    eq_4 = q1, np.append(s, 0) / np.linalg.norm(s)
    eq_5 = (unit(plane[3]), np.append(-np.cross(s, d), s @ s) / np.linalg.norm(s))
    basis = np.stack([np.append(s, 0), np.append(-np.cross(s, d), s @ s)])
    kernel = plane, basis.T @ basis / (s @ s)
    rest = np.eye(4) - plane
    eq_6 = unit(rest @ np.append(b, 0)), np.append(d, 0) / np.linalg.norm(d)
    eq_7 = (unit(rest[3]), np.append(np.cross(s, d), d @ d) / np.linalg.norm(d))
    # the trace of a half turn, and the greatest scalar part in the plane
    least = np.linalg.norm(plane[3])
    angles_of_the_basis = (
        [attitude([*s, 0]).trace() + 1, least],
        [0.0, s @ s / np.linalg.norm(s)],
    )
    return locals()


@claims(
    SOURCE,
    dependent="after (14): linearly dependent, and q unique up to its length",
    eq_15_lines="after (15), the second and third line",
    eq_15_last_lines=(
        "after (15), the fourth and fifth line, without noise: alpha = s1'd2"
    ),
    scalar_identity="after (15): s1'd2 = -s2'd1",
    other_condition="after (15): (14) in place of (13) gives the same",
)
def two_vectors(rng):
    g = pair(rng)
    q, alpha = g.q, g.q[3]
    e_n = q[:3] @ np.cross(g.r1, g.r2)
    length = np.sqrt(np.sum(np.cross(g.d1, g.d2) ** 2) + (g.s1 @ g.d2) ** 2)
    eq_8 = q, np.append(np.cross(g.d1, g.d2), g.s1 @ g.d2) / length
    # b and r are the sum and the difference of s and d
    eq_9 = g.b1 - g.d1, (g.b1 + g.r1) / 2
    eq_10 = [g.s1 - g.r1, g.s2 - g.r2], [(g.b1 - g.r1) / 2, (g.b2 - g.r2) / 2]
    # what is normal to all solutions q1, q2 of one vector is normal to q
    planes = [np.eye(4) - plane_of_attitudes(r, q) for r in (g.r1, g.r2)]
    first, second = (
        unit(plane @ np.append(b, 0))
        for plane, b in zip(planes, (g.b1, g.b2), strict=True)
    )
    eq_11 = [*first * np.linalg.norm(g.d1), 0.0], [*np.append(g.d1, 0), g.d1 @ q[:3]]
    eq_12 = [*second * np.linalg.norm(g.d2), 0.0], [*np.append(g.d2, 0), g.d2 @ q[:3]]
    a = q[:3]
    eq_13 = 0.0, np.cross(g.s1, g.d1) @ a + g.d1 @ g.d1 * alpha
    eq_14 = 0.0, np.cross(g.s2, g.d2) @ a + g.d2 @ g.d2 * alpha
    rows = [np.append(np.cross(s, d), d @ d) for s, d in ((g.s1, g.d1), (g.s2, g.d2))]
    rows += [np.append(g.d1, 0), np.append(g.d2, 0)]
    dependent = 3, np.linalg.matrix_rank(np.array(rows), tol=1e-9)
    eq_15 = e_n * a, np.cross(g.d1, g.d2)
    v = Pair(q, g.r1, g.r2, 0.3 * rng.standard_normal((4, 3)))
    eq_15_lines = (
        [np.cross(v.s1, v.d1) @ np.cross(v.d1, v.d2) + v.d1 @ v.d1 * alpha] * 2,
        [
            v.s1 @ skew(v.d1) @ skew(v.d1) @ v.d2 + v.d1 @ v.d1 * alpha,
            v.s1 @ v.d1 * (v.d1 @ v.d2)
            - v.d1 @ v.d1 * (v.s1 @ v.d2)
            + v.d1 @ v.d1 * alpha,
        ],
    )
    any_alpha = rng.standard_normal()
    eq_15_last_lines = (
        [
            np.cross(g.s1, g.d1) @ np.cross(g.d1, g.d2) + g.d1 @ g.d1 * any_alpha,
            e_n * alpha,
        ],
        [g.d1 @ g.d1 * (any_alpha - g.s1 @ g.d2), g.s1 @ g.d2],
    )
    scalar_identity = e_n * alpha, -g.s2 @ g.d1
    c = np.cross(g.d1, g.d2)
    other_condition = e_n * alpha, -np.cross(g.s2, g.d2) @ c / (g.d2 @ g.d2)
    return locals()
