"""Power series of any arithmetic estimator."""

import math

import numpy as np
import pytest
from rounding import EPS

from simval.errors import InputError, RefusedError
from simval.theory.series import algebra, series_moments


@pytest.mark.ci
def test_arithmetic_against_coefficients_from_two_circles():
    def function(a, b, sqrt):
        return (2 - a * b + sqrt(3 + a - b)) / (1.5 + b * b - a) - 1 / (2 + b) + a**3

    tables = algebra(2, 4)
    found = function(tables.variable(0), tables.variable(1), lambda v: v.sqrt())
    # the nearest singularity is at 1.9 radii: 64 nodes leave 1e-18
    radius, nodes = 0.6, 64
    circle = radius * np.exp(2j * np.pi * np.arange(nodes) / nodes)
    values = function(circle[:, None], circle[None, :], np.sqrt)
    monomials = [(n - k, k) for n in range(5) for k in range(n + 1)]
    table = np.fft.fft2(values).real / nodes**2
    expected = [table[i, j] / radius ** (i + j) for i, j in monomials]
    # some thirty operations on numbers below 10, over the fourth power of the radius
    np.testing.assert_allclose(found.coefficients, expected, rtol=0, atol=300 * EPS)


def test_moments_of_the_length_of_a_vector():
    # E|g + n| = g + s^2/g and V|g + n| = s^2 - s^4/g^2, up to exp(-g^2/2s^2), in
    # three dimensions: the standard result for the Maxwell distribution off centre
    g, s = 2.0, 0.1
    found = series_moments(
        lambda v: [np.sqrt(np.sum(v * v))], [[0.0, 0.0, g]], [s**2 * np.eye(3)]
    )
    # a handful of series operations, no cancellation
    assert found.bias[0] == pytest.approx(-(s**2) / g, rel=100 * EPS, abs=0)
    assert found.covariance[0, 0] == pytest.approx(
        s**2 - s**4 / g**2, rel=100 * EPS, abs=0
    )
    second = series_moments(
        lambda v: [np.sqrt(np.sum(v * v))], [[0.0, 0.0, g]], [s**2 * np.eye(3)], order=2
    )
    assert second.covariance[0, 0] == pytest.approx(s**2, rel=100 * EPS, abs=0)


def test_bad_input_is_refused():
    one, cov = np.ones((1, 3)), np.eye(3)[None]
    with pytest.raises(InputError, match="`order`"):
        series_moments(lambda v: v, one, cov, order=5)
    with pytest.raises(InputError, match="covariances"):
        series_moments(lambda v: v, one, np.ones((2, 3, 3)))
    with pytest.raises(RefusedError, match="no power series"):
        series_moments(lambda v: [1 / (v[0] - 1.0)], one, cov)
    with pytest.raises(RefusedError, match="no power series"):
        series_moments(lambda v: [np.sqrt(v[0] - 2.0)], one, cov)
    with pytest.raises(InputError, match="not a finite number"):
        series_moments(lambda v: np.ma.masked_equal([1.0, 2.0], 1.0), one, cov)


def one_result(estimator):
    inputs = np.array([[1.0, 2.0, 3.0], [0.5, -1.0, 2.0]])
    return series_moments(estimator, inputs, np.stack([0.01 * np.eye(3)] * 2))


