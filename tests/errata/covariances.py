"""Peng and Choukroun, sections 4.3.2 and 4.3.3: covariances, eqs. (54) to (65)."""

import numpy as np

from errata.claim import MISPRINTED, RIGHT, WORDING, add, claims
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
from errata.moments import SMALL, normal_matrix, q_and_p

SOURCE = "quaternion"
add(SOURCE, 'before (61): "diagonal" is a multiple of the identity', WORDING)
add(SOURCE, "before (60): the bar of P is missing †", WORDING)
add(
    SOURCE,
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


@claims(SOURCE)
def linear_map_of_noise(rng):
    g = pair(rng)
    truth, no = true_map(g), np.zeros((3, 3))
    E, F, G, H = blocks(g)
    eq_54 = truth, np.block([[no, E, F], [G, np.zeros((1, 3)), H]])
    eq_55 = truth[:3, 3:6], skew(g.d2)
    eq_56 = truth[:3, 6:], -skew(g.d1)
    eq_57 = truth[3, :3], -g.d2
    eq_58 = truth[3, 6:], -g.s1
    return locals()


@claims(
    SOURCE,
    eq_59=("(59), blocks below the diagonal", MISPRINTED),
    list_after_59=("after (59), the list of its blocks", MISPRINTED),
)
def any_noise(rng):
    # a full covariance of the twelve noises, and its blocks for s1, d1, d2
    g, S = pair(rng), covariance(12, rng)
    J, L = jacobian(qbar, g.vectors), halves(g.vectors)
    truth, outer = J @ S @ J.T, assembled(*blocks(g))
    P = (L @ S @ L.T).reshape(3, 3, 3, 3).swapaxes(1, 2)
    (s1, s1d1, s1d2), (_, d1, d1d2), (*_, d2) = P

    def product(*rows):
        return outer @ np.block(list(rows)) @ outer.T

    eq_59 = (
        truth,
        product([s1, s1d1, s1d2], [s1d1, d1, d1d2], [s1d2, d1d2, d2]),
        product([s1, s1d1, s1d2], [s1d1.T, d1, d1d2], [s1d2.T, d1d2.T, d2]),
    )
    # with the block that is not listed put to zero the product is not (59)
    no = np.zeros((3, 3))
    list_after_59 = (
        truth,
        product([s1, s1d1, no], [s1d1.T, d1, d1d2], [no, d1d2.T, d2]),
        product([s1, s1d1, s1d2], [s1d1.T, d1, d1d2], [s1d2.T, d1d2.T, d2]),
    )
    return locals()


def separate_noise(rng, tangent=False):
    """A geometry, covariances of b1, b2, r1, r2, and that of 2 qbar, exact."""
    g = pair(rng)
    S = np.stack([covariance(3, rng) for _ in range(4)])
    if tangent:
        S = np.stack([np.eye(3) - np.outer(v, v) for v in g.vectors])
    J = jacobian(qbar, g.vectors).reshape(4, 4, 3)
    return g, S, 4 * np.einsum("ank,nkl,bnl->ab", J, S, J)


@claims(
    SOURCE,
    eq_60_upper_left="(60), upper left",
    eq_60_lower_right="(60), lower right",
    eq_60_upper_right=("(60), upper right", MISPRINTED),
    eq_60_lower_left=("(60), lower left", MISPRINTED),
    tangent_by_60="after (60): tangent noise can be analysed with (60), put right",
)
def uncorrelated_noise(rng):
    g, (b1, b2, r1, r2), P = separate_noise(rng)
    D1, D2 = skew(g.d1), skew(g.d2)
    eq_60_upper_left = P[:3, :3], D2 @ (b1 + r1) @ D2.T + D1 @ (b2 + r2) @ D1.T
    eq_60_lower_right = P[3, 3], g.d2 @ (b1 + r1) @ g.d2 + g.s1 @ (b2 + r2) @ g.s1
    eq_60_upper_right = (
        P[:3, 3],
        D1 @ (b2 + r2) @ g.s1,
        D1 @ (b2 + r2) @ g.s1 - D2 @ (b1 - r1) @ g.d2,
    )
    eq_60_lower_left = (
        P[3, :3],
        -g.d2 @ (b1 + r1) @ D2.T + g.s1 @ (b2 + r2) @ D1.T,
        -g.d2 @ (b1 - r1) @ D2.T + g.s1 @ (b2 + r2) @ D1.T,
    )
    g, (b1, b2, r1, r2), P = separate_noise(rng, tangent=True)
    D1, D2 = skew(g.d1), skew(g.d2)
    tangent_by_60 = P[:3, 3], D1 @ (b2 + r2) @ g.s1 - D2 @ (b1 - r1) @ g.d2
    return locals()


@claims(
    SOURCE,
    eq_61="(61), isotropic noise of one size",
    eq_61_brackets=("(61), the sum without brackets", MISPRINTED),
    middle_after_61=("after (61), the matrix in the middle", MISPRINTED),
    second_line_after_61=(
        "after (61), the second line; the product is right all the same"
    ),
    first_symbol=(
        "section 4.3.3, before (62): the first symbol, a bar for a check †",
        MISPRINTED,
    ),
    eq_62=("(62), its left side, a bar for a check †", MISPRINTED),
)
def isotropic_noise(rng):
    g = pair(rng)
    d1, d2, s1, one, no = g.d1, g.d2, g.s1, np.eye(3), np.zeros((3, 3))
    J, L = jacobian(qbar, g.vectors), halves(g.vectors)
    truth = 2 * J @ J.T
    square = d1 @ d1 * one - np.outer(d1, d1) + d2 @ d2 * one - np.outer(d2, d2)
    corner = np.cross(d1, s1)[:, None]
    eq_61 = truth, np.block([[square, corner], [corner.T, d2 @ d2 + s1 @ s1]])
    eq_61_brackets = (
        truth[:3, :3],
        (d1 @ d1 + d2 @ d2) * one - np.outer(d2, d2),
        (d1 @ d1 + d2 @ d2) * one - np.outer(d1, d1) - np.outer(d2, d2),
    )
    middle_after_61 = (
        2 * L @ L.T,  # of (s1, d1, d2), for unit noise
        np.block([[one, one, no], [one, one, no], [no, no, one]]),
        np.block([[one, no, no], [no, one, no], [no, no, one]]),
    )
    E, F, G, H = blocks(g)
    outer, middle = assembled(E, F, G, H), middle_after_61[1]
    second_line_after_61 = (
        [truth, outer @ middle @ outer.T],
        [np.block([[E @ E.T + F @ F.T, F @ H.T], [H @ F.T, G @ G.T + H @ H.T]])] * 2,
    )
    # what (62) divides by |qbar|^2 is the covariance of the unnormalised error
    length = np.linalg.norm(qbar(g.vectors))
    scaled = jacobian(lambda v: qbar(v) / length, g.vectors)
    first_symbol = J @ J.T, scaled @ scaled.T, J @ J.T
    eq_62 = J @ J.T / length**2, J @ J.T, scaled @ scaled.T
    return locals()


@claims(SOURCE, eq_65=("(65)", RIGHT, SMALL))
def other_covariances(rng):
    q, P = q_and_p(rng)
    e, s = q[:3], q[3]
    M = np.block([[skew(e) - s * np.eye(3), e[:, None]], [-e[None], -s * np.eye(1)]])
    columns = np.stack([multiply(inverse(q), -c) for c in np.linalg.cholesky(P).T])
    eq_64 = columns.T @ columns, M @ P @ M.T
    bias = second_order_mean(lambda x: exact_error(q, x), 0.1 * P) * 10
    eq_65 = bias, (P + 0.5 * np.trace(normal_matrix(q) @ P) * np.eye(4)) @ q
    return locals()
