"""Peng and Choukroun, sections 4.1 and 4.2.1: errors, eqs. (29) to (47)."""

import numpy as np

from errata.claim import MISPRINTED, WORDING, add, claim
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
of = claim(SOURCE)
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


@of("(29)")
def eq_29(rng):
    g = pair(rng)
    db = 0.1 * rng.standard_normal(3)
    printed = attitude(g.q) @ g.r1 + db
    return Pair(g.q, g.r1, g.r2, np.stack([db, db, db, db])).b1, printed


@of("(30)")
def eq_30(rng):
    g = pair(rng)
    dr = 0.1 * rng.standard_normal(3)
    printed = g.r2 + dr
    return Pair(g.q, g.r1, g.r2, np.stack([dr, dr, dr, dr])).r2, printed


@of("(31)")
def eq_31(rng):
    g = pair(rng)
    printed = np.append(np.cross(g.d1, g.d2), g.s1 @ g.d2)
    return g.q[:3] @ np.cross(g.r1, g.r2) * g.q, printed


@of("(32)")
def eq_32(rng):
    g, _ = noisy(rng)
    length = abs(g.q[:3] @ np.cross(g.r1, g.r2))  # of qbar without noise
    printed = qbar(g.vectors) / length
    return g.q, printed


@of("(33)")
def eq_33(rng):
    _, noise = noisy(rng)
    printed = qbar(noise.vectors) / np.linalg.norm(qbar(noise.vectors))
    return [1.0, 0.0], [printed @ printed, np.linalg.norm(parts(printed, noise))]


def parts(q, g):
    """What of the defining conditions (11) to (13) a quaternion leaves."""
    return [g.d1 @ q[:3], g.d2 @ q[:3]]


def errors(rng):
    """True quaternion, length of the true qbar, true and measured qbar."""
    g, noise = noisy(rng)
    length = g.q[:3] @ np.cross(g.r1, g.r2)
    return g.q, length, length * g.q, qbar(noise.vectors)


@of("(34)")
def eq_34(rng):
    q, length, true, measured = errors(rng)
    printed = true - measured
    return q * length - measured, printed


@of("(35)")
def eq_35(rng):
    q, length, true, measured = errors(rng)
    printed = (true - measured) / length
    return q - measured / length, printed


@of("(36)")
def eq_36(rng):
    q, _, true, measured = errors(rng)
    printed = q - measured / np.linalg.norm(measured)
    return unit(true) - unit(measured), printed


@of("(37)")
def eq_37(rng):
    q, _, _, measured = errors(rng)
    printed = multiply(inverse(q), unit(measured))
    # the rotation that is left after the true one
    return attitude(unit(measured)) @ attitude(q).T, attitude(printed)


@of("(38)", MISPRINTED)
def eq_38(rng):
    p, q = quaternion(rng), quaternion(rng)
    (e1, q1), (e2, q2) = (p[:3], p[3]), (q[:3], q[3])
    vector = q1 * e2 + q2 * e1 + np.cross(e1, e2)
    printed = np.append(vector, e1 @ e2 - q1 * q2)
    right = np.append(vector, q1 * q2 - e1 @ e2)
    return multiply(p, q), printed, right


@of("(38), vector part")
def eq_38_vector(rng):
    p, q = quaternion(rng), quaternion(rng)
    (e1, q1), (e2, q2) = (p[:3], p[3]), (q[:3], q[3])
    printed = q1 * e2 + q2 * e1 + np.cross(e1, e2)
    return multiply(p, q)[:3], printed


def deltas(rng):
    """True pair, its noise (db1, db2, dr1, dr2), and the change of qbar."""
    g, noise = noisy(rng)
    return g, noise.vectors - g.vectors, qbar(g.vectors) - qbar(noise.vectors)


@of("(39)")
def eq_39(rng):
    g, (db1, db2, dr1, dr2), truth = deltas(rng)
    ds1, dd1, dd2 = (db1 + dr1) / 2, (db1 - dr1) / 2, (db2 - dr2) / 2
    printed = np.append(
        skew(g.d2) @ dd1 - skew(g.d1) @ dd2 - np.cross(dd1, dd2),
        -g.d2 @ ds1 - g.s1 @ dd2 - ds1 @ dd2,
    )
    return truth, printed


@of("(40)")
def eq_40(rng):
    g, noise = noisy(rng)
    db1, _, dr1, _ = noise.vectors - g.vectors
    printed = (db1 + dr1) / 2
    return noise.s1 - g.s1, printed


@of("(41)")
def eq_41(rng):
    g, noise = noisy(rng)
    db1, db2, dr1, dr2 = noise.vectors - g.vectors
    printed = [(db1 - dr1) / 2, (db2 - dr2) / 2]
    return [noise.d1 - g.d1, noise.d2 - g.d2], printed


@of("(42)")
def eq_42(rng):
    # what makes the scaled estimate one of length 1
    _, length, true, measured = errors(rng)
    printed = np.linalg.norm(true) / np.linalg.norm(measured)
    return 1.0, np.linalg.norm(printed * measured / length)


@of("(43)")
def eq_43(rng):
    q, length, true, measured = errors(rng)
    x = (true - measured) / length
    printed = (1 - 2 * q @ x + x @ x) ** -0.5
    return np.linalg.norm(true) / np.linalg.norm(measured), printed


@of("(44)")
def eq_44(rng):
    q, length, true, measured = errors(rng)
    x = (true - measured) / length
    nu = np.linalg.norm(true) / np.linalg.norm(measured)
    printed = nu * x + (1 - nu) * q
    return q - unit(measured), printed


@of("(45)")
def eq_45(rng):
    q, _, _, measured = errors(rng)
    (e, s), error = (q[:3], q[3]), q - unit(measured)
    M = np.block([[skew(e) - s * np.eye(3), e[:, None]], [-e[None], -np.eye(1) * s]])
    printed = ONE + M @ error
    return multiply(inverse(q), unit(measured)), printed


@of("(46)")
def eq_46(rng):
    q = quaternion(rng)
    printed = np.append(np.zeros(3), 1)
    return multiply(inverse(q), q), printed


@of("(47)")
def eq_47(rng):
    q, v = quaternion(rng), rng.standard_normal(4)
    e, s = q[:3], q[3]
    printed = np.block(
        [[skew(e) - s * np.eye(3), e[:, None]], [-e[None], -s * np.eye(1)]]
    )
    return -multiply(inverse(q), v), printed @ v


@of("after (47), the development of (43)")
def development_43(rng):
    q, length, true, measured = errors(rng)
    d = true - measured
    printed = [
        true @ true - 2 * true @ d + d @ d,
        length**2 * (1 - 2 * true @ d / length**2 + d @ d / length**2),
        length**2 * (1 - 2 * q @ d / length + d @ d / length**2),
    ]
    return [measured @ measured] * 3, printed


@of("after (47), the development of (44)")
def development_44(rng):
    q, length, true, measured = errors(rng)
    d, other = true - measured, np.linalg.norm(measured)
    printed = [
        true / length - (true - d) / other,
        d / other + (1 / length - 1 / other) * true,
        length / other * d / length + (1 - length / other) * true / length,
    ]
    return [q - unit(measured)] * 3, printed


@of("after (47), the development of (45)")
def development_45(rng):
    q, _, _, measured = errors(rng)
    d = q - unit(measured)
    printed = [
        multiply(inverse(q), q - d),
        multiply(inverse(q), q) - multiply(inverse(q), d),
        ONE - multiply(inverse(q), d),
    ]
    return [multiply(inverse(q), unit(measured))] * 3, printed
