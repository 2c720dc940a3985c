"""Peng and Choukroun, section 4.2.2: expansions, eqs. (48) to (50)."""

import numpy as np

from errata.claim import FALSE, MISPRINTED, WORDING, add, claims
from errata.errors import ONE
from errata.geometry import inverse, multiply, quaternion, taylor, unit

SOURCE = "quaternion"
add(
    SOURCE,
    "(48), (49), (51) to (54): equalities that hold to second order, (54) to first",
    WORDING,
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
