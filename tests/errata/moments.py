"""Peng and Choukroun, section 4.3.1: biases, eqs. (51) to (53)."""

from itertools import product

import numpy as np

from errata.claim import FALSE, WORDING, add, claim
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
)

of = claim("quaternion")
add("quaternion", "(53) is a mean; the bias is that less the identity 1_q", WORDING)
SMALL = 1e-6  # the extrapolated mean leaves s^6 and rounding of 1e-16 / s^2


def q_and_p(rng):
    """A true quaternion and a covariance of the scaled error."""
    return quaternion(rng), covariance(4, rng)


def normal_matrix(q):
    """Q of (50)."""
    return np.eye(4) - 3 * np.outer(q, q)


@of("section 4.3.1: the unnormalised errors are unbiased")
def unbiased(rng):
    g = pair(rng)
    L = np.linalg.cholesky(covariance(12, rng))
    for i in range(12):  # the four vectors are uncorrelated
        L[i, : 3 * (i // 3)] = 0.0
    # degree 2 in the noise: 24 points of the sphere of radius sqrt(12) are exact
    points = np.sqrt(12) * np.concatenate([L.T, -L.T]).reshape(-1, 4, 3)
    printed = np.mean([qbar(g.vectors + x) for x in points], axis=0)
    return g.q[:3] @ np.cross(g.r1, g.r2) * g.q, printed


@of("(51)", tol=SMALL)
def eq_51(rng):
    q, P = q_and_p(rng)
    truth = second_order_mean(lambda x: 1 / np.linalg.norm(q - x), 0.1 * P)
    printed = -0.5 * np.trace(normal_matrix(q) @ (0.1 * P))
    return truth, printed


@of("(52)", tol=SMALL)
def eq_52(rng):
    q, P = q_and_p(rng)
    truth = second_order_mean(lambda x: exact_error(q, x), 0.1 * P) * 10
    printed = (P + 0.5 * np.trace(normal_matrix(q) @ P) * np.eye(4)) @ q
    return truth, printed


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


@of("(53)", tol=SMALL)
def eq_53(rng):
    q, P = q_and_p(rng)
    e, s = q[:3], q[3]
    M = np.block([[skew(e) - s * np.eye(3), e[:, None]], [-e[None], -s * np.eye(1)]])
    mean = second_order_mean(
        lambda x: multiply(inverse(q), q - exact_error(q, x)), 0.1 * P
    )
    printed = ONE + M @ (P + 0.5 * np.trace(normal_matrix(q) @ P) * np.eye(4)) @ q
    return ONE + mean * 10, printed


@of("the developments of (51) and (52)")
def development_51(rng):
    q, P = q_and_p(rng)
    truth = [
        gaussian_mean(lambda x: -0.5 * x @ normal_matrix(q) @ x, P),
        gaussian_mean(lambda x: x * (x @ q), P) @ q,
    ]
    printed = [
        0.5 * np.trace((3 * np.outer(q, q) - np.eye(4)) @ P),
        q @ P @ q,
    ]
    return truth, printed


def linear_map(rng):
    """A geometry, the derivative of the scaled error, and its length."""
    g = pair(rng)
    length = np.linalg.norm(qbar(g.vectors))
    return g, -jacobian(qbar, g.vectors) / length, length


def second_order_bias(rng):
    """True quaternion, P of the estimator for equal isotropic noise, and (52)."""
    g, J, _ = linear_map(rng)
    P = J @ J.T
    return g.q, P, P @ g.q + 0.5 * np.trace(normal_matrix(g.q) @ P) * g.q


@of('after (53): "the bias lies close to the true quaternion"', FALSE, seeds=1)
def bias_close_to_q(rng):
    cosines = []
    for _ in range(200):
        q, _, bias = second_order_bias(rng)
        cosines.append(q @ bias / np.linalg.norm(bias))
    angles = np.degrees(np.arccos(cosines))
    printed = bool(np.quantile(angles, 0.9) < 10)
    right = bool(np.quantile(angles, 0.9) > 20)  # one in ten lies farther than that
    return True, printed, right


@of("after (53): unclear whether the bias points inward or outward", FALSE)
def bias_points_inward(rng):
    found = [second_order_bias(rng) for _ in range(50)]
    printed = any(q @ bias < 0 for q, _, bias in found)
    right = all(
        abs(2 * q @ bias - np.trace(P) + q @ P @ q) < 1e-9 and q @ bias > 0
        for q, P, bias in found
    )
    return True, printed, right


@of("after (53): P q is generally small", FALSE, seeds=1)
def p_q_small(rng):
    found = [second_order_bias(rng) for _ in range(200)]
    ratios = [np.linalg.norm(P @ q) / np.linalg.norm(bias) for q, P, bias in found]
    printed = bool(np.median(ratios) < 0.5)
    right = bool(np.median(ratios) > 1.0)  # of the size of the whole bias
    return True, printed, right


@of("after (53): Q is indefinite")
def q_indefinite(rng):
    values = np.linalg.eigvalsh(normal_matrix(quaternion(rng)))
    printed = [bool(values[0] < 0), bool(values[-1] > 0)]
    return [True, True], printed
