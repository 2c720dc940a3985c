"""The exact oracle: its elementary functions, its quadrature, and Monte Carlo."""

import numpy as np
import pytest
from rounding import EPS
from scipy import integrate

from simval.attitude.kernel import normalize_columns, raw_quaternion
from simval.geometry import attitude_matrix, normalize, random_quaternions
from simval.theory import attitude_moments, exact
from simval.theory.exact import one_minus_a, one_minus_b
from simval.theory.two_vector import (
    column_norms,
    noise_covariances,
    two_vector_geometry,
)


def shares_by_quadrature(rho):
    """1 - E[c] and 1 - E[c^2], c the cosine of x ~ N(rho e, I) with e, integrated."""

    def density(c, r):
        return r * r * np.exp(-0.5 * (r * r - 2 * r * rho * c + rho * rho))

    def mean(f):
        return integrate.dblquad(
            lambda c, r: f(c) * density(c, r),
            max(0.0, rho - 12),
            rho + 12,
            -1,
            1,
            epsabs=1e-13,
            epsrel=1e-12,
        )[0] / np.sqrt(2 * np.pi)

    return mean(lambda c: 1 - c), mean(lambda c: 1 - c * c)


@pytest.mark.parametrize("rho", [0.0, 1e-3, 0.0099, 0.0101, 0.3, 2.0, 8.0])
def test_elementary_functions(rho):
    a, b = one_minus_a(np.array([rho]))[0], one_minus_b(np.array([rho]))[0]
    expected = shares_by_quadrature(rho)
    # the series side leaves out rho^4 / 140 < 1e-10; the closed side cancels to
    # eps / rho^3 = 2e-10 at rho = 0.01; quadrature 1e-12
    assert a == pytest.approx(expected[0], abs=3e-10)
    assert b == pytest.approx(expected[1], abs=3e-10)


def test_large_rho_keeps_its_digits():
    # 1 - A = 1/rho^2 up to e^(-rho^2/2); 1 - B = 2/rho^2 - 2/rho^4 - 2/rho^6 ...,
    # Dawson's asymptotic series; at 1e3 the third term is 1e-12 of the first
    rho = np.array([1e3])
    np.testing.assert_allclose(one_minus_a(rho), 1e-6, rtol=1e-14)
    np.testing.assert_allclose(one_minus_b(rho), 2e-6 - 2e-12, rtol=3e-12)
    assert one_minus_a(np.array([np.inf]))[0] == 0.0
    assert one_minus_b(np.array([np.inf]))[0] == 0.0


def test_branches_meet():
    below, above = np.nextafter(1e-2, 0), 1e-2
    for function in (one_minus_a, one_minus_b):
        gap = function(np.array([below])) - function(np.array([above]))
        # the series leaves out rho^4 / 140 = 7e-11, the closed form cancels to eps /
        # rho^2
        assert abs(gap[0]) < 5e-10


def moments_by_rule(g, noise, rule):
    tau1, tau2 = exact._isotropic_halves(noise)
    u, weights = (
        exact._about_d1(g, tau1, tau2, rule[1:])
        if rule[0] == "d1"
        else exact.about_d2(g.d2, tau2, rule[1:])
    )
    return (
        *exact._moments_given_directions(g, tau1, u, weights),
        weights.sum(),
    )


def attitude_norm(q, r1, r2, k):
    return abs(column_norms(q, r1, r2)[[3, 0, 1, 2][k]])


@pytest.mark.ci
def test_two_quadratures_in_different_coordinates_agree():
    # about d2, and on graded panels about d1: they share the integrand alone. Frames
    # that are nearly singular are included, where only the second resolves it.
    rng = np.random.default_rng(1)
    for k in range(8):
        q = random_quaternions(1, rng)[0]
        r1, r2 = normalize(rng.standard_normal((2, 3)))
        frame = ["plain", "x", "y", "z"][k % 4]
        if attitude_norm(q, r1, r2, k % 4) < 0.02:
            continue
        g = two_vector_geometry(q, r1, r2, frame)
        for sigma in (0.03, 0.3):
            noise = noise_covariances(sigma * rng.uniform(0.1, 1.0, 4))
            bias, covariance = exact.exact_moments(g, noise)
            fine_bias, fine, total = moments_by_rule(g, noise, ("d1", 32, 1200))
            # weights of some 1e4 nodes
            assert total == pytest.approx(1.0, abs=100 * EPS)
            assert np.linalg.norm(covariance - fine) < 1e-10 * np.linalg.norm(fine)
            assert np.linalg.norm(bias - fine_bias) < 1e-9 * np.linalg.norm(fine_bias)


