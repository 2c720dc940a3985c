"""Truncated power series: the algebra, and theory for an estimator of one's own."""

import numpy as np
import pytest

from simval.errors import InputError, RefusedError
from simval.theory.series import algebra, series_moments


def test_arithmetic_against_a_symbolic_expansion():
    sympy = pytest.importorskip("sympy")
    x, y, t = sympy.symbols("x y t")

    def function(a, b, sqrt):
        return (2 - a * b + sqrt(3 + a - b)) / (1.5 + b * b - a) - 1 / (2 + b) + a**3

    tables = algebra(2, 4)
    found = function(tables.variable(0), tables.variable(1), lambda v: v.sqrt())
    scaled = function(x * t, y * t, sympy.sqrt)
    taylor = sympy.series(scaled, t, 0, 5).removeO().subs(t, 1)
    polynomial = sympy.Poly(sympy.expand(taylor), x, y)
    monomials = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    monomials += [(3 - k, k) for k in range(4)] + [(4 - k, k) for k in range(5)]
    expected = [float(polynomial.coeff_monomial(x**i * y**j)) for i, j in monomials]
    # some thirty operations on numbers below 10
    np.testing.assert_allclose(found.coefficients, expected, rtol=0, atol=300 * 2.3e-16)


def test_moments_of_the_length_of_a_vector():
    # E|g + n| = g + s^2/g and V|g + n| = s^2 - s^4/g^2, up to exp(-g^2/2s^2), in
    # three dimensions: the standard result for the Maxwell distribution off centre
    g, s = 2.0, 0.1
    found = series_moments(
        lambda v: [np.sqrt(np.sum(v * v))],
        [[0.0, 0.0, g]],
        [s**2 * np.eye(3)],
    )
    assert found.bias[0] == pytest.approx(-(s**2) / g, rel=1e-13)
    assert found.covariance[0, 0] == pytest.approx(s**2 - s**4 / g**2, rel=1e-13)
    second = series_moments(
        lambda v: [np.sqrt(np.sum(v * v))], [[0.0, 0.0, g]], [s**2 * np.eye(3)], order=2
    )
    assert second.covariance[0, 0] == pytest.approx(s**2, rel=1e-13)


def test_sixth_order_of_a_polynomial():
    # e = n + n^2 + n^3 of one normal of standard deviation s:
    # E e = s^2, V e = s^2 + (3 - 1 + 6) s^4 + 15 s^6
    s = 0.3
    cov = np.zeros((1, 3, 3))
    cov[0, 1, 1] = s**2
    found = series_moments(
        lambda v: [-(v[1] + v[1] * v[1] + v[1] ** 3)], np.zeros((1, 3)), cov, order=6
    )
    assert found.bias[0] == pytest.approx(s**2, rel=1e-13)
    expected = s**2 + 8 * s**4 + 15 * s**6
    assert found.covariance[0, 0] == pytest.approx(expected, rel=1e-13)


def test_bad_input_is_refused():
    one, cov = np.ones((1, 3)), np.eye(3)[None]
    with pytest.raises(InputError, match="`order`"):
        series_moments(lambda v: v, one, cov, order=3)
    with pytest.raises(InputError, match="covariances"):
        series_moments(lambda v: v, one, np.ones((2, 3, 3)))
    with pytest.raises(RefusedError, match="no power series"):
        series_moments(lambda v: [1 / (v[0] - 1.0)], one, cov)
    with pytest.raises(RefusedError, match="no power series"):
        series_moments(lambda v: [np.sqrt(v[0] - 2.0)], one, cov)
