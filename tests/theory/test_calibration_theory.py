"""Predicted bias, covariance and bound of a calibration, by routes of their own.

The estimator itself, differentiated numerically in the noise, gives the coefficients
that the theory derives by hand; Monte Carlo gives both with sampling error. The bound
has a test of its own, `test_bounds.py`.
"""

import numpy as np
import pytest
from rounding import EPS
from scipy import stats
from true_sensor import MODEL, G

from simval.errors import GeometryError
from simval.imu.calibrate import calibrate
from simval.imu.sensor import MODELS, AccelerometerModel, forms
from simval.poses import cube_faces, fibonacci_sphere, observability, random_directions
from simval.theory.calibration import EVEN, RESIDUALS, calibration_moments


@pytest.mark.parametrize("residual", RESIDUALS)
@pytest.mark.parametrize("form", MODELS)
def test_against_the_estimator_differentiated_in_its_noise(form, residual):
    """bias = sigma^2/2 sum of d2 theta/dn2, covariance = sigma^2 sum of its gradient
    squared; central differences at two steps, extrapolated, of the public estimator.
    The adjusted estimate also depends on sigma itself, which is added."""
    n, sigma = 15, 0.01
    directions = fibonacci_sphere(n)
    clean = MODEL.distort(G * directions, np.random.default_rng(0))
    options = {"model": form, "residual": residual, "noise_std": 0.0}
    truth = calibrate(clean, G, **options).parameters

    def differences(h):
        shifts = np.zeros((3 * n, n, 3))
        shifts.reshape(3 * n, 3 * n)[:] = h * np.eye(3 * n)
        ahead = calibrate(clean + shifts, G, **options)
        back = calibrate(clean - shifts, G, **options)
        assert ahead.converged.all()
        assert back.converged.all()
        laplacian = (ahead.parameters + back.parameters - 2 * truth).sum(0) / h**2
        return laplacian, (ahead.parameters - back.parameters) / (2 * h)

    # truncation h^4 of the extrapolation, rounding 1e-14 / h^2: both near 1e-9
    h = 3e-3 * G
    (curve1, slope1), (curve2, slope2) = differences(h), differences(2 * h)
    bias = sigma**2 / 2 * (4 * curve1 - curve2) / 3
    slope = (4 * slope1 - slope2) / 3
    if residual == "adjusted":
        options["noise_std"] = sigma
        bias += calibrate(clean, G, **options).parameters - truth
    predicted = calibration_moments(MODEL, directions, G, sigma, residual, form=form)
    covariance = sigma**2 * slope.T @ slope
    scale = np.sqrt(np.outer(*[np.diag(covariance)] * 2))
    np.testing.assert_allclose(
        # Richardson's remainder, (h/G)^4 = 8e-11, with a constant of some tens
        predicted.covariance / scale,
        covariance / scale,
        rtol=0,
        atol=1e-8,
    )
    # the adjusted moments have a sigma^4 term of their own: (sigma/g)^2 = 1e-6
    size = np.abs(bias).max() + 0.01 * sigma**2
    np.testing.assert_allclose(predicted.bias, bias, rtol=0, atol=2e-5 * size)


def test_efficiency():
    """At the bound with weights; close to it while the scales agree; lost when not."""
    directions = fibonacci_sphere(40)
    for residual in ("weighted", "sampson"):
        found = calibration_moments(MODEL, directions, G, 0.1, residual)
        # two inverses of one matrix: eps times its condition, 1e2, squared
        np.testing.assert_allclose(found.efficiency, 1.0, rtol=1e4 * EPS)
    close = 1 / calibration_moments(MODEL, directions, G, 0.1).efficiency
    # scales 5 % apart cost the squared residual 0.3 %, see theory.efficiency
    assert 1.0 < close.mean() < 1.005
    spread = AccelerometerModel(T=np.eye(3), K=[0.1, 1.0, 1.9], B=np.zeros(3))
    lost = 1 / calibration_moments(spread, directions, G, 0.1).efficiency
    # power: scales of 0.1 and 1.9 cost 2.3 times the variance
    assert lost.max() > 1.5
    # no unbiased fit is better than the bound, up to rounding
    assert np.all(lost > 1.0 - 1e4 * EPS)


def next_order(rng, pairs):
    """Share of (K3) and (K4) that one random calibration takes, with its error.

    The trials are worked twice, with the noise and with a twentieth of it: from the
    second come the terms of first and second order of the same draws (but for a 400th
    of the next), so what is left is the next order alone, at a small standard error.
    """
    count = int(np.exp(rng.uniform(np.log(12), np.log(200))))
    even = rng.random() < 0.5
    directions = fibonacci_sphere(count) if even else random_directions(count, rng)
    spread = rng.choice([0.05, 0.3, 0.9])
    scale = 1 + rng.uniform(-spread, spread, 3)
    angles, offset = rng.uniform(-0.1, 0.1, 3), rng.uniform(-1, 1, 3)
    sensor = AccelerometerModel.from_parameters(np.hstack([angles, scale, offset]))
    residual, form = rng.choice(RESIDUALS), rng.choice(MODELS)
    level = 0.01 / max(1.0, observability(directions).condition / EVEN) ** 2
    sigma = level * G / np.linalg.norm(sensor.matrix, axis=1).max()
    predicted = calibration_moments(sensor, directions, G, sigma, residual, form=form)
    truth = forms.from_gram(form, sensor.matrix.T @ sensor.matrix, sensor.B)
    clean = sensor.distort(G * directions, np.random.default_rng(0))
    noise = sigma * rng.standard_normal((pairs, count, 3))

    def halves(share):
        plus, minus = (
            calibrate(
                clean + sign * share * noise, G, form, residual=residual,
                noise_std=share * sigma, covariance=False,
            ).require_converged().parameters - truth
            for sign in (1, -1)
        )  # fmt: skip
        return (plus + minus) / 2, (plus - minus) / 2

    (even, odd), (small_even, small_odd) = halves(1.0), halves(0.05)
    linear = small_odd / 0.05
    bias = even - small_even / 0.05**2
    spread = 2 * linear * (odd - linear) + (odd - linear) ** 2
    spread = (spread + (even - even.mean(axis=0)) ** 2) / np.diag(predicted.covariance)
    shares = bias / predicted.bias_remainder, spread / predicted.variance_remainder
    mean = [np.abs(x.mean(axis=0)).max() for x in shares]
    return mean, [(x.std(axis=0) / np.sqrt(pairs)).max() for x in shares]


