"""Exact moments: elementary functions, quadratures, flips, Monte Carlo."""

import re
from functools import partial

import numpy as np
import pytest
from places import ROOT
from rounding import EPS, relative
from scipy import integrate, special

from simval.errors import RefusedError
from simval.geometry import normalize, random_quaternions
from simval.imu.attitude import two_vector_quaternion
from simval.imu.attitude.kernel import normalize_columns, raw_quaternion
from simval.studies.attitude import random_geometry
from simval.studies.attitude_geometries import regular_geometries
from simval.theory import attitude_moments, cubature_moments, exact
from simval.theory.cubature import covariance_roots
from simval.theory.exact import (
    about_d2,
    exact_moments,
    exact_moments_any,
    one_minus_a,
    one_minus_b,
)
from simval.theory.expansion import half_noise
from simval.theory.sign_flips import flip_probability
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


def problems():
    """Geometries, some nearly singular, four noises each, whether by any rule."""
    rng = np.random.default_rng(1)
    for k in range(4):
        q = random_quaternions(1, rng)[0]
        r1, r2 = normalize(rng.standard_normal((2, 3)))
        if abs(column_norms(q, r1, r2)[k % 4]) > 0.02:
            g = two_vector_geometry(q, r1, r2, ["x", "y", "z", "plain"][k % 4])
            # the general rule is slow where the noise is great
            for s in (0.03, 0.3):
                yield g, s * rng.uniform(0.1, 1.0, 4), g.norm > 0.2 and s < 0.1 * k
    # the first rule alone is wrong by 1e-4 here, and its density integrates to 1
    r1, r2 = normalize(np.array([[1.0, 0.2, 0.1], [-0.2, 1.0, 0.4]]))
    g = two_vector_geometry([0.05, 0.03, -0.02, 0.998], r1, r2, "plain")
    yield g, [0.003, 0.03, 0.003, 0.03], False
    # and here two rules with as many azimuths agreed on 3e-7 too much
    g = two_vector_geometry(*random_geometry(98), "plain")
    yield g, [0.01, 0.1, 0.005, 0.18], False


@pytest.mark.ci
def test_quadratures_in_different_coordinates_agree():
    # about d2, on graded panels about d1 (they share the integrand alone), and the one
    # of any covariances, whose integral over s and the directions is another one
    for g, std, by_any in problems():
        noise = noise_covariances(std)
        tau1, tau2 = exact._halves(noise)
        u, weights = exact._about_d1(g.d1, g.d2, (tau1, tau2), (32, 1200))
        # weights of some 1e4 nodes
        assert weights.sum() == pytest.approx(1.0, abs=100 * EPS)
        others = [exact._moments_isotropic(g.q, exact._maps(g), tau1, u, weights)]
        others += [exact_moments_any(g, noise)] if by_any else []
        bias, covariance = exact_moments(g, noise)
        for other_bias, other in others:
            assert relative(covariance, other) < 1e-10
            # a bias of the noise's square is formed from numbers rounded to 1e-16 each
            assert relative(bias, other_bias) < 1e-9


@pytest.mark.parametrize("k", [0.3, 2.0, 3.5, 5.0, 8.0, 8.49, 8.51, 12.0, 100.0, 1e4])
def test_density_integrates_to_one(k):
    # the polar range may be cut only where the density has fallen below rounding
    d2 = np.array([0.1, -0.3, 0.2])
    _, weights = exact.about_d2(d2, np.linalg.norm(d2) / k, (96, 4))
    assert weights.sum() == pytest.approx(1.0, abs=1e-13)


def full(seed, size):
    factor = np.random.default_rng(seed).standard_normal((4, 3, 3))
    covariance = factor @ factor.swapaxes(1, 2)
    return size**2 * covariance / np.linalg.eigvalsh(covariance)[:, -1, None, None]


def tangent(number, size):
    return tangent_covariances(true_vectors(*random_geometry(number))[1], size)


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
@pytest.mark.parametrize("noisy", [(), (0,), (1,), (3,), (1, 3), (0, 2)])
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


@pytest.mark.ci
def test_near_a_singularity_any_covariance_is_answered():
    # |qbar| is 1.9 sigma: rules about the direction of d2 alone, up to 108 azimuths,
    # still changed by 8e-9. Twice as many nodes about d1, in other axes, agree.
    noise, geometry = full(8, 0.1), two_vector_geometry(*random_geometry(8), "plain")
    assert geometry.norm == pytest.approx(0.121, abs=1e-3)
    bias, covariance = exact_moments_any(geometry, noise)
    C1, C2, _ = half_noise(geometry, noise)
    u, weights = sphere_rule(geometry.d1, geometry.d2, C2)
    finer = exact._moments_any(geometry, C1, None, u, weights)
    assert weights.sum() == pytest.approx(1.0, abs=1e-9)
    assert relative(bias, finer[0]) < 1e-9
    assert relative(covariance, finer[1]) < 1e-9


