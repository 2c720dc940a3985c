"""Peng and Choukroun, section 4.3: biases, covariances, (51) to (65)."""

from functools import cache
from itertools import product

import numpy as np

from errata.claim import FALSE, MISPRINTED, RIGHT, claim, claims, unevaluated
from errata.errors import ONE, exact_error
from errata.geometry import (
    Pair,
    covariance,
    directions,
    gaussian_mean,
    inverse,
    jacobian,
    mean_square,
    multiply,
    pair,
    qbar,
    quaternion,
    second_order_mean,
    skew,
    taylor,
    unit,
)
from simval.theory import attitude_moments

SOURCE = "quaternion"
of = claim(SOURCE)
unevaluated(SOURCE, "(53) is a mean; the bias is that less the identity 1_q")
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
    eq_51=("(51)", RIGHT, {"tol": SMALL}),
    eq_52=("(52)", RIGHT, {"tol": SMALL}),
    eq_53=("(53)", RIGHT, {"tol": SMALL}),
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


@claims(
    SOURCE,
    bias_close_to_q=(
        'after (53): "the bias lies close to the true quaternion", plain form',
        FALSE,
    ),
    bias_points_inward=(
        "after (53): left open, whether the bias points inward or outward; inward"
    ),
    p_q_small=("after (53): P q is generally small, beside the bias", FALSE),
)
def directions_of_the_bias(rng):
    # isotropic and tangent noise, plain and greatest frame; nine in ten, in degrees
    nine, middle, shares = [], [], []
    for case in CASES:
        found = biases(*case)
        cosines = [q @ m / np.linalg.norm(m) for q, _, m in found]
        nine.append(np.degrees(np.arccos(np.quantile(cosines, 0.1))))
        middle.append(
            np.median([np.linalg.norm(P @ q) / np.linalg.norm(m) for q, P, m in found])
        )
        # by the least over frames and noises, over the trace of the covariance
        shares += [q @ m / (np.trace(P) - q @ P @ q) for q, P, m in found]
    bias_close_to_q = (
        True,
        bool(max(nine[:2]) < 10),
        bool(min(nine[:2]) > 15 and max(nine[2:]) < 12),
    )
    bias_points_inward = shares, [0.5] * len(shares)
    # longer than the bias, but for tangent noise in the greatest frame
    p_q_small = (
        True,
        bool(max(middle) < 0.5),
        bool(min(middle[:3]) > 1.0 and 0.5 < middle[3] < 1.0),
    )
    return locals()


# sections 4.3.2 and 4.3.3: covariances, eqs. (54) to (65).