def covered(seed, draws, pairs):
    """Greatest share of (K3) and of (K4); none may be above one."""
    rng = np.random.default_rng(seed)
    found = np.array([next_order(rng, pairs) for _ in range(draws)])
    mean, error = found[:, 0], found[:, 1]
    # 18 comparisons a draw, one false alarm in 1e4 for all
    limit = stats.norm.isf(1e-4 / (18 * draws))
    assert np.all(mean <= 1 + limit * error)
    return (mean - limit * error).max(axis=0)


@pytest.mark.parametrize(
    ("seed", "draws", "pairs", "least"),
    [
        pytest.param(3, 6, 250, 0.1, marks=pytest.mark.ci),
        pytest.param(4, 100, 1000, 0.25, marks=pytest.mark.slow),
    ],
)
def test_what_the_next_order_may_be(seed, draws, pairs, least):
    # power: factors of (K3) and (K4) so much smaller would be rejected
    assert np.all(covered(seed, draws, pairs) > least)


@pytest.mark.ci
@pytest.mark.parametrize("residual", ["sampson", "weighted"])
def test_noise_that_turns_the_weights_over_is_allowed_for(residual):
    """Eq. (K5): along the axis of a scale of 0.01 the others' noise is the weight."""
    sensor = AccelerometerModel(T=np.eye(3), K=[0.01, 1.0, 1.99], B=np.zeros(3))
    directions, sigma, pairs = fibonacci_sphere(952), 0.08, 400
    rng = np.random.default_rng(0)
    clean = sensor.distort(G * directions, rng)
    noise = sigma * rng.standard_normal((pairs, 952, 3))
    readings = np.concatenate([clean + noise, clean - noise])
    fit = calibrate(readings, G, residual=residual, noise_std=sigma, covariance=False)
    errors = np.mean(np.split(fit.parameters - sensor.parameters, 2), axis=0)
    predicted = calibration_moments(sensor, directions, G, sigma, residual)
    off = np.abs(errors.mean(axis=0) - predicted.bias)[6]
    error = errors.std(axis=0)[6] / np.sqrt(pairs)
    # power: 6 standard errors beyond what the greatest scale alone would allow
    alone = calibration_moments(sensor, directions, G, sigma, "squared").bias_remainder
    assert off > alone[6] + 5 * error
    assert off < predicted.bias_remainder[6]
    assert predicted.variance_remainder > 1.0


def test_bias_grows_as_the_square_and_sd_as_sigma():
    small = calibration_moments(MODEL, fibonacci_sphere(20), G, 0.001)
    large = calibration_moments(MODEL, fibonacci_sphere(20), G, 0.1)
    # powers of the noise, nothing else: the cancelled entries of the bias lose two
    # digits
    np.testing.assert_allclose(large.bias, 1e4 * small.bias, rtol=400 * EPS)
    np.testing.assert_allclose(large.sd, 1e2 * small.sd, rtol=400 * EPS)


@pytest.mark.parametrize("counts", [6250.0, 1e9])
def test_raw_counts_are_only_a_unit(counts):
    raw = AccelerometerModel(T=MODEL.T, K=MODEL.K / counts, B=MODEL.B * counts)
    si = calibration_moments(MODEL, fibonacci_sphere(20), G, 0.01)
    found = calibration_moments(raw, fibonacci_sphere(20), G, 0.01 * counts)
    unit = np.array([1.0] * 3 + [1 / counts] * 3 + [counts] * 3)
    # the same with other units: rounding
    np.testing.assert_allclose(found.sd, si.sd * unit, rtol=400 * EPS)
    np.testing.assert_allclose(found.bias, si.bias * unit, rtol=1e-9, atol=1e-18)


def test_noise_for_each_pose():
    """Twice the noise in one pose is a quarter of its information."""
    directions = fibonacci_sphere(12)
    sigma = np.full(12, 0.1)
    sigma[3] = 0.2
    found = calibration_moments(MODEL, directions, G, sigma, "weighted")
    even = calibration_moments(MODEL, directions, G, 0.1, "weighted")
    assert np.all(np.diag(found.cramer_rao) > np.diag(even.cramer_rao))
    # weighted knows the noise of each pose, squared does not
    np.testing.assert_allclose(found.efficiency, 1.0, rtol=1e-9)
    plain = calibration_moments(MODEL, directions, G, sigma, "squared")
    assert np.all(plain.efficiency < 1.0)


def test_faces_of_a_cube_are_refused():
    with pytest.raises(GeometryError, match="rank 6 of 9"):
        calibration_moments(MODEL, np.tile(cube_faces(), (2, 1)), G, 0.1)
