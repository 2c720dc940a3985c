"""Peng and Choukroun, section 4.3.1: biases, eqs. (51) to (53)."""

from functools import cache
from itertools import product

import numpy as np

from errata.claim import FALSE, RIGHT, WORDING, add, claim, claims
from errata.errors import ONE
from errata.expansions import exact_error
from errata.geometry import (
    covariance,
    gaussian_mean,
    inverse,
    jacobian,
    multiply,
    pair,
    qbar,
    quaternion,
    second_order_mean,
    skew,
    taylor,
)

SOURCE = "quaternion"
of = claim(SOURCE)
add(SOURCE, "(53) is a mean; the bias is that less the identity 1_q", WORDING)
SMALL = 1e-6  # the extrapolated mean leaves s^6 and rounding of 1e-16 / s^2


def q_and_p(rng):
    """A true quaternion and a covariance of the scaled error."""
    return quaternion(rng), covariance(4, rng)


def normal_matrix(q):
    """Q of (50)."""
    return np.eye(4) - 3 * np.outer(q, q)


@of("section 4.3.1: the unnormalised errors are unbiased, the pairs uncorrelated")
def unbiased(rng):
    g = pair(rng)
    L = np.linalg.cholesky(covariance(12, rng))
    for i in range(12):  # the four vectors are uncorrelated
        L[i, : 3 * (i // 3)] = 0.0
    # degree 2 in the noise: 24 points of the sphere of radius sqrt(12) are exact
    points = np.sqrt(12) * np.concatenate([L.T, -L.T]).reshape(-1, 4, 3)
    printed = np.mean([qbar(g.vectors + x) for x in points], axis=0)
    return g.q[:3] @ np.cross(g.r1, g.r2) * g.q, printed


@of("section 4.3.1: (52) needs the pairs uncorrelated, as it assumes")
def uncorrelated_pairs(rng):
    # the same noise on b1 and b2: E{db1'db2} = 3, and the unnormalised error has a mean
    g, J, length = linear_map(rng)
    L, same = np.eye(12), np.eye(12)
    same[3:6, :3], same[3:6, 3:6] = np.eye(3), 0.0
    truth = [
        sum(
            taylor(lambda t, v=v: -unit_analytic(qbar(g.vectors + 0.1 * t * v)), 2)[2]
            for v in M.T.reshape(-1, 4, 3)
        )
        * 100
        for M in (L, same)
    ]
    P = [J @ M @ M.T @ J.T for M in (L, same)]
    second = [p @ g.q + 0.5 * np.trace(normal_matrix(g.q) @ p) * g.q for p in P]
    mean = np.array([0, 0, 0, -3 / 4]) / length
    printed = [second[0], second[1] + mean - g.q * (g.q @ mean)]
    return truth, printed


@claims(
    SOURCE,
    eq_51=("(51)", RIGHT, SMALL),
    eq_52=("(52)", RIGHT, SMALL),
    eq_53=("(53)", RIGHT, SMALL),
    development_51="the developments of (51) and (52)",
    q_indefinite="after (53): Q is indefinite",
)
def means(rng):
    q, P = q_and_p(rng)
    Q, one, (*e, s) = normal_matrix(q), np.eye(4), q

    def nu_and_error(x):
        return np.append(1 / np.linalg.norm(q - x), exact_error(q, x))

    nu, *error = second_order_mean(nu_and_error, 0.1 * P) * 10
    eq_51 = nu, -0.5 * np.trace(Q @ P)
    eq_52 = error, (P + 0.5 * np.trace(Q @ P) * one) @ q
    M = np.block([[skew(e) - s * one[:3, :3], q[:3, None]], [-q[None, :3], -s]])
    eq_53 = (
        ONE - multiply(inverse(q), np.array(error)),
        ONE + M @ (P + 0.5 * np.trace(Q @ P) * one) @ q,
    )
    development_51 = (
        [
            gaussian_mean(lambda x: -0.5 * x @ Q @ x, P),
            gaussian_mean(lambda x: x * (x @ q), P) @ q,
        ],
        [0.5 * np.trace((3 * np.outer(q, q) - one) @ P), q @ P @ q],
    )
    values = np.linalg.eigvalsh(Q)
    q_indefinite = [True, True], [bool(values[0] < 0), bool(values[-1] > 0)]
    return locals()


@of("abstract: the covariance to second order for any distribution", tol=SMALL)
def any_distribution(rng):
    # four independent variables of two skew values each, mean 0 and variance 1
    q, scale = quaternion(rng), rng.uniform(0.5, 1.5, 4)
    F = np.linalg.qr(rng.standard_normal((4, 4)))[0] * scale
    points = np.array(list(product([-2.0, 0.5], repeat=4)))
    weights = np.prod(np.where(points < 0, 0.2, 0.8), axis=1)

    def covariance_over(s):
        errors = np.array([exact_error(q, s * F @ x) for x in points])
        return np.cov(errors.T, aweights=weights, bias=True) / s**2

    projector = np.eye(4) - np.outer(q, q)
    printed = projector @ F @ F.T @ projector
    near, far = (2 * covariance_over(s) - covariance_over(2 * s) for s in (1e-3, 2e-3))
    return (4 * near - far) / 3, printed  # without the terms in s and s^2


def linear_map(rng):
    """A geometry, the derivative of the scaled error, and its length."""
    g = pair(rng)
    length = np.linalg.norm(qbar(g.vectors))
    return g, -jacobian(qbar, g.vectors) / length, length


def unit_analytic(v):
    """The direction of a vector that may be complex."""
    return v / np.sqrt(np.sum(v * v))


@cache
def biases(frame, tangent, n=100):
    """True quaternion, P of the estimator for noise of one size, (52), n times."""
    rng, found = np.random.default_rng(14), []
    while len(found) < n:
        g = pair(rng)
        turns = [2 * np.outer(x, x) - np.eye(3) for x in np.eye(3)]
        turned = [g.vectors] + [[*g.vectors[:2], R @ g.r1, R @ g.r2] for R in turns]
        vectors = np.array(max(turned, key=lambda v: np.linalg.norm(qbar(v))))
        vectors = vectors if frame == "greatest" else g.vectors
        q = qbar(vectors)
        J = (jacobian(qbar, vectors) / np.linalg.norm(q)).reshape(4, 4, 3)
        q = q / np.linalg.norm(q)
        S = [np.eye(3) - tangent * np.outer(v, v) for v in vectors]
        P = np.einsum("ank,nkl,bnl->ab", J, S, J)
        bias = P @ q + 0.5 * np.trace(normal_matrix(q) @ P) * q
        found.append((q, P, bias))
    return found


CASES = [("plain", 0), ("plain", 1), ("greatest", 0), ("greatest", 1)]


@of(
    'after (53): "the bias lies close to the true quaternion", plain form',
    FALSE,
    seeds=1,
)
def bias_close_to_q(rng):
    # nine in ten, in degrees; isotropic and tangent noise, plain and greatest frame
    nine = []
    for case in CASES:
        cosines = [q @ m / np.linalg.norm(m) for q, _, m in biases(*case)]
        nine.append(np.degrees(np.arccos(np.quantile(cosines, 0.1))))
    printed = bool(max(nine[:2]) < 10)
    right = bool(min(nine[:2]) > 15 and max(nine[2:]) < 12)
    return True, printed, right


@of("after (53): left open, whether the bias points inward or outward; inward")
def bias_points_inward(rng):
    # by the least over frames and noises, over the trace of the covariance: one half
    shares = [
        q @ m / (np.trace(P) - q @ P @ q) for case in CASES for q, P, m in biases(*case)
    ]
    printed = 0.5
    return shares, [printed] * len(shares)


@of("after (53): P q is generally small, beside the bias", FALSE, seeds=1)
def p_q_small(rng):
    middle = [
        np.median([np.linalg.norm(P @ q) / np.linalg.norm(m) for q, P, m in biases(*c)])
        for c in CASES
    ]
    printed = bool(max(middle) < 0.5)
    # longer than the bias, but for tangent noise in the greatest frame
    right = bool(min(middle[:3]) > 1.0 and 0.5 < middle[3] < 1.0)
    return True, printed, right
