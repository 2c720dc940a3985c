"""Peng and Choukroun, section 5 up to its tables: the terms of fourth order."""

import numpy as np

from errata.claim import FALSE, ILLEGIBLE, MISPRINTED, add, claim
from errata.gaussian import quadratic
from errata.geometry import covariance, gaussian_mean, mean_square, quaternion, unit
from errata.moments import normal_matrix

SOURCE = "quaternion"
of = claim(SOURCE)
add(SOURCE, "section 5, Term 3: its products", ILLEGIBLE)
add(SOURCE, "section 5, Term 6: its products", ILLEGIBLE)
add(SOURCE, "section 5, Term 2: products 31 and 32", ILLEGIBLE)
add(SOURCE, "section 5, Term 3: moment 44", ILLEGIBLE)


def parts(rng):
    """q, P, tr(QP), and the mean of the second-order term by quadrature."""
    q, P = quaternion(rng), covariance(4, rng)
    return q, P, np.trace(normal_matrix(q) @ P)


def mean(form, P):
    """Mean of a form of x of degree 4 or less, exact."""
    return gaussian_mean(form, P)


@of("section 5, the deviation")
def deviation(rng):
    q, P, trace = parts(rng)
    x = 0.3 * rng.standard_normal(4)
    first = x - q * (q @ x)
    truth = first + quadratic(q, x) - mean(lambda y: quadratic(q, y), P)
    second = np.outer(x, x) + 0.5 * x @ normal_matrix(q) @ x * np.eye(4)
    printed = first + (second - (P + 0.5 * trace * np.eye(4))) @ q
    return truth, printed


@of("section 5, covariance: the first two terms with a minus")
def minus_terms_1_2(rng):
    q, P, _ = parts(rng)
    Q, outer = normal_matrix(q), np.outer(q, q)
    truth = np.outer(P @ q, mean(lambda x: quadratic(q, x), P))
    printed = mean(lambda x: P @ outer @ np.outer(x, x), P) + mean(
        lambda x: 0.5 * P @ outer * (x @ Q @ x), P
    )
    return truth, printed


@of("section 5, covariance: the third term with a minus †", MISPRINTED)
def minus_term_3(rng):
    q, P, trace = parts(rng)
    truth = 0.5 * trace * np.outer(q, mean(lambda x: x * (x @ q), P))
    printed = mean(lambda x: 0.5 * trace * np.eye(4) * (x @ q * q @ x), P)
    right = mean(lambda x: 0.5 * trace * np.outer(q, q) @ np.outer(x, x), P)
    return truth, printed, right


@of("section 5, covariance: the fourth term with a minus †", MISPRINTED)
def minus_term_4(rng):
    q, P, trace = parts(rng)
    Q = normal_matrix(q)
    truth = 0.25 * trace * np.outer(q, mean(lambda x: x @ Q @ x * q, P))
    printed = mean(lambda x: 0.25 * trace * np.eye(4) * (x @ q) * (x @ Q @ x), P)
    right = mean(lambda x: 0.25 * trace * np.outer(q, q) * (x @ Q @ x), P)
    return truth, printed, right


@of("section 5, covariance: the four terms with a plus")
def plus_terms(rng):
    q, P, _ = parts(rng)
    Q, qq = normal_matrix(q), np.outer(q, q)
    truth = mean_square(lambda x: quadratic(q, x), P)
    printed = mean(
        lambda x: (
            np.outer(x, x) @ qq @ np.outer(x, x)
            + 0.5 * np.outer(x, x) @ qq * np.trace(Q @ np.outer(x, x))
            + 0.5 * np.trace(Q @ np.outer(x, x)) * qq @ np.outer(x, x)
            + 0.25 * np.trace(Q @ np.outer(x, x)) ** 2 * qq
        ),
        P,
    )
    return truth, printed


@of("section 5: the terms with a plus are all that is of fourth order", FALSE)
def fourth_order_terms(rng):
    # those with a minus are of fourth order too, and sum to bias times bias'
    q, P, _ = parts(rng)
    bias = mean(lambda x: quadratic(q, x), P)
    truth = mean_square(lambda x: quadratic(q, x) - bias, P)
    printed = mean_square(lambda x: quadratic(q, x), P)
    right = mean_square(lambda x: quadratic(q, x), P) - np.outer(bias, bias)
    return truth, printed, right


