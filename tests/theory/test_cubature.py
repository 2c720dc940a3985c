"""Smolyak Gauss-Hermite cubature: exactness, node counts, and bad input."""

import math
from itertools import combinations_with_replacement

import numpy as np
import pytest
from rounding import EPS

from simval.errors import InputError, RefusedError
from simval.theory.cubature import covariance_roots, cubature_moments, smolyak_hermite


def normal_moment(monomial):
    """E of a product of standard normals: double factorials, by definition."""
    powers = [monomial.count(v) for v in set(monomial)]
    if any(p % 2 for p in powers):
        return 0.0
    return float(math.prod(math.prod(range(p - 1, 0, -2)) for p in powers))


@pytest.mark.parametrize(("dimension", "degree"), [(1, 9), (2, 9), (4, 7), (4, 5)])
def test_exact_to_its_degree_and_not_beyond(dimension, degree):
    points, weights = smolyak_hermite(dimension, degree)
    for total in range(degree + 1):
        for monomial in combinations_with_replacement(range(dimension), total):
            value = np.prod(points[:, list(monomial)], axis=1) @ weights
            # rounding: sum of |weight * product| times a few eps
            scale = np.abs(weights) @ np.abs(np.prod(points[:, list(monomial)], axis=1))
            assert abs(value - normal_moment(monomial)) < 50 * EPS * max(1.0, scale)
    # The square of (degree + 1) / 2 different variables is the first that needs a
    # tensor product outside the rule, which gives 0 for its mean of 1.
    if dimension >= (degree + 1) // 2:
        beyond = np.prod(points[:, : (degree + 1) // 2] ** 2, axis=1) @ weights
        assert beyond == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("dimension", "degree", "count"), [(9, 5, 199), (9, 7, 1501), (12, 9, 24441)]
)
def test_node_counts_of_the_known_rules(dimension, degree, count):
    points, weights = smolyak_hermite(dimension, degree)
    assert points.shape == (count, dimension)
    # the centre's weight makes the sum 1; what is left is the sum's own rounding,
    # 325 (the sum of |weights|) times sqrt(24441) eps at worst
    assert abs(weights.sum() - 1.0) < 2e-11
    # symmetric to the last bit: odd moments vanish but for the summation
    order, mirrored = np.lexsort(points.T), np.lexsort(-points.T)
    np.testing.assert_array_equal(weights[order], weights[mirrored])


def test_moments_of_a_known_function():
    # v = m + n, n ~ N(0, S): the estimate |v|^2 has mean |m|^2 + tr S and variance
    # 4 m'Sm + 2 tr S^2, polynomials of degree 2 and 4.
    mean = np.array([[1.0, -2.0, 0.5]])
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, 0.4, 0.0]])
    S = root @ root.T  # singular on purpose
    found = cubature_moments(
        lambda v: np.sum(v * v, axis=1, keepdims=True), mean, S[None], [5.25], degree=5
    )
    assert found.bias[0] == pytest.approx(-np.trace(S), rel=1e-13, abs=0)
    variance = 4 * mean[0] @ S @ mean[0] + 2 * np.trace(S @ S)
    # some ten weights of either sign, numbers below 1
    assert found.covariance[0, 0] == pytest.approx(variance, rel=100 * EPS, abs=0)


def test_roots_are_the_symmetric_ones_where_eigenvalues_are_equal():
    rng = np.random.default_rng(20_267)
    v = rng.standard_normal((20, 3))
    v /= np.linalg.norm(v, axis=1)[:, None]
    planes = np.eye(3) - v[:, :, None] * v[:, None]  # a projector is its own root
    roots = covariance_roots(4.0 * planes)
    # the eigenvalue of 0 is rounded to some eps, whose root is 2e-8
    assert np.abs(roots - 2.0 * planes).max() < 1e-7
    assert np.abs(roots - roots.swapaxes(-1, -2)).max() < 1e-14


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="odd"):
        smolyak_hermite(3, 4)
    with pytest.raises(InputError, match="dimension"):
        smolyak_hermite(0, 5)
    one = np.ones((1, 3))
    with pytest.raises(InputError, match="covariances"):
        cubature_moments(lambda v: v, one, np.ones((2, 3, 3)), one[0])
    with pytest.raises(InputError, match="covariances"):
        cubature_moments(lambda v: v, one, np.full((1, 3, 3), np.nan), one[0])
    with pytest.raises(RefusedError, match="not finite"):
        cubature_moments(lambda v: v * np.nan, one, np.eye(3)[None], one[0])
    with pytest.raises(InputError, match="masked"):
        cubature_moments(
            lambda v: np.ma.array(v, mask=True), one, np.eye(3)[None], one[0]
        )