# the other branch would have another variance, or another bias
BRANCHES = [
    (lambda a, b: [abs(b[1]) * b[0]], lambda a, b: [-b[1] * b[0]]),
    (lambda a, b: [np.abs(a[0]) * a[0]], lambda a, b: [a[0] * a[0]]),
    (lambda a, b: [a[0] if a[0] < b[0] else 2 * b[0]], lambda a, b: [2 * b[0]]),
    (lambda a, b: [a[0] if a[0] <= 2.0 else 2 * b[0]], lambda a, b: [a[0]]),
    (lambda a, b: [a[0] if b[1] > 0 else 2 * a[1]], lambda a, b: [2 * a[1]]),
    (lambda a, b: [a[0] if a[1] >= b[1] else 2 * a[1]], lambda a, b: [a[0]]),
    (lambda a, b: [max(2 * a[0], b[0])], lambda a, b: [2 * a[0]]),
    (lambda a, b: [np.maximum(2 * a[0], b[0])], lambda a, b: [2 * a[0]]),
    (lambda a, b: [+a[0] if a[0] else 2 * b[0]], lambda a, b: [a[0]]),
    (lambda a, b: [a[0] * a[0], 1], lambda a, b: [a[0] * a[0], b[1] * 0]),
]


def test_a_branch_is_the_one_without_noise():
    for branching, taken in BRANCHES:
        found, expected = one_result(branching), one_result(taken)
        np.testing.assert_array_equal(found.bias, expected.bias)
        np.testing.assert_array_equal(found.covariance, expected.covariance)


def test_a_branch_at_the_truth_is_refused():
    for branching in (
        lambda a, b: [abs(a[0] - 1)],
        lambda a, b: [a[0] if a[0] > 1 else b[0]],
        lambda a, b: [a[0] if a[1] <= 2.0 else b[0]],
        lambda a, b: [1 if a[0] - 1 else 0],
    ):
        with pytest.raises(RefusedError, match="branches at a quantity"):
            one_result(branching)


def test_what_has_no_series_says_what_to_do():
    for foreign in (
        lambda a, b: [math.sqrt(a[0])],
        lambda a, b: [math.hypot(a[0], a[1])],
        lambda a, b: [np.sin(a[0])],
        lambda a, b: a[0] * b[0],
        lambda a, b: a[:, 0:1] * 2,
        lambda a, b: np.sum(a * b, axis=1),
        lambda a, b: [float(a[0])],
        lambda a, b: [[a[0]]],
        lambda a, b: None,
    ):
        with pytest.raises(InputError, match=r"numpy\.sqrt, take one .*not batches"):
            one_result(foreign)


INPUTS = np.array([[0.5, 1.0, -0.5], [1.0, 0.25, 0.5]])
ROOTS = np.zeros((2, 3, 3))  # of the covariances, at noise 1: three normals
ROOTS[0, :2, :2] = [[1.0, 0.0], [-0.5, 0.75]]
ROOTS[1, 2, 2] = 0.5
APART = np.zeros((6, 3))  # the same, all vectors stacked
APART[:2, :2], APART[5, 2] = ROOTS[0, :2, :2], 0.5
TOGETHER = APART.copy()  # b moves with a
TOGETHER[3:] = [[0.2, 0.1, 0.0], [0.0, 0.3, 0.1], [0.5, -0.2, 0.4]]
NORMAL = np.polynomial.hermite_e.hermegauss(40)  # 60 nodes change no digit
SKEWNESS = np.array([1.0, -2.0, 0.5])


def two_points(skewness):
    """The law of mean 0, variance 1 and that third moment on two points."""
    root = np.sqrt(skewness**2 + 4.0)
    x = (skewness + np.array([-root, root])) / 2.0  # the roots of x^2 = 1 + skewness x
    return x, np.array([x[1], -x[0]]) / (x[1] - x[0])


def estimator(a, b):
    """Roots, a quotient and products, on series and on batches (3, n) alike.

    Every function is smooth as far as the quadrature looks.
    """
    length = (4.0 + a[0] + a[1] * a[1]) ** 0.5
    return [
        length - b[2] * b[2],
        a[1] / (3.0 + a[0] + b[2]),
        length * b[2] + 2.0 * a[0] * a[0] * a[0],
    ]


