"""What a study lets a prediction be off by: more than is right, less than a fault.

Each constant that widens a verdict lies between two figures that are found without it:
what soundness leaves (rounding, the order left out, a measured run) and the least fault
that its row is there for. A hundred times each constant is beyond the second; a
hundredth of it may still be above the first, where there is room.
"""

import numpy as np
import pytest
from cells import rows_of
from rounding import EPS
from scipy import stats

from simval.imu.calibrate import calibrate
from simval.imu.noise import allan as quadrature
from simval.imu.noise import allan_covariance, covariance_forms
from simval.imu.sensor import AccelerometerModel
from simval.poses import fibonacci_sphere
from simval.studies import (
    attitude_efficiency,
    attitude_vectors,
    calibration,
    calibrator,
    detector,
    estimator,
    filter,
    filter_errors,
    filter_prediction,
    gyroscope,
    magnetometer,
    noise_model,
    sampling,
    scene,
    solvers,
)
from simval.studies.calibration import true_sensor
from simval.theory.calibration import calibration_moments
from simval.theory.cubature import smolyak_hermite

G = 9.80665
SIZES = np.array([1.0] * 6 + [G] * 3)  # of nine parameters
SINGLE = 2.0**-24  # relative: half a unit in the last place of four bytes
LOUDER = 0.01  # the fault that most rows are for: 1 % of a noise, 2 % of a square


def covered(factor, level=0.95):
    """Coverage of an interval of a normal law that is so much too short or wide."""
    return 2.0 * stats.norm.cdf(factor * stats.norm.ppf((1.0 + level) / 2.0)) - 1.0


Z = stats.norm.ppf(0.975)
BY_CHANCE = filter.INSTANTS * 2.0 * stats.norm.sf(filter_errors.WORST)
# eq. (V2) of 12 biases by `ENOUGH` trials, a quarter of the run's rate for them
SIGMAS = stats.norm.isf(0.25e-3 / 12 / 2) + stats.norm.isf(0.01)
SEEN = SIGMAS / np.sqrt(gyroscope.ENOUGH)
ALLOWED = {  # what soundness leaves, the constant, and the least fault
    # 6000 signals of 16 384 rows: B is covered at 93.3 %, with an error of 0.3 %;
    # intervals that are a tenth short
    "coverage of a noise model": (0.011, noise_model.COVERED, 0.95 - covered(0.9)),
    "worst instant, once in 1e8 cells": (1e-9, BY_CHANCE, 1.01e-8),
    # a step of 1/25 s leaves 0.35 dt^2 of a covariance, as measured; all noises 5 %
    # larger make a linear filter's errors 5 % larger
    "squares of a filter": (0.35 / 25.0**2, filter_errors.RELATIVE, 2.0 * LOUDER),
    "errors of a filter": (0.35 / 25.0**2 / 2.0, filter_errors.OVER, 0.05),
    # a step of 1/50 s: half of the covariance of turn and bias left out of Q is seen,
    # where the axes are 3.5 times as unlike
    "step of a filter": (0.08, filter_prediction.LEFT_OUT, 0.0099 / 0.02**2 / 3.5),
    # the package's estimators are within 2e-8 in 60 geometries
    "claim of an estimator": (1e3 * 2e-8, estimator.LEADING_TOLERANCE, LOUDER),
    # a mean of known rests: levels of up to 400 in amplitudes of 1, 500 of them and
    # more; each addition is off by eps/2 of the sum
    "sums of a detector": (1e5 * EPS, detector.ROUNDED, 1e7 * EPS),
    # 27 variances of three values, ten operations each
    "sums of variances": (270 * EPS, sampling.ROUNDED, 100.0 * 270 * EPS),
    # ten roundings of numbers up to 1; a quaternion keeps eps of 1, so of a turn of
    # 1e-6 rad nine digits
    "row of a scene": (10 * EPS, scene.ROUNDING, 1000.0 * 10 * EPS),
    "lag of a scene": (EPS / 1e-6, scene.LAG_ROUNDING, 100.0 * EPS / 1e-6),
    # the mean of what segments leave out, and the covariance at a noisy estimate
    "noise of a gyroscope": (5e-4 + 1e-3, gyroscope.RELATIVE, 2.0 * LOUDER),
    "bias of a gyroscope": (0.0017 + 0.003, gyroscope.SMALL_BIAS, 0.25 - SEEN),
}


@pytest.mark.parametrize("name", ALLOWED)
def test_what_is_allowed_lies_between_what_is_right_and_a_fault(name):
    sound, constant, fault = ALLOWED[name]
    assert sound < constant < fault


def test_the_quadrature_of_allan_covariances_is_within_what_is_allowed(monkeypatch):
    theory = noise_model.Theory(noise_model.Parameters(rows=4096))
    # twice the nodes: each lag by itself, without a quadrature, gives this to 1e-8
    monkeypatch.setattr(quadrature, "NODES", 72)
    forms = covariance_forms(theory.counts, 4096)[..., :3, :3]
    variances = np.diagonal(allan_covariance(forms, theory.truth))
    left = np.abs(np.diagonal(theory.covariance) / variances - 1.0).max()
    # 5.7e-4; the same bound as of `test_quadratic_forms`
    assert 1e-4 < left < 0.3 / (12 * 36)
    assert left < noise_model.LAGS < 2.0 * LOUDER


