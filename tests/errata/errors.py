"""Peng and Choukroun, sections 4.1 and 4.2.1: errors, eqs. (29) to (47)."""

import numpy as np

from errata.claim import MISPRINTED, WORDING, add, claims
from errata.geometry import (
    Pair,
    attitude,
    inverse,
    multiply,
    pair,
    qbar,
    quaternion,
    skew,
    unit,
)

SOURCE = "quaternion"
add(SOURCE, "(42): true length over measured, in words the other way round", WORDING)
add(SOURCE, "(39), last product: a transpose too many †", WORDING)
ONE = np.array([0.0, 0.0, 0.0, 1.0])

add(
    SOURCE,
    "(29), (30) measured less true, (34) to (36) true less measured, both Delta",
    WORDING,
)


def noisy(rng):
    """A pair without noise and the same with noise of 0.1."""
    g = pair(rng)
    return g, Pair(g.q, g.r1, g.r2, 0.1 * rng.standard_normal((4, 3)))


def norm(v):
    """Length of a vector."""
    return np.linalg.norm(v)


def matrix(q):
    """M of (47)."""
    e, s = q[:3], q[3]
    return np.block([[skew(e) - s * np.eye(3), e[:, None]], [-e[None], -s * np.eye(1)]])


@claims(SOURCE)
def measured_vectors(rng):
    g, same, x = pair(rng), np.ones((4, 1)), 0.1 * rng.standard_normal(3)
    v = Pair(g.q, g.r1, g.r2, same * x)
    eq_29 = v.b1, attitude(g.q) @ g.r1 + x
    eq_30 = v.r2, g.r2 + x
    length = abs(g.q[:3] @ np.cross(g.r1, g.r2))  # of qbar without noise
    eq_31 = length * g.q, np.append(np.cross(g.d1, g.d2), g.s1 @ g.d2)
    eq_32 = g.q, qbar(g.vectors) / length
    return locals()


@claims(
    SOURCE,
    eq_38=("(38)", MISPRINTED),
    eq_38_vector="(38), vector part",
    development_43="after (47), the development of (43)",
    development_44="after (47), the development of (44)",
    development_45="after (47), the development of (45)",
)
def exact_formulas(rng):
    g, noise = noisy(rng)
    q, measured = g.q, qbar(noise.vectors)
    length = q[:3] @ np.cross(g.r1, g.r2)
    true, other, estimate = length * q, norm(measured), unit(measured)
    # of unit length, and what of the defining conditions (11), (12) it leaves
    left = np.array([[*noise.d1, 0], [*noise.d2, 0], estimate])
    eq_33 = [0, 0, 1], left @ (measured / norm(measured))
    eq_34 = q * length - measured, true - measured
    eq_35 = q - measured / length, (true - measured) / length
    eq_36 = unit(true) - estimate, q - measured / norm(measured)
    # the rotation that is left after the true one
    turned = multiply(inverse(q), unit(measured))
    eq_37 = attitude(estimate) @ attitude(q).T @ attitude(ONE), attitude(turned)
    p = quaternion(rng)
    (e1, q1), (e2, q2) = (p[:3], p[3]), (q[:3], q[3])
    v = q1 * e2 + q2 * e1 + np.cross(e1, e2)
    eq_38 = (
        multiply(p, q),
        np.append(v, e1 @ e2 - q1 * q2),
        np.append(v, q1 * q2 - e1 @ e2),
    )
    eq_38_vector = multiply(p, q)[:3], q1 * e2 + q2 * e1 + np.cross(e1, e2)
    db1, db2, dr1, dr2 = noise.vectors - g.vectors
    ds1, dd1, dd2 = (db1 + dr1) / 2, (db1 - dr1) / 2, (db2 - dr2) / 2
    eq_39 = (
        true - measured,
        np.append(
            skew(g.d2) @ dd1 - skew(g.d1) @ dd2 - np.cross(dd1, dd2),
            -g.d2 @ ds1 - g.s1 @ dd2 - ds1 @ dd2,
        ),
    )
    eq_40 = noise.s1 - g.s1, (db1 + dr1) / 2
    eq_41 = [noise.d1 - g.d1, noise.d2 - g.d2], [(db1 - dr1) / 2, (db2 - dr2) / 2]
    # what makes the scaled estimate one of length 1
    eq_42 = 1 / norm(measured / length), norm(true) / norm(measured)
    d, x, nu = true - measured, (true - measured) / length, norm(true) / other
    eq_43 = nu, (1 - 2 * q @ x + x @ x) ** -0.5
    eq_44 = q - estimate, nu * x + (1 - nu) * q
    error = q - estimate
    eq_45 = multiply(inverse(q), estimate), ONE + matrix(q) @ error
    eq_46 = multiply(inverse(q), q), np.append(np.zeros(3), 1)
    columns = [-multiply(inverse(q), row) for row in np.eye(4)]
    e, s = q[:3], q[3]
    eq_47 = (
        np.transpose(columns),
        np.block([[skew(e) - s * np.eye(3), e[:, None]], [-e[None], -s * np.eye(1)]]),
    )
    development_43 = (
        [measured @ measured] * 3,
        [
            true @ true - 2 * true @ d + d @ d,
            length**2 * (1 - 2 * true @ d / length**2 + d @ d / length**2),
            length**2 * (1 - 2 * q @ d / length + d @ d / length**2),
        ],
    )
    development_44 = (
        [q - estimate] * 3,
        [
            true / length - (true - d) / other,
            d / other + (1 / length - 1 / other) * true,
            length / other * d / length + (1 - length / other) * true / length,
        ],
    )
    development_45 = (
        [multiply(inverse(q), estimate)] * 3,
        [
            multiply(inverse(q), q - error),
            multiply(inverse(q), q) - multiply(inverse(q), error),
            ONE - multiply(inverse(q), error),
        ],
    )
    return locals()
