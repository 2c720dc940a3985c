"""Errors as the source defines them: exact relations, expansions, their moments."""

import numpy as np
import pytest
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
from random_attitudes import full_covariances, geometry
from rounding import EPS, relative

from simval.attitude.kernel import raw_quaternion
from simval.errors import InputError
from simval.geometry import (
    compose,
    conjugate,
)
from simval.theory import attitude_moments
from simval.theory.attitude import multiplicative_moments
from simval.theory.cubature import cubature_moments, smolyak_hermite
from simval.theory.expansion import (
    column_matrix,
    scaled_error_moments,
    second_order_bias,
    second_order_covariance,
)
from simval.theory.series import series_moments
from simval.theory.two_vector import noise_covariances, two_vector_geometry


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


def test_normalised_vectors_need_order_two():
    q, vectors, _ = geometry(1, of_the_sign_of_q)
    with pytest.raises(InputError, match="theory of order 2 only"):
        attitude_moments(q, *vectors[2:], 0.01, 4, normalized=True)
