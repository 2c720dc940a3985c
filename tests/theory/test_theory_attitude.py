"""Closed-form error theory: the oracle, series, cubature, and the source's formulas."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from oracles.attitude_errors import (
    half_errors,
    isotropic_unnormalized_covariance,
    mean_norm_ratio,
    multiplicative_bias,
    multiplicative_covariance,
    multiplicative_error,
    norm_ratio,
    norm_ratio_second_order,
    normalized_error,
    normalized_error_second_order,
    unnormalized_error,
)
from random_attitudes import full_covariances, geometry, plain_column
from rounding import EPS, relative

from simval.attitude import two_vector_quaternion
from simval.attitude.kernel import raw_quaternion
from simval.errors import SimvalError
from simval.geometry import (
    compose,
    conjugate,
    normalize,
    random_quaternions,
)
from simval.theory import attitude_moments
from simval.theory.attitude import multiplicative_moments
from simval.theory.cubature import cubature_moments, smolyak_hermite
from simval.theory.expansion import (
    column_matrix,
    quadratic_form,
    scaled_error_moments,
    second_order_bias,
    second_order_covariance,
)
from simval.theory.series import series_moments
from simval.theory.two_vector import (
    noise_covariances,
    tangent_covariances,
    two_vector_geometry,
)


def table_geometry():
    """The set-up of the documented table: default_rng(3), q, then r1, then r2."""
    rng = np.random.default_rng(3)
    q, r1, r2 = (normalize(rng.standard_normal(n)) for n in (4, 3, 3))
    return q, r1, r2


def slope(sigmas, errors):
    return np.polyfit(np.log(sigmas), np.log(errors), 1)[0]


# sigma, second order, eq. (63) as printed, the source's fourth, complete fourth
TABLE = [
    (0.0125, 6.16e-4, 4.14e-4, 1.15e-3, 1.5e-6),
    (0.025, 2.48e-3, 1.67e-3, 4.61e-3, 2.4e-5),
    (0.05, 1.03e-2, 6.8e-3, 1.87e-2, 4.2e-4),
]


@pytest.mark.parametrize("row", TABLE)
def test_relative_errors_of_the_covariance_table(row):
    sigma, second, eq63, paper, complete = row
    q, r1, r2 = table_geometry()
    exact = attitude_moments(q, r1, r2, sigma, "exact", "plain")
    m2 = attitude_moments(q, r1, r2, sigma, 2, "plain")
    found = [
        relative(m2.covariance, exact.covariance),
        relative(m2.second_moment, exact.covariance),
        relative(
            attitude_moments(q, r1, r2, sigma, "4-paper", "plain").covariance,
            exact.covariance,
        ),
        relative(
            attitude_moments(q, r1, r2, sigma, 4, "plain").covariance, exact.covariance
        ),
    ]
    # the table prints three digits (half a unit of the last: 0.5 %), two for the
    # complete fourth, whose last row also came from a fit (2.5 %)
    np.testing.assert_allclose(found, [second, eq63, paper, complete], rtol=0.03)
    np.testing.assert_allclose(found[:1] + found[2:3], [second, paper], rtol=6e-3)


@pytest.mark.parametrize(
    ("order", "bias_slope", "covariance_slope"),
    [(2, 4.0, 4.0), ("4-paper", 4.0, 4.0), (4, 6.0, 6.0)],
)
def test_order_of_the_error_against_the_exact_oracle(
    order, bias_slope, covariance_slope
):
    # Six attitudes with |qbar| >= 0.15. Below 0.005 rounding (1e-16 of moments of
    # order sigma^6 = 1e-14) shows in the bias; above 0.02 the next term, which adds
    # 2 c sigma^2 to a slope, does.
    rng = np.random.default_rng(11)
    sigmas = np.geomspace(0.005, 0.02, 4)
    for q in random_quaternions(6, rng):
        r1, r2 = normalize(rng.standard_normal((2, 3)))
        if np.linalg.norm(np.cross(r1, r2)) < 0.3:
            r2 = normalize(np.cross(r1, r2))
        bias, covariance = [], []
        for sigma in sigmas:
            exact = attitude_moments(q, r1, r2, sigma, "exact")
            found = attitude_moments(q, r1, r2, sigma, order)
            # the condition that the geometries above were chosen by
            assert found.norm >= 0.15
            bias.append(np.linalg.norm(found.bias - exact.bias))
            covariance.append(np.linalg.norm(found.covariance - exact.covariance))
        # the next term bends a slope by 0.02 at the most (measured), an order is 1 away
        assert slope(sigmas, bias) == pytest.approx(bias_slope, abs=0.1)
        assert slope(sigmas, covariance) == pytest.approx(covariance_slope, abs=0.1)


@pytest.mark.parametrize("frame", ["x", "y", "z", "plain"])
def test_frames_agree_with_the_oracle(frame):
    # the relative error of the complete fourth order scales as (sigma/|qbar|)^4;
    # 300 bounds its constant over these frames (it is 100 to 250)
    q, r1, r2 = table_geometry()
    norm = attitude_moments(q, r1, r2, 1e-4, 2, frame).norm
    sigma = 0.01 * norm
    exact = attitude_moments(q, r1, r2, sigma, "exact", frame)
    found = attitude_moments(q, r1, r2, sigma, 4, frame)
    # what the fourth order leaves out: c sigma^4 with c of 300, (1/|qbar|)^4 and a
    # factor
    assert relative(found.covariance, exact.covariance) < 300 * 0.01**4
    assert relative(found.bias, exact.bias) < 300 * 0.01**4
    # two unit quaternions
    assert abs(exact.q_true @ q) == pytest.approx(1.0, abs=8 * EPS)


magnitudes = st.sampled_from([0.0, 5e-324, 1e-200, 1e-141, 1e-139, 1e-20, 1e-8, 1e-3])
noises = st.one_of(magnitudes, st.floats(0.0, 2e6))


@given(
    std=st.tuples(noises, noises, noises, noises),
    order=st.sampled_from([2, "4-paper", 4, "exact"]),
    seed=st.integers(0, 50),
)
@example(std=(1e-200,) * 4, order="exact", seed=0)
@example(std=(1e6,) * 4, order=4, seed=0)
def test_an_answer_is_finite_or_refused(std, order, seed):
    rng = np.random.default_rng(seed)
    q = random_quaternions(1, rng)[0]
    r1, r2 = normalize(rng.standard_normal((2, 3)))
    try:
        found = attitude_moments(q, r1, r2, std, order)
    except SimvalError:
        return
    assert np.isfinite(found.bias).all()
    assert np.isfinite(found.covariance).all()
    if order in (2, "4-paper", "exact"):  # the complete fourth order is not a square
        lowest = np.linalg.eigvalsh(found.covariance)[0]
        assert lowest >= -1e-9 * np.trace(found.covariance) - 1e-30


def of_the_sign_of_q(q, normal):
    """Whether the plain formula gives q and not -q."""
    return q[:3] @ normal > 0.2


def scaled_errors(vectors, noise):
    """x for noise (n, 4, 3) through source eqs. (39) to (41) and (35)."""
    b1, b2, r1, r2 = vectors
    true = ((b1 - r1) / 2, (b1 + r1) / 2, (b2 - r2) / 2)
    errors = unnormalized_error(true, half_errors(*np.moveaxis(noise, 1, 0)))
    norm = np.linalg.norm(raw_quaternion(vectors.reshape(12, 1), "plain"))
    return errors, errors / norm, norm


def test_exact_formulas_against_the_estimator():
    q, vectors, rng = geometry(1, of_the_sign_of_q)
    noise = 0.3 * rng.standard_normal((500, 4, 3))
    error, scaled, norm = scaled_errors(vectors, noise)
    measured = raw_quaternion((vectors + noise).reshape(500, 12).T, "plain").T
    np.testing.assert_allclose(
        error, norm * q - measured, rtol=0, atol=50 * EPS
    )  # (39)
    length = np.linalg.norm(measured, axis=1)
    nu = norm_ratio(q, scaled)
    # nu comes out of a difference that is small where |qbar| is: eps nu^3
    assert np.all(np.abs(nu - norm / length) < 50 * EPS * nu**3)  # (42), (43)
    estimate = measured / length[:, None]
    gap = np.abs(normalized_error(q, scaled) - (q - estimate)).max(axis=1)
    assert np.all(gap < 100 * EPS * nu**3)  # (44)
    product = compose(conjugate(q), estimate)
    np.testing.assert_allclose(
        multiplicative_error(q, q - estimate), product, rtol=0, atol=20 * EPS
    )  # (45) to (47)


def test_expansions_are_of_second_order():
    q, vectors, rng = geometry(2, of_the_sign_of_q)
    direction = rng.standard_normal((100, 4, 3))
    sizes = np.array([1e-4, 1e-3])
    gaps = []
    for size in sizes:
        _, x, _ = scaled_errors(vectors, size * direction)
        gaps.append(
            [
                np.linalg.norm(norm_ratio(q, x) - norm_ratio_second_order(q, x)),
                np.linalg.norm(
                    normalized_error(q, x) - normalized_error_second_order(q, x)
                ),
            ]
        )
    slopes = np.diff(np.log10(gaps), axis=0)[0]
    # third order is the first left out; at 1e-4 rounding (1e-16 / 1e-12) is 1e-4
    np.testing.assert_allclose(slopes, 3.0, rtol=0, atol=0.05)  # (48), (49), (50)


def test_moments_of_the_unnormalised_error_are_exact_for_any_noise():
    # |qbar| has polynomial moments of degree 4: the rule of degree 5 is exact
    q, vectors, rng = geometry(3, of_the_sign_of_q)
    noise = full_covariances(rng, 0.5)
    points, weights = smolyak_hermite(12, 5)
    roots = np.linalg.cholesky(noise)
    draws = np.einsum("kij,nkj->nki", roots, points.reshape(-1, 4, 3))
    error, _, norm = scaled_errors(vectors, draws)
    np.testing.assert_allclose(weights @ error, 0.0, rtol=0, atol=1e-13)  # unbiased
    g = two_vector_geometry(q, *vectors[2:], "plain")
    moments = scaled_error_moments(g, noise)
    first = norm**2 * moments.P  # eqs. (54) to (60)
    exact = (weights[:, None] * error).T @ error
    # the bilinear part adds its own covariance, of fourth order, and nothing else
    both = first + norm**2 * moments.V
    # a dozen products of numbers below 1
    np.testing.assert_allclose(exact, both, rtol=0, atol=40 * EPS)
    assert relative(first, exact) > 0.01


@pytest.mark.parametrize("frame", ["plain", "x", "y", "z"])
def test_isotropic_form_of_the_covariance(frame):
    q, vectors, _ = geometry(4, of_the_sign_of_q)
    g = two_vector_geometry(q, *vectors[2:], frame)
    general = g.norm**2 * scaled_error_moments(g, noise_covariances(0.2)).P
    np.testing.assert_allclose(
        # 0.04 times sums of a dozen products below 1
        isotropic_unnormalized_covariance(g, 0.2),
        general,
        rtol=0,
        atol=4 * EPS,
    )


def test_mean_of_the_norm_ratio_and_second_moment():
    # (51) and (63) against cubature: the error is of fourth order
    q, vectors, _ = geometry(5, of_the_sign_of_q)
    g = two_vector_geometry(q, *vectors[2:], "plain")
    points, weights = smolyak_hermite(12, 9)
    gaps = []
    for sigma in (0.005, 0.01):
        P = scaled_error_moments(g, noise_covariances(sigma)).P
        _, x, _ = scaled_errors(vectors, sigma * points.reshape(-1, 4, 3))
        e = normalized_error(q, x)
        moment = (weights[:, None] * e).T @ e
        bias = second_order_bias(q, P)  # (63) with (65): the last term is its square
        predicted = second_order_covariance(q, P) + np.outer(bias, bias)
        gaps.append(
            [
                abs(weights @ (norm_ratio(q, x) - 1.0) + 1.0 - mean_norm_ratio(q, P)),
                np.linalg.norm(moment - predicted),
            ]
        )
    # the next term adds c sigma^2 with c below 100, at sigma = 0.02 of the norm 4 %:
    # log2 of that is 0.06
    np.testing.assert_allclose(np.diff(np.log2(gaps), axis=0)[0], 4.0, rtol=0, atol=0.1)


def test_multiplicative_moments():
    # (53) and (64): against cubature of q^-1 * qhat itself
    q, vectors, rng = geometry(6, of_the_sign_of_q)
    noise = full_covariances(rng, 0.005)

    def estimator(*v):
        block = np.concatenate([x.T for x in v])
        raw = raw_quaternion(block, "plain").T
        return compose(conjugate(q), raw / np.linalg.norm(raw, axis=1, keepdims=True))

    truth = np.array([0.0, 0.0, 0.0, 1.0])
    found = cubature_moments(estimator, vectors, noise, truth)  # truth minus estimate
    predicted = attitude_moments(q, *vectors[2:], noise, 4, "plain")
    multiplicative = multiplicative_moments(predicted)
    # left out: (sigma/|qbar|)^4 relative, with a constant of some hundred
    limit = 300 * (0.005 / predicted.norm) ** 4
    assert relative(multiplicative.bias, -found.bias) < limit
    assert relative(multiplicative.covariance, found.covariance) < limit
    np.testing.assert_allclose(
        multiplicative_bias(q, predicted.bias),
        truth + multiplicative.bias,
        rtol=0,
        atol=EPS,
    )
    np.testing.assert_allclose(
        multiplicative_covariance(q, predicted.covariance),
        multiplicative.covariance,
        rtol=0,
        atol=EPS,
    )


@pytest.mark.parametrize("sigma", [1e-8, 1e-12, 1e-3])
def test_a_small_multiplicative_bias_keeps_its_digits(sigma):
    # -q^-1 * (bias): the length is that of the additive one to rounding, whatever its
    # size; subtracting the identity from (53) was 10 % off at 1e-8
    q, vectors, _ = geometry(6, of_the_sign_of_q)
    additive = attitude_moments(q, *vectors[2:], sigma, 2, "plain")
    found = multiplicative_moments(additive).bias
    expected = -compose(conjugate(additive.q_true), additive.bias)
    np.testing.assert_allclose(found, expected, rtol=0, atol=8 * EPS * sigma**2 * 100)
    assert np.linalg.norm(found) == pytest.approx(
        np.linalg.norm(additive.bias), rel=16 * EPS
    )


def unit(v):
    return v / np.sqrt(np.sum(v * v))


def normalized_plain(b1, b2, r1, r2):
    b1, b2, r1, r2 = unit(b1), unit(b2), unit(r1), unit(r2)
    s1, d1, d2 = (b1 + r1) / 2, (b1 - r1) / 2, (b2 - r2) / 2
    return unit(np.array([*np.cross(d1, d2), np.dot(s1, d2)]))


@pytest.mark.parametrize("kind", ["isotropic", "full"])
@pytest.mark.parametrize("seed", range(3))
def test_vectors_normalised_after_the_noise(kind, seed):
    q, vectors, rng = geometry(seed, of_the_sign_of_q)
    noise = (
        noise_covariances([0.02, 0.01, 0.03, 0.02])
        if kind == "isotropic"
        else full_covariances(rng, 0.02)
    )
    series = series_moments(normalized_plain, vectors, noise, order=2)
    predicted = attitude_moments(q, *vectors[2:], noise, 2, "plain", normalized=True)
    tolerance = 1000 * EPS / 0.2**2  # as for the other closed forms
    assert relative(predicted.bias, series.bias) < tolerance
    assert relative(predicted.covariance, series.covariance) < tolerance
    # power: without the shortened mean the bias is visibly another one
    raw = attitude_moments(q, *vectors[2:], noise, 2, "plain")
    assert relative(raw.bias, series.bias) > 0.01


@pytest.mark.parametrize("frame", ["x", "y", "z", "plain", "combined"])
def test_normalised_vectors_in_every_frame(frame):
    # through the estimator as a black box: the error is of fourth order
    q, vectors, rng = geometry(1, of_the_sign_of_q)
    unit_noise = full_covariances(rng, 1.0)
    norm = attitude_moments(q, *vectors[2:], 1e-4, 2, frame).norm
    gaps = []
    for sigma in (0.01 * norm, 0.02 * norm):
        predicted = attitude_moments(
            q, *vectors[2:], sigma**2 * unit_noise, 2, frame, normalized=True
        )
        truth = predicted.q_true

        def estimator(*v, truth=truth):
            v = [x / np.linalg.norm(x, axis=1, keepdims=True) for x in v]
            if frame == "combined":
                M = column_matrix(*v)
                raw = np.linalg.svd(M)[0][:, :, 0]
                raw *= np.sign(raw @ truth)[:, None]
                return raw
            raw = raw_quaternion(np.concatenate([x.T for x in v]), frame).T
            return raw / np.linalg.norm(raw, axis=1, keepdims=True)

        found = cubature_moments(
            estimator, vectors, sigma**2 * unit_noise, truth, degree=7
        )
        gaps.append(
            [
                np.linalg.norm(found.bias - predicted.bias),
                np.linalg.norm(found.covariance - predicted.covariance),
            ]
        )
    # as above: the next term at 0.02 of the norm
    np.testing.assert_allclose(np.diff(np.log2(gaps), axis=0)[0], 4.0, rtol=0, atol=0.1)


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