def quadrature(noise, root, laws):
    """Mean and covariance of truth minus estimate, each variable with its own law."""
    nodes, weights = zip(*laws, strict=True)
    x = np.stack(np.meshgrid(*nodes, indexing="ij")).reshape(3, -1)
    w = np.prod(np.meshgrid(*weights, indexing="ij"), axis=0).ravel()
    w /= w.sum()
    moved = INPUTS.reshape(6, 1) + noise * root @ x
    error = np.array(estimator(*INPUTS))[:, None] - np.array(
        estimator(moved[:3], moved[3:])
    )
    mean = error @ w
    off = error - mean[:, None]
    return mean, (off * w) @ off.T


def left_out(noise, order, root=APART, laws=(NORMAL,) * 3, third_moments=None):
    """Bias and covariance that the series of an order leaves out, entry by entry."""
    covariances = noise**2 * ROOTS @ ROOTS.transpose(0, 2, 1)
    if root is not APART:
        covariances = noise**2 * root @ root.T
    if third_moments is not None:
        third_moments = noise**3 * third_moments
    found = series_moments(estimator, INPUTS, covariances, order, third_moments)
    mean, covariance = quadrature(noise, root, laws)
    upper = np.triu_indices(3)
    return np.concatenate([found.bias - mean, (found.covariance - covariance)[upper]])


@pytest.mark.parametrize("root", [APART, TOGETHER], ids=["apart", "together"])
@pytest.mark.parametrize("order", [2, 4, 6])
def test_what_an_order_leaves_out_is_two_orders_higher(order, root):
    # between noise s and s/2 the next term falls by 2^(k+2), and the one after it, at
    # s = 0.2 up to a quarter of it, by 2^(k+4): the slope is k + 2 within 0.4. At s/2
    # and order 6 at least 2e-11 is left out, and rounding is 1e-15.
    coarse, fine = left_out(0.2, order, root), left_out(0.1, order, root)
    seen = np.abs(coarse) > 1e-9  # of one product the next two terms nearly cancel
    slope = np.log2(np.abs(coarse[seen] / fine[seen]))
    assert seen.sum() >= 8
    np.testing.assert_allclose(slope, order + 2.0, rtol=0, atol=0.4)


@pytest.mark.parametrize("root", [APART, TOGETHER], ids=["apart", "together"])
def test_third_moments_leave_the_fourth_order(root):
    laws = [two_points(skewness) for skewness in SKEWNESS]
    S = np.einsum("ia,ja,ka,a", root, root, root, SKEWNESS)
    if root is APART:  # as the moments of each vector
        each = S.reshape(2, 3, 2, 3, 2, 3)
        S = np.stack([each[k, :, k, :, k, :] for k in (0, 1)])
    sizes = (0.01, 0.005)
    for order, given, power in ((3, S, 4.0), (3, None, 3.0), (2, S, 3.0)):
        found = np.array([left_out(s, order, root, laws, given) for s in sizes])
        # of bias and covariance: an entry's own terms may cancel
        parts = np.split(found, [3], axis=1)
        slope = [np.log2(np.divide(*np.linalg.norm(part, axis=1))) for part in parts]
        # the next order bends a slope by its relative size: 0.01 times some ten
        np.testing.assert_allclose(slope, power, rtol=0, atol=0.2)


def test_third_moments_that_are_none_are_refused():
    root, S = TOGETHER, np.einsum("ia,ja,ka->ijk", TOGETHER, TOGETHER, TOGETHER)
    skew = S.copy()
    skew[0, 1, 2] += 1e-6
    outside = S.copy()
    outside[0, 0, 0] += 1e-3
    for given, order, said in (
        (skew, 3, "exchanged"),
        (outside, 3, "no *variance"),
        (S[:3], 3, "has shape"),
        (S * np.nan, 3, "finite"),
        (S, 6, "highest is 4"),
        (1e4 * S, 3, "skewness of"),
    ):
        with pytest.raises(InputError, match=said):
            series_moments(estimator, INPUTS, root @ root.T, order, given)
    with pytest.raises(InputError, match="`covariances`"):
        series_moments(estimator, INPUTS, np.eye(5))