unevaluated(
    SOURCE,
    'before (61): "diagonal" is a multiple of the identity',
    "before (60): the bar of P is missing †",
    "(60), row 2: three columns, the second a scalar plus a row †",
    "before (60): of (b2, r2) uncorrelated it is not said again; section 4.3.1 has it",
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


@claims(SOURCE, eq_65=("(65)", RIGHT, {"tol": SMALL}))
def other_covariances(rng):
    q, P = q_and_p(rng)
    e, s = q[:3], q[3]
    M = np.block([[skew(e) - s * np.eye(3), e[:, None]], [-e[None], -s * np.eye(1)]])
    columns = np.stack([multiply(inverse(q), -c) for c in np.linalg.cholesky(P).T])
    eq_64 = columns.T @ columns, M @ P @ M.T
    bias = second_order_mean(lambda x: exact_error(q, x), 0.1 * P) * 10
    eq_65 = bias, (P + 0.5 * np.trace(normal_matrix(q) @ P) * np.eye(4)) @ q
    return locals()


# (63) and what the fourth order is said to bring.

unevaluated(
    SOURCE, "(63), a hat for the check of P inside: as printed it is circular †"
)


def quadratic(q, x):
    """The second-order term of (49)."""
    return q @ x * x + 0.5 * x @ normal_matrix(q) @ x * q


# q, r1, r2, and the directions of the noise of b1, b2, r1, r2
RANK_ONE = [
    [0.46, 0.42, -0.27, -0.73],
    [0.59, -0.71, 0.38],
    [0.42, 0.55, -0.72],
    [-0.43, -0.47, 0.77],
    [0.867, 0.01, 0.498],
    [0.42, 0.907, 0.022],
    [0.606, 0.358, 0.711],
]


class Compared:
    """Covariances of one geometry, isotropic noise, and the exact one."""

    def __init__(self, g, sigma):
        J = jacobian(qbar, g.vectors) / np.linalg.norm(qbar(g.vectors))
        q, P = g.q, sigma**2 * J @ J.T
        projector = np.eye(4) - np.outer(q, q)
        self.q, self.second = q, projector @ P @ projector
        self.bias = gaussian_mean(lambda x: quadratic(q, x), P)
        square = mean_square(lambda x: quadratic(q, x), P)
        self.with_square = self.second + np.outer(self.bias, self.bias)  # (63)
        self.paper = self.second + square - np.outer(self.bias, self.bias)
        found = attitude_moments(q, g.r1, g.r2, sigma, order="exact", frame="plain")
        self.exact, self.exact_bias = found.covariance, found.bias

    def error(self, covariance):
        """Distance of a covariance from the exact one."""
        return np.linalg.norm(covariance - self.exact)


def geometries(n, rng):
    """Random geometries, the singular ones left out."""
    while n:
        q, (r1, r2) = unit(rng.standard_normal(4)), directions(2, rng)
        e_n = q[:3] @ np.cross(r1, r2)
        if abs(e_n) > 0.05:
            n -= 1
            yield Pair(q * np.sign(e_n), r1, r2), abs(e_n)


@cache
def sample():
    """Thirty random geometries at a noise of 2 % of |qbar|."""
    rng = np.random.default_rng(14)
    return [Compared(g, 0.02 * length) for g, length in geometries(30, rng)]


@of("(63) with (65): the added term is of the covariance", FALSE, tol=1e-4)
def eq_63(rng):
    # along q the covariance begins with the variance of |e|^2 / 2, tr(C C) / 2, while
    # the added term is the square of its mean, tr(C)^2 / 4; noise of 0.5 % leaves 3e-5
    ((g, length),) = geometries(1, rng)
    one = Compared(g, 0.005 * length)
    q, scale = one.q, np.trace(one.second) ** 2
    truth = q @ one.exact @ q / scale
    printed = (q @ one.bias) ** 2 / scale
    right = 0.5 * np.trace(one.second @ one.second) / scale
    return truth, printed, right


@of("(63): no order higher than without the added term")
def eq_63_order(rng):
    ((g, length),) = geometries(1, rng)
    coarse, fine = (Compared(g, s * length) for s in (0.02, 0.01))
    printed = [c.second + np.outer(c.bias, c.bias) for c in (coarse, fine)]
    gaps = coarse.error(printed[0]), fine.error(printed[1])
    return 4.0, round(np.log2(gaps[0] / gaps[1]), 1)


def small_noise(rng):
    """Geometries with noises of four sizes, up to a thousand times apart.

    What second order misses at fourth over the size of the bias m of (52), m, that size
    and p, r, c, h, w, a, b of the page.
    """
    for g, length in geometries(12, rng):
        noise = 1e-3 * length * 10 ** rng.uniform(-3, 0, 4)
        given = g.q, g.r1, g.r2, noise
        second, fourth = (attitude_moments(*given, n, "plain") for n in (2, 4))
        b1, b2, r1, r2 = noise**2 / (4 * length**2)
        p, r = (b1 + r1) * g.d2 @ g.d2, b2 + r2
        c, h = length**2 / (g.d2 @ g.d2), g.d1 @ g.d1
        s = 1 - (g.s1 @ g.d2) ** 2 / (1 - h) / length**2
        w = s + h * (1 - s)
        a, b = p + r * w / 2, r * (1 - h) * np.sqrt(s * (1 - s))
        D, size = fourth.covariance - second.covariance, a**2 + b**2
        yield D / size, second.bias, size, (p, r, c, h, w, a, b)


@of("(63), any isotropic noise, small: nearer to the exact covariance by it", tol=1e-6)
def eq_63_nearer(rng):
    # what (63) gains, 2 m'Dm - |m|^4, is a sum of terms that are not negative
    found = list(small_noise(rng))
    truth = [(2 * m @ D @ m * s - (m @ m) ** 2) / s**2 for D, m, s, _ in found]
    printed = [
        not_negative(
            a**2 * (p**2 + (1 - 2 * c) * p * r * w + 3 / 4 * r**2 * w**2),
            b**2 * (16 - 2 * c) * p**2,
            b**2 * (10 * w + 6 + 6 * h - 2 * c) * p * r,
            b**2 * (3 / 2 * w**2 + 6 * h) * r**2,
            15 * b**4,
        )
        / size**2
        for *_, size, (p, r, c, h, w, a, b) in found
    ]
    return truth, printed


def not_negative(*terms):
    """A sum, each term of which is demanded to be so."""
    assert min(terms) >= 0
    return sum(terms)


def gain(g, noise):
    """By how much (63) is nearer than second order, over the square of the bias."""
    second, exact = (
        attitude_moments(g.q, g.r1, g.r2, noise, order=n, frame="plain")
        for n in (2, "exact")
    )
    miss = [
        np.linalg.norm(second.covariance + added - exact.covariance)
        for added in (0, np.outer(second.bias, second.bias))
    ]
    return (miss[0] - miss[1]) / (second.bias @ second.bias), miss


@of("(63), isotropic noise: nearer while |qbar| is two of its standard deviations")
def eq_63_far(rng):
    printed = [gain(g, 0.5 * length)[0] > 0 for g, length in geometries(8, rng)]
    near = [gain(g, 2.0 * length)[0] > 0 for g, length in geometries(8, rng)]
    return [True] * 8 + [False] * 8, printed + near


@of("(63), noise of rank one: not nearer for any noise", seeds=1, tol=1e-3)
def eq_63_rank_one(rng):
    # the four covariances are 0.01^2 v v'; errors of second order and of (63), by 1e-8
    q, *vectors = map(unit, RANK_ONE)
    r1, r2, *noise = vectors
    S = 1e-4 * np.array([np.outer(v, v) for v in noise])
    printed = [2.932, 3.110]
    return np.array(gain(Pair(q, r1, r2), S)[1]) * 1e8, printed


@of('abstract, sections 4 and 4.3: covariance "exact to the fourth order"', FALSE)
def exact_to_fourth_order(rng):
    ((g, length),) = geometries(1, rng)
    coarse, fine = (Compared(g, s * length) for s in (0.01, 0.005))
    truth = round(np.log2(coarse.error(coarse.paper) / fine.error(fine.paper)), 1)
    printed = 6.0  # what is left of a covariance that is right to fourth order
    right = 4.0
    return truth, printed, right


@of('abstract, sections 4 and 6: "increased accuracy"', FALSE, seeds=1)
def increased_accuracy(rng):
    farther = [c.error(c.paper) > c.error(c.second) for c in sample()]
    printed = not any(farther)
    right = 15 < sum(farther) < 30  # usually not, sometimes yes
    return True, printed, right


@of(
    'abstract and section 6: "alleviates issues related to singularity"', FALSE, seeds=1
)
def alleviates_singularity(rng):
    # noise of a sixth of |qbar|, and of all of it: how often is the paper's nearer,
    # and is its trace beyond 1, as of no unit quaternion's covariance?
    far, near = (
        [
            Compared(g, s * length)
            for g, length in geometries(20, np.random.default_rng(7))
        ]
        for s in (1 / 6, 1.0)
    )
    nearer = [sum(c.error(c.paper) < c.error(c.second) for c in x) for x in (far, near)]
    beyond = [sum(np.trace(c.paper) > 1 for c in x) for x in (far, near)]
    printed = nearer[1] > nearer[0]
    right = nearer[1] < nearer[0] / 2 and beyond[0] < beyond[1] / 2
    return True, bool(printed), bool(right)