@pytest.mark.parametrize("k", [0.3, 2.0, 3.5, 5.0, 8.0, 11.9, 12.1, 100.0, 1e4])
def test_density_integrates_to_one(k):
    # the polar range may be cut only where the density has fallen below rounding
    d2 = np.array([0.1, -0.3, 0.2])
    _, weights = exact.about_d2(d2, np.linalg.norm(d2) / k, (96, 4))
    assert weights.sum() == pytest.approx(1.0, abs=1e-13)


@pytest.mark.ci
def test_too_few_nodes_are_noticed():
    # the first rule alone is wrong by 1e-4 here, and its density still integrates to 1
    q = np.array([0.05, 0.03, -0.02, 0.998])
    r1, r2 = normalize(np.array([[1.0, 0.2, 0.1], [-0.2, 1.0, 0.4]]))
    g = two_vector_geometry(q, r1, r2, "plain")
    noise = noise_covariances([0.003, 0.03, 0.003, 0.03])
    coarse = moments_by_rule(g, noise, ("d2", 64, 32))
    found = exact.exact_moments(g, noise)
    fine = moments_by_rule(g, noise, ("d1", 32, 1200))
    # the weights alone are exact on any panel
    assert coarse[2] == pytest.approx(1.0, abs=100 * EPS)
    assert np.linalg.norm(coarse[1] - fine[1]) > 1e-6 * np.linalg.norm(fine[1])
    assert np.linalg.norm(found[1] - fine[1]) < 1e-10 * np.linalg.norm(fine[1])


def test_rules_agree_relative_to_what_they_find():
    bias = np.array([1e-4, 0.0, 0.0, 0.0])
    # 0.01 of one or of the other of the two, 1 % apart
    assert exact._relative(1.01 * bias, bias) == pytest.approx(0.01, rel=0.02)
    # below 1e-6 a bias of rounded quaternions has no such digits to give
    assert exact._relative(1e-15 + 0.0 * bias, 0.0 * bias) < 3e-9


@pytest.mark.parametrize("std", [0.0, [0.0, 0.1, 0.0, 0.1], [0.1, 0.0, 0.1, 0.0]])
def test_some_or_no_noise(std):
    q, r1, r2 = np.array([0.5, -0.4, 0.6, 0.45]), np.eye(3)[0], np.eye(3)[1]
    found = attitude_moments(q, r1, r2, std, "exact")
    fourth = attitude_moments(q, r1, r2, std, 4)
    if std == 0.0:
        # no noise, so nothing but the rounding of a normalisation
        assert np.abs(found.bias).max() < 4 * EPS
        assert np.abs(found.covariance).max() < 4 * EPS
    else:
        # complete fourth order: (sigma/|qbar|)^4 = 1.6e-3 with a constant below 30
        limit = 0.05 * np.linalg.norm(found.covariance)
        assert np.linalg.norm(found.covariance - fourth.covariance) < limit


@pytest.mark.ci
@pytest.mark.parametrize(
    "std", [[0.3, 0.3, 0.3, 0.3], [0.02, 0.1, 0.2, 0.05], [0.2, 0.01, 0.1, 0.02]]
)
def test_against_monte_carlo(std):
    rng = np.random.default_rng(6)
    q = normalize(np.array([0.3, 0.5, -0.6, 0.5]))
    r1, r2 = normalize(np.array([[1.0, 0.2, -0.1], [0.1, 0.9, 0.5]]))
    A = attitude_matrix(q)
    count = 300_000
    truth = np.concatenate([A @ r1, A @ r2, r1, r2])[:, None]
    noise = np.repeat(std, 3)[:, None] * rng.standard_normal((12, count))
    predicted = attitude_moments(q, r1, r2, std, "exact")
    estimate = normalize_columns(raw_quaternion(truth + noise, predicted.frame))
    error = predicted.q_true[:, None] - estimate
    deviation = error - error.mean(axis=1, keepdims=True)
    products = deviation[:, None] * deviation
    z = (error.mean(axis=1) - predicted.bias) / (error.std(axis=1) / np.sqrt(count))
    zz = products.mean(axis=2) - predicted.covariance
    zz = zz / (products.std(axis=2) / np.sqrt(count))
    limit = 5.0  # 6e-7 two-sided, 14 comparisons, 3 cases: one alarm in 4e4 seeds
    assert np.abs(z).max() < limit
    assert np.abs(zz).max() < limit
    # power: the oracle at 2 % more noise is rejected
    other = attitude_moments(q, r1, r2, 1.02 * np.array(std), "exact")
    zz = products.mean(axis=2) - other.covariance
    assert np.abs(zz / (products.std(axis=2) / np.sqrt(count))).max() > limit
