"""Exact moments: elementary functions, quadratures, flips, Monte Carlo."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from rounding import EPS
from scipy import integrate, special

from simval.attitude import two_vector_quaternion
from simval.attitude.kernel import normalize_columns, raw_quaternion
from simval.errors import InputError, RefusedError
from simval.geometry import attitude_matrix, normalize, random_quaternions
from simval.studies import attitude_order
from simval.studies.attitude import random_geometry
from simval.theory import attitude_moments, cubature_moments, exact
from simval.theory.cubature import covariance_roots
from simval.theory.exact import (
    about_d2,
    exact_moments,
    exact_moments_any,
    flip_probability,
    one_minus_a,
    one_minus_b,
)
from simval.theory.expansion import half_noise
from simval.theory.two_vector import (
    column_norms,
    noise_covariances,
    tangent_covariances,
    true_vectors,
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


def full(seed, size):
    factor = np.random.default_rng(seed).standard_normal((4, 3, 3))
    covariance = factor @ factor.swapaxes(1, 2)
    return size**2 * covariance / np.linalg.eigvalsh(covariance)[:, -1, None, None]


def tangent(number, size):
    return tangent_covariances(true_vectors(*random_geometry(number))[1], size)


def relative(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


@pytest.mark.ci
@pytest.mark.parametrize("size", [1e-3, 0.03, 0.3])
def test_isotropic_noise_agrees_with_the_closed_form(size):
    # the integral over s and the directions are other ones; a bias of size^2 is formed
    # from numbers rounded to 1e-16 each
    noise = noise_covariances(size * np.array([1.0, 0.5, 0.3, 0.8]))
    for number in (1, 3):
        geometry = two_vector_geometry(*random_geometry(number))
        known = exact_moments(geometry, noise)
        found = exact_moments_any(geometry, noise)
        assert relative(found[1], known[1]) < 1e-10
        assert relative(found[0], known[0]) < 1e-10 + 1e-15 / np.linalg.norm(known[0])


@pytest.mark.ci
@pytest.mark.parametrize("kind", [full, tangent])
def test_cubature_agrees_where_it_can(kind):
    # degree 9 leaves out sigma^10 of a covariance of sigma^2: (sigma/|qbar|)^8 with a
    # constant of some thousand, 4e-11 here at the most; rounding is 1e-15 / sigma^2
    q, r1, r2 = random_geometry(3)
    noise = kind(3, 0.01)
    exact = attitude_moments(q, r1, r2, noise, "exact")
    cubature = cubature_moments(
        partial(two_vector_quaternion, frame=exact.frame),
        true_vectors(q, r1, r2)[1],
        noise,
        exact.q_true,
    )
    assert relative(cubature.covariance, exact.covariance) < 1e-9
    assert relative(cubature.bias, exact.bias) < 1e-9
    # power: with 2 % more noise on one vector it would not be
    noise[1] *= 1.02
    other = attitude_moments(q, r1, r2, noise, "exact")
    assert relative(other.covariance, exact.covariance) > 1e-4


def test_the_step_in_log_s_is_converged(monkeypatch):
    geometry = two_vector_geometry(*random_geometry(3))
    found = exact_moments_any(geometry, full(3, 0.03))
    monkeypatch.setattr(exact, "_STEP", 0.06)
    fine = exact_moments_any(geometry, full(3, 0.03))
    assert relative(found[0], fine[0]) < 1e-11
    assert relative(found[1], fine[1]) < 1e-11


def test_the_difference_of_two_rules_bounds_the_error():
    geometry = two_vector_geometry(*random_geometry(7))
    C1, C2 = half_noise(geometry, full(7, 0.15))
    rules = exact._rules_any(geometry.d2, C2)
    found = [
        exact._moments_any(geometry, C1, u, w / w.sum())[1]
        for u, w in (next(rules) for _ in range(5))
    ]
    gaps = [relative(a, b) for a, b in pairwise(found)]
    left = [relative(a, found[-1]) for a in found[1:-1]]
    # the finer of two is nearer than they are to each other
    assert all(off <= gap for off, gap in zip(left, gaps, strict=False))
    assert gaps[-1] < 1e-3 * gaps[0]


def test_a_flat_noise_of_the_second_vector():
    # b2 = -r2 and noise tangent to both: none along d2, which cannot be whitened
    q, r1, r2 = [1.0, 0.0, 0.0, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]
    vectors = true_vectors(q, r1, r2)[1]
    noise = tangent_covariances(vectors, 0.02)
    geometry = two_vector_geometry(q, r1, r2, "plain")
    variances = np.linalg.eigvalsh(half_noise(geometry, noise)[1])
    assert variances[0] < 1e-20
    exact = attitude_moments(q, r1, r2, noise, "exact", "plain")
    cubature = cubature_moments(
        partial(two_vector_quaternion, frame="plain"), vectors, noise, exact.q_true
    )
    assert relative(cubature.covariance, exact.covariance) < 1e-7


@pytest.mark.parametrize("rank", [1, 2, 3])
@pytest.mark.parametrize("noisy", [(), (0,), (1,), (3,)])
def test_noise_on_some_vectors_only(noisy, rank):
    q, r1, r2 = random_geometry(3)
    noise = np.zeros((4, 3, 3))
    factor = np.random.default_rng(5).standard_normal((3, rank))
    noise[list(noisy)] = 1e-7 * factor @ factor.T
    exact = attitude_moments(q, r1, r2, noise, "exact")
    fourth = attitude_moments(q, r1, r2, noise, 4)
    # complete fourth order: (sigma/|qbar|)^4 = 4e-11, a constant of 300
    assert np.allclose(exact.covariance, fourth.covariance, rtol=0, atol=1e-14)
    assert np.allclose(exact.bias, fourth.bias, rtol=0, atol=1e-14)


def test_what_is_not_resolved_is_refused(monkeypatch):
    monkeypatch.setattr(exact, "_NODES", (6, 8))
    with pytest.raises(RefusedError, match=r"needed 1e-09.*use another frame"):
        attitude_moments(*random_geometry(2), full(2, 0.1), "exact", "plain")
    with pytest.raises(InputError, match="order='exact'"):
        exact_moments(two_vector_geometry(*random_geometry(2)), full(2, 0.1))


def simulated(q, r1, r2, noise, frame, count, seed):
    vectors = true_vectors(q, r1, r2)[1]
    rng = np.random.default_rng(seed)
    sums, squares = np.zeros(20), np.zeros(20)
    roots = covariance_roots(noise)
    geometry = two_vector_geometry(q, r1, r2, frame)
    upper = np.triu_indices(4)
    for _ in range(count // 100_000):
        noisy = vectors[:, None] + rng.standard_normal((4, 100_000, 3)) @ roots
        raw = raw_quaternion(noisy.swapaxes(1, 2).reshape(12, -1), geometry.frame)
        flipped = geometry.q_true @ raw < 0
        error = geometry.q_true[:, None] - normalize_columns(raw)
        values = np.vstack([error, error[upper[0]] * error[upper[1]]])
        values = np.vstack([values, flipped[None], np.ones((5, flipped.size))])
        sums += values.sum(axis=1)
        squares += (values**2).sum(axis=1)
    mean = sums / count
    return mean, np.sqrt(np.maximum(squares / count - mean**2, 0.0) / count)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "number", "size", "frame"),
    [(full, 1, 0.2, None), (full, 2, 0.07, "plain"), (tangent, 2, 0.05, "plain"),
     (tangent, 5, 0.15, None)],
)  # fmt: skip
def test_nasty_cases_against_monte_carlo(kind, number, size, frame):
    # |qbar| of 0.06 under a noise of 0.07 among them; 15 z-scores in four cases, one
    # false alarm in 1e5
    q, r1, r2 = random_geometry(number)
    noise = kind(number, size)
    found = attitude_moments(q, r1, r2, noise, "exact", frame)
    chance = flip_probability(two_vector_geometry(q, r1, r2, frame), noise)
    expected = np.concatenate(
        [found.bias, found.second_moment[np.triu_indices(4)], [chance]]
    )
    mean, error = simulated(q, r1, r2, noise, frame, 4_000_000, 9)
    assert np.abs((mean[:15] - expected) / error[:15]).max() < 5.0
    second = attitude_moments(q, r1, r2, noise, 2, frame)
    off = (mean[:4] - second.bias) / error[:4]
    assert np.abs(off).max() > 10.0  # power


@pytest.mark.parametrize("number", [1, 34])
def test_flips_by_an_average_over_directions(number):
    # given u the chance is a normal integral; a rule of 600 azimuths is good to 1e-7,
    # where the one that this contour integral replaced was wrong by 4e-4
    geometry = two_vector_geometry(*random_geometry(number))
    sizes = geometry.norm * np.random.default_rng(number).uniform(0.2, 1.0, 4)
    noise = noise_covariances(sizes)
    tau1, tau2 = exact._isotropic_halves(noise)
    u, weights = about_d2(geometry.d2, tau2, (1200, 600))
    e, s = geometry.q[:3], geometry.q[3]
    along = np.cross(geometry.d1, u) @ e + s * (u @ geometry.s1)
    spread = tau1 * np.sqrt(np.maximum(1.0 - (u @ e) ** 2, 0.0))
    given = special.ndtr(-along / spread)
    chance = flip_probability(geometry, noise)
    assert chance == pytest.approx(float(weights @ given), rel=1e-6)


@pytest.mark.parametrize("ratio", [0.3, 3.0, 30.0])
def test_near_singular_geometries_have_a_chance_too(ratio):
    # one in twelve of these was refused
    rng = np.random.default_rng(4)
    for _ in range(40):
        q, r1, r2 = rng.standard_normal((3, 4))
        n = np.cross(r1[:3], r2[:3])
        q[:3] -= n * (n @ q[:3]) / (n @ n)
        q[:3] += 0.02 * n / np.linalg.norm(n)
        geometry = two_vector_geometry(q, r1[:3], r2[:3], "plain")
        noise = noise_covariances(geometry.norm / ratio * rng.uniform(0.1, 1.0, 4))
        assert 0.0 <= flip_probability(geometry, noise) < 0.5


def test_a_flip_with_noise_on_one_vector_is_a_normal_tail():
    geometry = two_vector_geometry(*random_geometry(3))
    for noisy in ([0.2, 0, 0.1, 0], [0, 0.2, 0, 0.3]):
        noise = noise_covariances(noisy)
        chance = flip_probability(geometry, noise)
        noise = noise + noise_covariances(1e-9)
        assert flip_probability(geometry, noise) == pytest.approx(chance, rel=1e-6)


@pytest.mark.parametrize("noise", ["full", "tangent"])
@pytest.mark.parametrize("number", [1, 3, 5])
def test_the_truth_of_the_study_of_orders_is_true(number, noise):
    # it is cubature, there; a hundredth of the least that a formula leaves out bends a
    # slope over a factor of 4 in the noise by 0.01 / ln 4 = 0.007, of 0.1 allowed
    q, r1, r2 = random_geometry(number)
    parameters = attitude_order.Parameters(geometry=number, noise=noise)
    covariances = attitude_order.LEVELS[-1] ** 2 * attitude_order._shape(
        parameters, q, r1, r2
    )
    exact, second, fourth = (
        attitude_moments(q, r1, r2, covariances, order) for order in ("exact", 2, 4)
    )
    cubature = attitude_order._truth(noise, q, r1, r2, covariances, second)
    for part in ("bias", "covariance"):
        known = getattr(exact, part)
        left = np.linalg.norm(getattr(fourth, part) - known)
        assert np.linalg.norm(getattr(cubature, part) - known) < 0.01 * left
