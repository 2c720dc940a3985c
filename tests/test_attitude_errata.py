"""The claims of section 5 and of eq. (38) against what simval computes.

What the source prints is evaluated in `tests/errata`; here its definitions, expanded by
polynomial algebra and Isserlis' theorem, are held to the contractions in use.
"""

import numpy as np
import pytest
from errata.polynomials import INDICES, Q, R, U, X, isserlis, times
from oracles.attitude_errors import multiplicative_matrix, paper_fourth_terms

from simval.geometry import (
    compose,
    conjugate,
    normalize,
    random_quaternions,
)
from simval.theory.expansion import (
    quadratic_covariance,
    quadratic_form,
    second_order_bias,
)


def evaluate(polynomial, q, P):
    values = {f"q{i + 1}": q[i] for i in range(4)}
    values |= {f"s{i + 1}{j + 1}": P[i, j] for i in range(4) for j in range(i, 4)}
    return sum(
        c * np.prod([values[n] for n in names]) for names, c in polynomial.items()
    )


def problem(seed=0):
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((4, 4))
    return normalize(rng.standard_normal(4)), F @ F.T / 10, rng


def test_the_six_terms_are_the_moment_of_the_quadratic_error():
    # definition, with Terms 2 and 3 made symmetric, against the contraction in use
    q, P, _ = problem()
    terms = np.zeros((6, 4, 4))
    for i, j in INDICES:
        parts = [
            (0, times(U, U, X[i], X[j]), 1.0),
            (1, times(U, U, U, X[i], Q[j]), -1.5),
            (1, times(U, U, U, X[j], Q[i]), -1.5),
            (2, times(R, U, X[i], Q[j]), 0.5),
            (2, times(R, U, X[j], Q[i]), 0.5),
            (3, times(R, R, Q[i], Q[j]), 0.25),
            (4, times(U, U, R, Q[i], Q[j]), -1.5),
            (5, times(U, U, U, U, Q[i], Q[j]), 2.25),
        ]
        for k, polynomial, factor in parts:
            value = evaluate(isserlis(polynomial), q, P)
            terms[k, i - 1, j - 1] += factor * value
    # 50 to 350 products of numbers below 1
    np.testing.assert_allclose(paper_fourth_terms(q, P), terms, rtol=0, atol=1e-13)
    total = terms.sum(axis=0)
    mean = np.einsum("bcd,cd->b", quadratic_form(q), P)
    np.testing.assert_allclose(mean, second_order_bias(q, P), rtol=0, atol=1e-14)
    found = quadratic_covariance(q, P) + np.outer(mean, mean)
    np.testing.assert_allclose(found, total, rtol=0, atol=1e-13)


def test_composition_with_the_printed_scalar_breaks_the_multiplicative_error():
    # eq. (38) prints e1.e2 - q1 q2; then q^-1 * q = (0, -1), which contradicts (45)
    q, _, rng = problem(2)
    other = random_quaternions(1, rng)[0]
    right = compose(conjugate(q), other)
    np.testing.assert_allclose(
        right, -multiplicative_matrix(q) @ other, rtol=0, atol=1e-15
    )  # (47)
    e1, s1, e2, s2 = -q[:3], q[3], other[:3], other[3]
    printed_scalar = e1 @ e2 - s1 * s2
    assert printed_scalar == pytest.approx(-right[3], abs=1e-15)