def six(q, P, second, third):
    """The sum of the six terms, with forms of the second and the third."""

    def terms(x):
        u, r, qq = q @ x, x @ x, np.outer(q, q)
        rest = 0.25 * r**2 - 1.5 * u**2 * r + 2.25 * u**4
        return u**2 * np.outer(x, x) + second(u, r, x) + third(u, r, x) + rest * qq

    return mean(terms, P)


@of("section 5, sum of six terms: Term 2", MISPRINTED)
def term_2(rng):
    q, P, _ = parts(rng)
    truth = mean_square(lambda x: quadratic(q, x), P)

    def third(u, r, x):
        return 0.5 * r * u * (np.outer(x, q) + np.outer(q, x))

    printed = six(q, P, lambda u, r, x: -3 * u**3 * np.outer(x, q), third)
    right = six(
        q, P, lambda u, r, x: -1.5 * u**3 * (np.outer(x, q) + np.outer(q, x)), third
    )
    return truth, printed, right


@of("section 5, sum of six terms: Term 3", MISPRINTED)
def term_3(rng):
    q, P, _ = parts(rng)
    truth = mean_square(lambda x: quadratic(q, x), P)

    def second(u, r, x):
        return -1.5 * u**3 * (np.outer(x, q) + np.outer(q, x))

    printed = six(q, P, second, lambda u, r, x: r * np.outer(x, x) @ np.outer(q, q))
    right = six(
        q, P, second, lambda u, r, x: 0.5 * r * u * (np.outer(x, q) + np.outer(q, x))
    )
    return truth, printed, right


@of("section 5, sum of six terms: Terms 1, 4, 5 and 6")
def other_terms(rng):
    q, P, _ = parts(rng)
    n = unit(np.cross(q[:3], [1, 2, 3]))
    v = np.append(n, 0)  # normal to q, and q: where the symmetric parts are seen alone
    square = mean_square(lambda x: quadratic(q, x), P)
    u4 = mean(lambda x: (q @ x) ** 4, P)
    u2r = mean(lambda x: (q @ x) ** 2 * (x @ x), P)
    r2 = mean(lambda x: (x @ x) ** 2, P)
    printed = [
        v @ mean(lambda x: (x @ q) ** 2 * np.outer(x, x), P) @ v,
        u4 - 3 * u4 + u2r + 0.25 * r2 - 1.5 * u2r + 2.25 * u4,
    ]
    return [v @ square @ v, q @ square @ q], printed


@of("section 5: sigma_ij is a correlation factor", MISPRINTED)
def correlation_factor(rng):
    P = covariance(4, rng)
    scale = np.sqrt(np.diag(P))
    correlation = P / np.outer(scale, scale)
    truth = mean(lambda x: x[0] * x[1] * x[2] * x[3], P)
    printed = pairings(correlation)
    right = pairings(P)
    return truth, printed, right


def pairings(s):
    """E{x1 x2 x3 x4} as printed."""
    return s[0, 1] * s[2, 3] + s[0, 2] * s[1, 3] + s[0, 3] * s[1, 2]


@of("section 5, the five fourth moments")
def fourth_moments(rng):
    P = covariance(4, rng)
    (i, j, k, m), s = rng.permutation(4), P
    var = np.diag(P)
    truth = mean(
        lambda x: np.array(
            [
                x[i] * x[j] * x[k] * x[m],
                x[i] ** 2 * x[j] * x[k],
                x[i] ** 2 * x[j] ** 2,
                x[i] ** 3 * x[j],
                x[i] ** 4,
            ]
        ),
        P,
    )
    printed = [
        s[i, j] * s[k, m] + s[i, k] * s[j, m] + s[i, m] * s[j, k],
        var[i] * s[j, k] + 2 * s[i, j] * s[i, k],
        var[i] * var[j] + 2 * s[i, j] ** 2,
        3 * var[i] * s[i, j],
        3 * var[i] ** 2,
    ]
    return truth, printed
