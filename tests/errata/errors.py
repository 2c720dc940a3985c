"""Peng and Choukroun, sections 4.1 to 4.2: errors and expansions, (29) to (50)."""

import numpy as np

from errata.claim import FALSE, MISPRINTED, claims, unevaluated
from errata.geometry import (
    Pair,
    attitude,
    inverse,
    multiply,
    pair,
    qbar,
    quaternion,
    skew,
    taylor,
    unit,
)

SOURCE = "quaternion"
unevaluated(
    SOURCE,
    "(42): true length over measured, in words the other way round",
    "(39), last product: a transpose too many †",
    "the development of (48): the ratio v for nu †",
    "section 4.2.2: the multiplicative error, a bar for a hat †",
)
ONE = np.array([0.0, 0.0, 0.0, 1.0])

unevaluated(
    SOURCE, "(29), (30) measured less true, (34) to (36) true less measured, both Delta"
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


# section 4.2.2: expansions, eqs. (48) to (50).

unevaluated(
    SOURCE,
    "(48), (49), (51) to (54): equalities that hold to second order, (54) to first",
)


def exact_error(q, x):
    """q - qhat from the scaled error, by the definitions; x may be complex."""
    v = q - x
    return q - v / np.sqrt(np.sum(v * v))


@claims(
    SOURCE,
    linear_in_the_scaled_error=(
        "section 4.2.2: the multiplicative error is linear in the scaled one",
        FALSE,
    ),
    tangent_term="after (50): the first-order term lies in the tangent plane",
    second_order_directions=(
        "after (50): the second-order term is one along the error and one along q"
    ),
    any_estimator="after (50): the formulas hold for any estimator",
    development_48="the development of (48): nu in powers of epsilon",
    expansion_yields=('the development of (48): "yields Eq. (43)"', MISPRINTED),
)
def approximations(rng):
    q, x = quaternion(rng), unit(rng.standard_normal(4))
    nus = taylor(lambda t: np.sum((q - t * x) ** 2) ** -0.5, 2)
    _, first, second = taylor(lambda t: exact_error(q, t * x), 2)

    def twice(of, d):
        # f(2 d) - 2 f(d), zero for a linear f
        return of(2 * d) - 2 * of(d) + ONE

    def of_scaled(d):
        return multiply(inverse(q), q - exact_error(q, d))

    def of_normalised(d):
        return multiply(inverse(q), q - d)

    step = 0.2 * x
    linear_in_the_scaled_error = (
        np.zeros(4),
        twice(of_scaled, step),
        twice(of_normalised, exact_error(q, step)),
    )
    Q = np.eye(4) - 3 * np.outer(q, q)
    eq_48 = nus, [1, q @ x, -0.5 * x @ Q @ x]
    eq_49 = (
        [first, second],
        [
            (np.eye(4) - np.outer(q, q)) @ x,
            (np.outer(x, x) + 0.5 * x @ Q @ x * np.eye(4)) @ q,
        ],
    )
    # the symmetric matrix of nu's second-order term, by polarisation
    by_two = [[taylor(lambda t, v=u + w: np.sum((q - t * v) ** 2) ** -0.5, 2)[2]
               for u in np.eye(4)] for w in np.eye(4)]  # fmt: skip
    own = np.diag(by_two) / 4
    eq_50 = own[:, None] + own - np.array(by_two), np.eye(4) - 3 * np.outer(q, q)
    tangent_term = 0.0, q @ first
    second_order_directions = (
        2,
        np.linalg.matrix_rank(np.stack([q, x, second]), tol=1e-9),
    )
    # an estimate that has nothing to do with two vectors
    estimate = q + 0.02 * np.append(x[:3], 0.5)
    d = q - estimate
    nu = (1 - 2 * q @ d + d @ d) ** -0.5
    any_estimator = q - unit(estimate), nu * d + (1 - nu) * q
    eps = [0.0, -2 * q @ x, x @ x]  # of t, t^2
    development_48 = (
        [nus, nus],
        [
            [1, -0.5 * eps[1], -0.5 * eps[2] + 3 / 8 * eps[1] ** 2],
            [1, q @ x, -0.5 * x @ x + 1.5 * (q @ x) ** 2],
        ],
    )
    # to second order in d, the expansion is (48) and not the exact (43)
    d = x / 2
    half = -2 * q @ d + d @ d
    expansion_yields = (
        1 - 0.5 * half + 3 / 8 * (2 * q @ d) ** 2,
        (1 - 2 * q @ d + d @ d) ** -0.5,
        1 + q @ d - 0.5 * d @ Q @ d,
    )
    return locals()