def sphere_rule(pole, centre, covariance):
    """Directions with the weights of their law N(centre, covariance), not whitened."""
    edges = np.concatenate([[0.0], np.geomspace(0.02, 0.5 * np.pi, 7)])
    edges = np.unique([*edges, *(np.pi - edges)])
    x, w = np.polynomial.legendre.leggauss(20)
    half = 0.5 * np.diff(edges)
    theta = (edges[:-1, None] + half[:, None] * (x + 1.0)).ravel()
    u, azimuth = exact._grid(pole / np.linalg.norm(pole), theta, 200)
    inverse = np.linalg.inv(covariance)
    a, t = np.einsum("ni,ij,nj->n", u, inverse, u), u @ inverse @ centre
    t = t / np.sqrt(a)
    tail = t * np.exp(-0.5 * t * t) + np.sqrt(2 * np.pi) * (1 + t * t) * special.ndtr(t)
    size = centre @ inverse @ centre
    density = np.exp(-0.5 * (size - t * t)) * a**-1.5 * tail
    density /= np.sqrt((2.0 * np.pi) ** 3 * np.linalg.det(covariance))
    polar = (half[:, None] * w).ravel() * np.sin(theta)
    weights = np.repeat(polar * azimuth, 200) * density
    return u[weights > 1e-16], weights[weights > 1e-16]


def test_what_is_not_resolved_is_refused(monkeypatch):
    monkeypatch.setattr(exact, "_NODES", (6, 8))
    monkeypatch.setattr(exact, "_WHITENED", ())
    with pytest.raises(RefusedError, match=r"needed 1e-09.*use another frame"):
        attitude_moments(*random_geometry(2), full(2, 0.1), "exact", "plain")


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


def unequal(number, size):
    return noise_covariances(size * np.array([1.0, 0.1, 0.5, 0.2]))


@pytest.mark.parametrize(
    ("kind", "number", "size", "frame", "count"),
    [
        pytest.param(unequal, 2, 0.2, None, 300_000, marks=pytest.mark.ci),
        *(
            pytest.param(*case, 4_000_000, marks=pytest.mark.slow)
            for case in ((full, 1, 0.2, None), (full, 2, 0.07, "plain"),
                         (tangent, 2, 0.05, "plain"), (tangent, 5, 0.15, None))
        ),
    ],
)  # fmt: skip
def test_nasty_cases_against_monte_carlo(kind, number, size, frame, count):
    # |qbar| of 0.06 under a noise of 0.07 among them; 15 z-scores in five cases, one
    # false alarm in 1e5
    q, r1, r2 = random_geometry(number)
    noise = kind(number, size)
    found = attitude_moments(q, r1, r2, noise, "exact", frame)
    chance = flip_probability(two_vector_geometry(q, r1, r2, frame), noise)
    expected = np.concatenate(
        [found.bias, found.second_moment[np.triu_indices(4)], [chance]]
    )
    mean, error = simulated(q, r1, r2, noise, frame, count, 9)
    assert np.abs((mean[:15] - expected) / error[:15]).max() < 5.0
    # power: the oracle at 2 % more noise
    other = attitude_moments(q, r1, r2, 1.02**2 * noise, "exact", frame)
    moved = other.second_moment[np.triu_indices(4)]
    assert np.abs((mean[4:14] - moved) / error[4:14]).max() > 5.0


def test_flips_by_an_average_over_directions():
    number = 34
    # given u the chance is a normal integral; a rule of 600 azimuths is good to 1e-7,
    # where the one that this contour integral replaced was wrong by 4e-4
    geometry = two_vector_geometry(*random_geometry(number))
    sizes = geometry.norm * np.random.default_rng(number).uniform(0.2, 1.0, 4)
    noise = noise_covariances(sizes)
    tau1, tau2 = exact._halves(noise)
    u, weights = about_d2(geometry.d2, tau2, (1200, 600))
    e, s = geometry.q[:3], geometry.q[3]
    along = np.cross(geometry.d1, u) @ e + s * (u @ geometry.s1)
    spread = tau1 * np.sqrt(np.maximum(1.0 - (u @ e) ** 2, 0.0))
    given = special.ndtr(-along / spread)
    chance = flip_probability(geometry, noise)
    assert chance == pytest.approx(float(weights @ given), rel=1e-6)


@pytest.mark.ci
def test_flips_of_the_page():
    """Median and range of nine in ten of the page's table, in its 150 geometries."""
    page = (ROOT / "docs/attitude.md").read_text()
    table = page[page.index("| the raw sign flips") :].splitlines()[2:5]
    said = [[float(x) for x in re.findall(r"[\d.]+(?:e-\d+)?", row)] for row in table]
    for column, (name, frame) in enumerate((("greatest", None), ("plain", "plain"))):
        truths = zip(*regular_geometries(name, 150)[1], strict=True)
        geometries = [two_vector_geometry(*truth, frame) for truth in truths]
        for ratio, *numbers in said:
            chances = [
                flip_probability(each, noise_covariances(each.norm / ratio))
                for each in geometries
            ]
            found = np.quantile(chances, [0.5, 0.05, 0.95])
            own = numbers[3 * column : 3 * column + 3]
            # of two digits, the half of the last one
            np.testing.assert_allclose(own, found, rtol=0.05)


def test_a_flip_with_noise_on_one_vector_is_a_normal_tail():
    geometry = two_vector_geometry(*random_geometry(3))
    for noisy in ([0.2, 0, 0.1, 0], [0, 0.2, 0, 0.3]):
        noise = noise_covariances(noisy)
        chance = flip_probability(geometry, noise)
        noise = noise + noise_covariances(1e-9)
        assert flip_probability(geometry, noise) == pytest.approx(chance, rel=1e-6)
