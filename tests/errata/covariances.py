"""Peng and Choukroun, sections 4.3.2 and 4.3.3: covariances, eqs. (54) to (65)."""

import numpy as np

from errata.claim import MISPRINTED, WORDING, add, claim
from errata.expansions import exact_error
from errata.geometry import (
    covariance,
    inverse,
    jacobian,
    multiply,
    pair,
    qbar,
    second_order_mean,
    skew,
)
from errata.moments import SMALL, linear_map, normal_matrix, q_and_p

of = claim("quaternion")
add("quaternion", 'before (61): "diagonal" is a multiple of the identity', WORDING)
add("quaternion", "before (60): the bar of P is missing †", WORDING)
add(
    "quaternion",
    "before (60): of (b2, r2) uncorrelated it is not said again; section 4.3.1 has it",
    WORDING,
)


def halves(x):
    """(ds1, dd1, dd2) of the noise (db1, db2, dr1, dr2), as a (9, 12) matrix."""
    return jacobian(
        lambda v: np.concatenate(
            [(v[0] + v[2]) / 2, (v[0] - v[2]) / 2, (v[1] - v[3]) / 2]
        ),
        x,
    )


def blocks(g):
    """E, F, G, H of (55) to (58), true by (54)."""
    return skew(g.d2), -skew(g.d1), -g.d2[None], -g.s1[None]


def assembled(E, F, G, H):
    """The matrix of (54)."""
    return np.block([[np.zeros((3, 3)), E, F], [G, np.zeros((1, 3)), H]])


def true_map(g):
    """The derivative of qbar_true - qbar by (ds1, dd1, dd2), by complex steps."""
    J = -jacobian(qbar, g.vectors)
    return J @ np.linalg.pinv(halves(g.vectors))


@of("(54)")
def eq_54(rng):
    g = pair(rng)
    E, F, G, H = blocks(g)
    printed = np.block([[np.zeros((3, 3)), E, F], [G, np.zeros((1, 3)), H]])
    return true_map(g), printed


@of("(55)")
def eq_55(rng):
    g = pair(rng)
    printed = skew(g.d2)
    return true_map(g)[:3, 3:6], printed


@of("(56)")
def eq_56(rng):
    g = pair(rng)
    printed = -skew(g.d1)
    return true_map(g)[:3, 6:], printed


@of("(57)")
def eq_57(rng):
    g = pair(rng)
    printed = -g.d2
    return true_map(g)[3, :3], printed


@of("(58)")
def eq_58(rng):
    g = pair(rng)
    printed = -g.s1
    return true_map(g)[3, 6:], printed


def full_noise(rng):
    """A geometry, a full covariance of the twelve noises, that of qbar, blocks."""
    g = pair(rng)
    S = covariance(12, rng)
    J = jacobian(qbar, g.vectors)
    L = halves(g.vectors)
    P = (L @ S @ L.T).reshape(3, 3, 3, 3).swapaxes(1, 2)
    return g, J @ S @ J.T, P


def sandwich(g, P):
    """The product of (59) for blocks P of the covariance of (s1, d1, d2)."""
    outer = assembled(*blocks(g))
    return outer @ np.block(P) @ outer.T


@of("(59), blocks below the diagonal", MISPRINTED)
def eq_59(rng):
    g, truth, P = full_noise(rng)
    (s1, s1d1, s1d2), (_, d1, d1d2), (*_, d2) = P
    printed = sandwich(g, [[s1, s1d1, s1d2], [s1d1, d1, d1d2], [s1d2, d1d2, d2]])
    right = sandwich(g, [[s1, s1d1, s1d2], [s1d1.T, d1, d1d2], [s1d2.T, d1d2.T, d2]])
    return truth, printed, right


@of("after (59), the list of its blocks", MISPRINTED)
def list_after_59(rng):
    # with the block that is not listed put to zero the product is not (59)
    g, truth, P = full_noise(rng)
    (s1, s1d1, s1d2), (_, d1, d1d2), (*_, d2) = P
    no = np.zeros((3, 3))
    printed = sandwich(g, [[s1, s1d1, no], [s1d1.T, d1, d1d2], [no, d1d2.T, d2]])
    right = sandwich(g, [[s1, s1d1, s1d2], [s1d1.T, d1, d1d2], [s1d2.T, d1d2.T, d2]])
    return truth, printed, right


def separate_noise(rng, tangent=False):
    """A geometry, covariances of b1, b2, r1, r2, and that of 2 qbar, exact."""
    g = pair(rng)
    S = np.stack([covariance(3, rng) for _ in range(4)])
    if tangent:
        S = np.stack([np.eye(3) - np.outer(v, v) for v in g.vectors])
    J = jacobian(qbar, g.vectors).reshape(4, 4, 3)
    return g, S, 4 * np.einsum("ank,nkl,bnl->ab", J, S, J)


@of("(60), upper left")
def eq_60_upper_left(rng):
    g, (b1, b2, r1, r2), P = separate_noise(rng)
    d1, d2 = skew(g.d1), skew(g.d2)
    printed = d2 @ (b1 + r1) @ d2.T + d1 @ (b2 + r2) @ d1.T
    return P[:3, :3], printed


