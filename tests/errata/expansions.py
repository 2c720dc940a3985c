"""Peng and Choukroun, section 4.2.2: expansions, eqs. (48) to (50)."""

import numpy as np

from errata.claim import FALSE, MISPRINTED, WORDING, add, claim
from errata.errors import ONE
from errata.geometry import directions, inverse, multiply, quaternion, taylor, unit

SOURCE = "quaternion"
of = claim(SOURCE)
add(
    SOURCE,
    "(48), (49), (51) to (54): equalities that hold to second order, (54) to first",
    WORDING,
)


def exact_error(q, x):
    """q - qhat from the scaled error, by the definitions; x may be complex."""
    v = q - x
    return q - v / np.sqrt(np.sum(v * v))


@of("section 4.2.2: the multiplicative error is linear in the scaled one", FALSE)
def linear_in_the_scaled_error(rng):
    q, x = quaternion(rng), 0.2 * rng.standard_normal(4)
    error = exact_error(q, x)

    def of_scaled(d):
        return multiply(inverse(q), q - exact_error(q, d))

    def of_normalised(d):
        return multiply(inverse(q), q - d)

    truth = np.zeros(4)
    printed = of_scaled(2 * x) - 2 * of_scaled(x) + ONE
    right = of_normalised(2 * error) - 2 * of_normalised(error) + ONE
    return truth, printed, right


@of("(48)")
def eq_48(rng):
    q, x = quaternion(rng), unit(rng.standard_normal(4))
    Q = np.eye(4) - 3 * np.outer(q, q)
    truth = taylor(lambda t: np.sum((q - t * x) ** 2) ** -0.5, 2)
    printed = [1, q @ x, -0.5 * x @ Q @ x]
    return truth, printed


@of("(49)")
def eq_49(rng):
    q, x = quaternion(rng), unit(rng.standard_normal(4))
    Q = np.eye(4) - 3 * np.outer(q, q)
    truth = taylor(lambda t: exact_error(q, t * x), 2)[1:]
    printed = [
        (np.eye(4) - np.outer(q, q)) @ x,
        (np.outer(x, x) + 0.5 * x @ Q @ x * np.eye(4)) @ q,
    ]
    return truth, printed


@of("(50)")
def eq_50(rng):
    q, x = quaternion(rng), unit(rng.standard_normal(4))
    printed = np.eye(4) - 3 * np.outer(q, q)
    truth = taylor(lambda t: np.sum((q - t * x) ** 2) ** -0.5, 2)[2]
    return truth, -0.5 * x @ printed @ x


@of("after (50): the first-order term lies in the tangent plane")
def tangent_term(rng):
    q, x = quaternion(rng), unit(rng.standard_normal(4))
    term = taylor(lambda t: exact_error(q, t * x), 1)[1]
    printed = q @ term
    return 0.0, printed


@of("after (50): the second-order term is one along the error and one along q")
def second_order_directions(rng):
    q, x = quaternion(rng), unit(rng.standard_normal(4))
    term = taylor(lambda t: exact_error(q, t * x), 2)[2]
    printed = np.linalg.matrix_rank(np.stack([q, x, term]), tol=1e-9)
    return 2, printed


@of("after (50): the formulas hold for any estimator")
def any_estimator(rng):
    # an estimate that has nothing to do with two vectors
    q, v = quaternion(rng), directions(1, rng)[0]
    estimate = q + 0.02 * np.append(v, 0.5)
    truth, x = q - unit(estimate), q - estimate
    nu = (1 - 2 * q @ x + x @ x) ** -0.5
    printed = nu * x + (1 - nu) * q
    return truth, printed


@of("the development of (48): nu in powers of epsilon")
def development_48(rng):
    q, x = quaternion(rng), unit(rng.standard_normal(4))
    eps = [0.0, -2 * q @ x, x @ x]  # of t, t^2
    truth = taylor(lambda t: np.sum((q - t * x) ** 2) ** -0.5, 2)
    printed = [
        [1, -0.5 * eps[1], -0.5 * eps[2] + 3 / 8 * eps[1] ** 2],
        [1, q @ x, -0.5 * x @ x + 1.5 * (q @ x) ** 2],
    ]
    return [truth, truth], printed


@of('the development of (48): "yields Eq. (43)"', MISPRINTED)
def expansion_yields(rng):
    q, x = quaternion(rng), 0.5 * unit(rng.standard_normal(4))
    Q = np.eye(4) - 3 * np.outer(q, q)
    eps = -2 * q @ x + x @ x
    # to second order in x, the expansion is (48) and not the exact (43)
    truth = 1 - 0.5 * eps + 3 / 8 * (2 * q @ x) ** 2
    printed = (1 - 2 * q @ x + x @ x) ** -0.5
    right = 1 + q @ x - 0.5 * x @ Q @ x
    return truth, printed, right
