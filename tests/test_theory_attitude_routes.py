"""Independent routes to the moments: series, cubature through the public estimator.

`quaternion` below is eq. (8) of the source typed in plain arithmetic; the closed
forms of `simval.theory.expansion` share no step with it: they use the Legendre series
of the normalisation and Isserlis' theorem, the series and the cubature neither.
"""

from itertools import permutations

import numpy as np
import pytest
from random_attitudes import full_covariances, geometry, plain_column
from rounding import EPS, relative

from simval.attitude import two_vector_quaternion
from simval.geometry import random_quaternions
from simval.theory import attitude_moments
from simval.theory.cubature import cubature_moments
from simval.theory.expansion import quadratic_form
from simval.theory.series import series_moments
from simval.theory.two_vector import noise_covariances, tangent_covariances


def quaternion(b1, b2, r1, r2):
    s1, d1, d2 = (b1 + r1) / 2, (b1 - r1) / 2, (b2 - r2) / 2
    qbar = np.array([*np.cross(d1, d2), np.dot(s1, d2)])
    return qbar / np.sqrt(np.sum(qbar * qbar))


def test_the_second_order_term_is_a_symmetric_cubic():
    """So the order of its indices is free wherever it is contracted.

    The term of (O1) is the gradient of the cubic u r / 2 - u^3 / 2 of x.
    """
    q = random_quaternions(1, np.random.default_rng(2))[0]
    T = quadratic_form(q)
    for axes in permutations(range(3)):
        np.testing.assert_allclose(T.transpose(axes), T, rtol=0, atol=4 * EPS)
    x = np.array([0.3, -0.2, 0.5, 0.1])
    u, r = q @ x, x @ x
    expected = u * x + (r / 2 - 1.5 * u * u) * q
    # 64 products against ten, entries of one size
    np.testing.assert_allclose(T @ x @ x, expected, rtol=20 * EPS)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", ["isotropic", "unequal", "full", "tangent"])
def test_closed_forms_equal_the_series_to_rounding(seed, kind):
    q, vectors, rng = geometry(seed, plain_column)
    noise = {
        "isotropic": noise_covariances(0.03),
        "unequal": noise_covariances([0.01, 0.04, 0.02, 0.05]),
        "full": full_covariances(rng, 0.03),
        "tangent": tangent_covariances(vectors, 0.03),
    }[kind]
    # both sides are sums of some thousand rounded terms, amplified by 1/|qbar|^4
    # relative to a leading term that has 1/|qbar|^2: 1000 eps / 0.15^2
    tolerance = 1000 * EPS / 0.15**2
    for order in (2, 4):
        closed = attitude_moments(q, *vectors[2:], noise, order, "plain")
        series = series_moments(quaternion, vectors, noise, order)
        assert relative(closed.bias, series.bias) < tolerance
        assert relative(closed.covariance, series.covariance) < tolerance


def test_three_routes_agree_at_their_digits():
    q, vectors, _ = geometry(7, plain_column)
    sigma = 0.01
    exact = attitude_moments(q, *vectors[2:], sigma, "exact", "plain")
    cubature = cubature_moments(
        lambda *v: two_vector_quaternion(*v, "plain"),
        vectors,
        noise_covariances(sigma),
        exact.q_true,
    )
    fourth = attitude_moments(q, *vectors[2:], sigma, 4, "plain")
    # degree 9 leaves (sigma/|qbar|)^10 with a weight sum of 325; the covariance is of
    # order (sigma/|qbar|)^2, the bias too
    left = 325 * (sigma / exact.norm) ** 8
    assert left < 1e-7
    assert relative(cubature.bias, exact.bias) < left
    assert relative(cubature.covariance, exact.covariance) < left
    # complete fourth order: (sigma/|qbar|)^4 with a constant of some hundred
    assert (
        relative(fourth.covariance, exact.covariance) < 300 * (sigma / exact.norm) ** 4
    )


def slope_above(floor, sigmas, errors):
    kept = np.asarray(errors) > floor
    assert kept.sum() >= 2
    return np.polyfit(np.log(sigmas[kept]), np.log(np.asarray(errors)[kept]), 1)[0]


# Rounding of a cubature: each estimate is off by some eps / 2, and sqrt(sum w^2) is 8.7
# at degree 9 in 12 variables: 1e-15, which the printed differences of degrees 9 and 11
# confirm. A point counts when the error is 30 times that, so that it moves no slope
# by more than 0.03 / ln 2.
FLOOR = 30 * 1e-15
ORDERS = [(2, 4.0), ("4-paper", 4.0), (4, 6.0)]


@pytest.mark.ci
@pytest.mark.parametrize("kind", ["full", "tangent"])
def test_convergence_order_against_cubature(kind):
    sigmas = np.geomspace(0.005, 0.02, 5)
    for seed in range(5):
        q, vectors, rng = geometry(seed, plain_column)
        r1, r2 = vectors[2:]
        unit = (
            full_covariances(rng, 1.0)
            if kind == "full"
            else tangent_covariances(vectors, 1.0)
        )
        frame = attitude_moments(q, r1, r2, 1e-3).frame
        errors = {order: [] for order, _ in ORDERS}
        for sigma in sigmas:
            noise = sigma**2 * unit
            moments = {
                order: attitude_moments(q, r1, r2, noise, order) for order, _ in ORDERS
            }
            # the condition that the geometry was chosen by
            assert moments[2].norm >= 0.15
            truth = cubature_moments(
                lambda *v, frame=frame: two_vector_quaternion(*v, frame),
                vectors,
                noise,
                moments[2].q_true,
            )
            for order, m in moments.items():
                errors[order].append(
                    [
                        np.linalg.norm(m.bias - truth.bias),
                        np.linalg.norm(m.covariance - truth.covariance),
                    ]
                )
        for order, expected in ORDERS:
            for error in np.transpose(errors[order]):
                # the next term adds 2 c sigma^2 < 0.1 up to sigma = 0.02
                assert slope_above(FLOOR, sigmas, error) == pytest.approx(
                    expected, abs=0.1
                )