@of("(60), lower right")
def eq_60_lower_right(rng):
    g, (b1, b2, r1, r2), P = separate_noise(rng)
    printed = g.d2 @ (b1 + r1) @ g.d2 + g.s1 @ (b2 + r2) @ g.s1
    return P[3, 3], printed


@of("(60), upper right", MISPRINTED)
def eq_60_upper_right(rng):
    g, (b1, b2, r1, r2), P = separate_noise(rng)
    d1, d2 = skew(g.d1), skew(g.d2)
    printed = d1 @ (b2 + r2) @ g.s1
    right = d1 @ (b2 + r2) @ g.s1 - d2 @ (b1 - r1) @ g.d2
    return P[:3, 3], printed, right


@of("(60), lower left", MISPRINTED)
def eq_60_lower_left(rng):
    g, (b1, b2, r1, r2), P = separate_noise(rng)
    d1, d2 = skew(g.d1), skew(g.d2)
    printed = -g.d2 @ (b1 + r1) @ d2.T + g.s1 @ (b2 + r2) @ d1.T
    right = -g.d2 @ (b1 - r1) @ d2.T + g.s1 @ (b2 + r2) @ d1.T
    return P[3, :3], printed, right


@of("after (60): tangent noise can be analysed with (60), put right")
def tangent_by_60(rng):
    g, (b1, b2, r1, r2), P = separate_noise(rng, tangent=True)
    d1, d2 = skew(g.d1), skew(g.d2)
    printed = d1 @ (b2 + r2) @ g.s1 - d2 @ (b1 - r1) @ g.d2
    return P[:3, 3], printed


def isotropic(rng):
    """A geometry and the exact covariance of qbar for unit isotropic noise, times 2."""
    g = pair(rng)
    J = jacobian(qbar, g.vectors)
    return g, 2 * J @ J.T


@of("(61), isotropic noise of one size")
def eq_61(rng):
    g, truth = isotropic(rng)
    d1, d2, s1 = g.d1, g.d2, g.s1
    square = d1 @ d1 * np.eye(3) - np.outer(d1, d1)
    square += d2 @ d2 * np.eye(3) - np.outer(d2, d2)
    corner = np.cross(d1, s1)[:, None]
    printed = np.block([[square, corner], [corner.T, d2 @ d2 + s1 @ s1]])
    return truth, printed


@of("(61), the sum without brackets", MISPRINTED)
def eq_61_brackets(rng):
    g, truth = isotropic(rng)
    d1, d2 = g.d1, g.d2
    printed = (d1 @ d1 + d2 @ d2) * np.eye(3) - np.outer(d2, d2)
    right = (d1 @ d1 + d2 @ d2) * np.eye(3) - np.outer(d1, d1) - np.outer(d2, d2)
    return truth[:3, :3], printed, right


@of("after (61), the matrix in the middle", MISPRINTED)
def middle_after_61(rng):
    L = halves(pair(rng).vectors)
    truth = 2 * L @ L.T  # of (s1, d1, d2), for unit noise
    no, one = np.zeros((3, 3)), np.eye(3)
    printed = np.block([[one, one, no], [one, one, no], [no, no, one]])
    right = np.block([[one, no, no], [no, one, no], [no, no, one]])
    return truth, printed, right


@of("after (61), the second line; the product is right all the same")
def second_line_after_61(rng):
    g, truth = isotropic(rng)
    E, F, G, H = blocks(g)
    no, one = np.zeros((3, 3)), np.eye(3)
    middle = np.block([[one, one, no], [one, one, no], [no, no, one]])
    outer = assembled(E, F, G, H)
    printed = np.block([[E @ E.T + F @ F.T, F @ H.T], [H @ F.T, G @ G.T + H @ H.T]])
    return [truth, truth], [printed, outer @ middle @ outer.T]


@of("section 4.3.3, before (62): the first symbol, a bar for a check †", MISPRINTED)
def first_symbol(rng):
    # what (62) divides by |qbar|^2 is the covariance of the unnormalised error
    g, J, length = linear_map(rng)
    truth = J @ J.T * length**2
    printed = J @ J.T
    right = jacobian(qbar, g.vectors) @ jacobian(qbar, g.vectors).T
    return truth, printed, right


@of("(62), its left side, a bar for a check †", MISPRINTED)
def eq_62(rng):
    g, J, length = linear_map(rng)
    unnormalised = jacobian(qbar, g.vectors) @ jacobian(qbar, g.vectors).T
    truth = unnormalised / length**2
    printed = unnormalised
    right = J @ J.T
    return truth, printed, right


@of("(64)")
def eq_64(rng):
    q, P = q_and_p(rng)
    e, s = q[:3], q[3]
    M = np.block([[skew(e) - s * np.eye(3), e[:, None]], [-e[None], -s * np.eye(1)]])
    columns = np.stack([multiply(inverse(q), -c) for c in np.linalg.cholesky(P).T])
    printed = M @ P @ M.T
    return columns.T @ columns, printed


@of("(65)", tol=SMALL)
def eq_65(rng):
    q, P = q_and_p(rng)
    truth = second_order_mean(lambda x: exact_error(q, x), 0.1 * P) * 10
    printed = P + 0.5 * np.trace(normal_matrix(q) @ P) * np.eye(4)
    return truth, printed @ q