def test_methods_of_the_calibration_agree_to_the_digits_that_are_printed():
    worst = 0.0
    for poses, noise in ((12, 0.3), (40, 0.01)):
        sensor, u = true_sensor(noise), fibonacci_sphere(poses)
        raw = sensor.distort(G * u, np.random.default_rng(3))
        first, *others = (
            calibrate(raw, g=G, method=method).parameters for method in solvers.METHODS
        )
        apart = max(np.abs(other - first).max() for other in others)
        worst = max(worst, apart / np.abs(first).max())
    # each stops at a step of 1e-12, and what is left is less than its last step; the
    # sixth digit is the last one that is printed, and this a tenth of half of it
    assert worst < 1e-12 < solvers.AGREEMENT < 0.1 * 0.5e-6


def test_parameters_without_noise_are_found_far_better_than_in_four_bytes():
    """Errors of 20 random sensors, in units of 1 and g, by condition."""
    rng = np.random.default_rng(20_261_122)
    ideal = np.concatenate([np.zeros(3), np.ones(3), np.zeros(3)])
    errors = []
    for _ in range(20):
        off = rng.uniform(-0.05, 0.05, 9) * SIZES
        sensor = AccelerometerModel.from_parameters(ideal + off)
        fit = calibrate(sensor.distort(G * fibonacci_sphere(20), rng), G)
        off = np.abs(fit.parameters - sensor.parameters)
        errors.append((off / SIZES).max() / fit.condition)
    # a priori, of a QR factorization: m n eps times the condition, with the fewest
    # poses, 12, and nine parameters
    assert max(errors) < calibration.ROUNDED < 12 * 9 * EPS
    for most in (calibration.RECOVERED, magnetometer.RECOVERED):
        # thousands of times what an even set of poses leaves, and no float32 in between
        assert 1000.0 * max(errors) < most < SINGLE


def test_the_weights_of_cubature_enlarge_rounding_by_their_sizes():
    # two vectors on each side: twelve errors, of degree seven
    _, weights = smolyak_hermite(12, estimator.DEGREE)
    assert np.abs(weights).sum() == pytest.approx(estimator.WEIGHTS, rel=0.01)


def test_a_bias_of_twice_the_ladders_greatest_is_seen():
    sensor = AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
    theory = calibration_moments(
        sensor, fibonacci_sphere(40), g=G, noise_std=0.01 * G, residual="squared"
    )
    greatest = np.abs(theory.bias / (0.01**2 * SIZES)).max()
    assert greatest < calibrator.BIAS_ALLOWED < 3.0 * greatest


@pytest.mark.parametrize("sigma", ["known", "type A"])
def test_what_a_coverage_is_allowed_is_a_fifth_of_what_it_must_see(sigma):
    rows = rows_of("coverage", sigma=sigma, poses=12, trials=4096)
    judged = [row for name, row in rows.items() if name.startswith("coverage[")]
    assert len(judged) == 10
    # of the 1 % that a coverage is allowed to be off; 0.0008 is seen
    assert all(row.remainder < 0.002 for row in judged)
    # that of the predicted fraction, not of the seen one
    errors = [stats.binom.std(4096, row.prediction) / 4096 for row in judged]
    assert [row.standard_error for row in judged] == pytest.approx(errors)
    # which is lower than the level by what the bias makes of it, hardly anything
    assert all(0.9498 < row.prediction <= 0.95 for row in judged)
    assert sigma == "type A" or rows["nees"].remainder < 0.1


@pytest.mark.parametrize(
    ("count", "noise"),
    [
        (100, "isotropic"),
        (137, "unequal"),
        pytest.param(200, "unequal", marks=pytest.mark.ci),
        pytest.param(500, "isotropic", marks=pytest.mark.ci),
    ],
)
def test_the_combined_estimator_and_no_other_has_its_closed_price(count, noise):
    problems = attitude_efficiency.geometries(count, np.random.default_rng(count))
    parameters = attitude_efficiency.Parameters(noise=noise)
    predicted = attitude_efficiency.predicted_squares(problems, parameters)
    combined, best, _, bound, _ = np.sqrt(predicted.T)
    assert np.all(combined >= bound * (1.0 - 1e-9))
    none = np.zeros(count)
    price = attitude_efficiency.price_of_columns(problems, parameters, bound**2)
    assert combined / bound == pytest.approx(price, rel=attitude_efficiency.ROUNDED)
    for ratios, within in ((combined / bound, True), (best / bound, False)):
        rows = attitude_efficiency.ratio_rows("combined", ratios, ratios, none, price)
        judged = [row for row in rows if row.check == "exact"]
        assert len(judged) == 2
        off = [abs(row.value - row.prediction) <= row.remainder for row in judged]
        assert off == [within, within]


@pytest.mark.parametrize(("shift", "noise"), [(0.0, 1e-3), (3.0, 1e-4)])
def test_vectors_are_allowed_twice_what_the_first_order_leaves(shift, noise):
    """Theory is right at no noise, so all that cubature differs by falls with it."""
    given = attitude_vectors.Parameters(vectors=3, noise_std=noise, ratio=10.0)
    off = attitude_vectors.Setting(given).off(shift, 5)
    allowed = attitude_vectors.left_out(given, shift)
    # of the square of the loss, of fourth order, degree 5 has not all of the next
    off, allowed = off[:-1], allowed[:-1]
    if shift:  # of the loss alone; squared errors are of no turned vector
        off, allowed = off[-1:], allowed[-1:]
    assert np.abs(off).min() > 1e-8  # far above rounding
    # the next power of the noise, ten times 1e-3 in the worst vector
    assert allowed == pytest.approx(2.0 * np.abs(off), rel=0.03)
