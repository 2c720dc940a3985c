"""Peng and Choukroun, section 5 up to its tables: the terms of fourth order."""

import numpy as np

from errata.claim import FALSE, ILLEGIBLE, MISPRINTED, claims, unevaluated
from errata.geometry import covariance, mean_square, quaternion, unit
from errata.geometry import gaussian_mean as mean
from errata.moments import normal_matrix, quadratic

SOURCE = "quaternion"
unevaluated(SOURCE, "section 5, covariance: its symbol, a tilde for a hat †")
unevaluated(
    SOURCE,
    "section 5, Term 3: its other products",
    "section 5, Term 6: its other products",
    "section 5, Term 3: moment 44",
    verdict=ILLEGIBLE,
)


@claims(
    SOURCE,
    deviation="section 5, the deviation",
    minus_terms_1_2="section 5, covariance: the first two terms with a minus",
    minus_term_3=("section 5, covariance: the third term with a minus †", MISPRINTED),
    minus_term_4=("section 5, covariance: the fourth term with a minus †", MISPRINTED),
    plus_terms="section 5, covariance: the four terms with a plus",
    fourth_order_terms=(
        "section 5: the terms with a plus are all that is of fourth order",
        FALSE,
    ),
)
def deviation_and_covariance(rng):
    q, P = quaternion(rng), covariance(4, rng)
    Q, qq, one = normal_matrix(q), np.outer(q, q), np.eye(4)
    trace, bias = np.trace(Q @ P), mean(lambda x: quadratic(q, x), P)
    x = 0.3 * rng.standard_normal(4)
    first, second = x - q * (q @ x), np.outer(x, x) + 0.5 * x @ Q @ x * one
    deviation = (
        first + quadratic(q, x) - bias,
        first + (second - (P + 0.5 * trace * one)) @ q,
    )
    minus_terms_1_2 = (
        np.outer(P @ q, bias),
        mean(lambda x: P @ qq @ np.outer(x, x), P)
        + mean(lambda x: 0.5 * P @ qq * (x @ Q @ x), P),
    )
    minus_term_3 = (
        0.5 * trace * np.outer(q, P @ q),
        mean(lambda x: 0.5 * trace * one * (x @ q * q @ x), P),
        mean(lambda x: 0.5 * trace * qq @ np.outer(x, x), P),
    )
    minus_term_4 = (
        0.25 * trace**2 * qq,
        mean(lambda x: 0.25 * trace * one * (x @ q) * (x @ Q @ x), P),
        mean(lambda x: 0.25 * trace * qq * (x @ Q @ x), P),
    )
    plus_terms = (
        mean_square(lambda x: quadratic(q, x), P),
        mean(
            lambda x: (
                np.outer(x, x) @ qq @ np.outer(x, x)
                + 0.5 * np.outer(x, x) @ qq * np.trace(Q @ np.outer(x, x))
                + 0.5 * np.trace(Q @ np.outer(x, x)) * qq @ np.outer(x, x)
                + 0.25 * np.trace(Q @ np.outer(x, x)) ** 2 * qq
            ),
            P,
        ),
    )
    # those with a minus are of fourth order too, and sum to bias times bias'
    fourth_order_terms = (
        mean_square(lambda x: quadratic(q, x) - bias, P),
        mean_square(lambda x: quadratic(q, x), P),
        mean_square(lambda x: quadratic(q, x), P) - np.outer(bias, bias),
    )
    return locals()


def six(q, P, second=None, third=None):
    """The sum of the six terms, with forms of the second and the third, or as right."""

    def symmetric(x):
        return np.outer(x, q) + np.outer(q, x)

    def terms(x):
        u, r, qq = q @ x, x @ x, np.outer(q, q)
        two = second(u, x) if second else -1.5 * u**3 * symmetric(x)
        three = third(r, x) if third else 0.5 * r * u * symmetric(x)
        rest = 0.25 * r**2 - 1.5 * u**2 * r + 2.25 * u**4
        return u**2 * np.outer(x, x) + two + three + rest * qq

    return mean(terms, P)


@claims(
    SOURCE,
    term_2=("section 5, sum of six terms: Term 2", MISPRINTED),
    term_3=("section 5, sum of six terms: Term 3", MISPRINTED),
    other_terms="section 5, sum of six terms: Terms 1, 4, 5 and 6",
    correlation_factor=("section 5: sigma_ij is a correlation factor", MISPRINTED),
    fourth_moments="section 5, the five fourth moments",
)
def six_terms(rng):
    q, P = quaternion(rng), covariance(4, rng)
    square = mean_square(lambda x: quadratic(q, x), P)
    term_2 = (
        square,
        six(q, P, second=lambda u, x: -3 * u**3 * np.outer(x, q)),
        six(q, P, second=lambda u, x: -1.5 * u**3 * (np.outer(x, q) + np.outer(q, x))),
    )
    term_3 = (
        square,
        six(q, P, third=lambda r, x: r * np.outer(x, x) @ np.outer(q, q)),
        six(
            q,
            P,
            third=lambda r, x: 0.5 * r * (q @ x) * (np.outer(x, q) + np.outer(q, x)),
        ),
    )
    # normal to q, and along q: where the symmetric parts are seen alone
    v = np.append(unit(np.cross(q[:3], [1, 2, 3])), 0)
    u4 = mean(lambda x: (q @ x) ** 4, P)
    u2r = mean(lambda x: (q @ x) ** 2 * (x @ x), P)
    r2 = mean(lambda x: (x @ x) ** 2, P)
    other_terms = (
        [v @ square @ v, q @ square @ q],
        [
            v @ mean(lambda x: (x @ q) ** 2 * np.outer(x, x), P) @ v,
            u4 - 3 * u4 + u2r + 0.25 * r2 - 1.5 * u2r + 2.25 * u4,
        ],
    )
    scale = np.sqrt(np.diag(P))
    product = mean(lambda x: x[0] * x[1] * x[2] * x[3], P)
    correlation_factor = product, pairings(P / np.outer(scale, scale)), pairings(P)
    (i, j, k, m), s, var = rng.permutation(4), P, np.diag(P)
    fourth_moments = (
        mean(
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
        ),
        [
            s[i, j] * s[k, m] + s[i, k] * s[j, m] + s[i, m] * s[j, k],
            var[i] * s[j, k] + 2 * s[i, j] * s[i, k],
            var[i] * var[j] + 2 * s[i, j] ** 2,
            3 * var[i] * s[i, j],
            3 * var[i] ** 2,
        ],
    )
    return locals()


def pairings(s):
    """E{x1 x2 x3 x4} as printed."""
    return s[0, 1] * s[2, 3] + s[0, 2] * s[1, 3] + s[0, 3] * s[1, 2]
