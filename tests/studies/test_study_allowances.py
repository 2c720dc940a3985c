"""What a study lets a prediction be off by: more than is right, less than a fault.

Each constant that widens a verdict lies between two figures that are found without it:
what soundness leaves (rounding, the order left out, a measured run) and the least fault
that its row is there for. A hundred times each constant is beyond the second; a
hundredth of it may still be above the first, where there is room.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from simval.imu.calibrate import calibrate
from simval.imu.noise import allan as quadrature
from simval.imu.noise import allan_covariance, covariance_forms
from simval.imu.sensor import AccelerometerModel
from simval.plugins import Filter, find_plugin
from simval.poses import fibonacci_sphere
from simval.results import CellName
from simval.statistics import BIAS_OFF, COVARIANCE_OFF
from simval.studies import (
    attitude_efficiency,
    attitude_vectors,
    calibration,
    calibrator,
    detector,
    estimator,
    filter_prediction,
    gyroscope,
    magnetometer,
    noise_model,
    sampling,
    scene,
    solvers,
)
from simval.studies import filter as filters
from simval.studies.calibration import true_sensor
from simval.studies.response import MET
from simval.theory.calibration import EVEN, calibration_moments
from simval.theory.cubature import smolyak_hermite
from simval.verdict import judge

EPS = np.finfo(float).eps
G = 9.80665
SINGLE = 2.0**-24  # relative: half a unit in the last place of four bytes
LOUDER = 0.01  # the fault that most rows are for: 1 % of a noise, 2 % of a square


def covered(factor, level=0.95):
    """Coverage of an interval of a normal law that is so much too short or wide."""
    return 2.0 * stats.norm.cdf(factor * stats.norm.ppf((1.0 + level) / 2.0)) - 1.0


def test_intervals_of_a_noise_model_that_are_a_tenth_short_are_seen():
    # 6000 signals of 16 384 rows: B is covered at 93.3 %, with an error of 0.3 %
    assert 0.95 - 0.933 - 2.0 * 0.003 < noise_model.COVERED < 0.95 - covered(0.9)


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


@pytest.fixture(scope="module")
def recovered():
    """Errors of 20 random sensors without noise, in units of 1 and g, by condition."""
    rng = np.random.default_rng(20_261_122)
    errors = []
    for _ in range(20):
        sensor = AccelerometerModel.from_parameters(
            np.concatenate([np.zeros(3), np.ones(3), np.zeros(3)])
            + rng.uniform(-0.05, 0.05, 9) * np.array([1.0] * 6 + [G] * 3)
        )
        fit = calibrate(sensor.distort(G * fibonacci_sphere(20), rng), G)
        off = np.abs(fit.parameters - sensor.parameters)
        errors.append((off / np.array([1.0] * 6 + [G] * 3)).max() / fit.condition)
    return max(errors)


def test_parameters_without_noise_are_found_far_better_than_in_four_bytes(recovered):
    for most in (calibration.RECOVERED, magnetometer.RECOVERED):
        # thousands of times what an even set of poses leaves, and no float32 in between
        assert 1000.0 * recovered < most < SINGLE


def test_rounding_of_a_calibration_is_that_of_its_least_squares(recovered):
    # a priori, of a QR factorization: m n eps times the condition, with the fewest
    # poses, 12, and nine parameters
    assert recovered < calibration.ROUNDED < 12 * 9 * EPS


def test_slopes_of_a_coverage_are_those_of_its_density():
    z = stats.norm.ppf(0.975)
    # d/ds of P(|x| < z s) is 2 z f(z) at s = 1, and a bias b takes b^2 z f(z) of it
    slope, bend = magnetometer.INTERVAL_SLOPE, magnetometer.BIAS_SLOPE
    assert slope == pytest.approx(2.0 * z * stats.norm.pdf(z), rel=0.01)
    assert bend == pytest.approx(z * stats.norm.pdf(z), rel=0.01)
    # the same without the formula
    step = 1e-3
    shifted = stats.norm.cdf(z - step) - stats.norm.cdf(-z - step)
    assert bend == pytest.approx((0.95 - shifted) / step**2, rel=0.01)


def test_the_worst_instant_is_reached_by_chance_once_in_1e8_cells():
    instants = filters.INSTANTS
    by_chance = instants * 2.0 * stats.norm.sf(filters.WORST)
    assert 1e-9 < by_chance < 1.01e-8


def test_one_percent_of_a_filters_noise_is_seen():
    # what a step of 1/25 s leaves of a covariance, 0.35 dt^2 as measured, is within it
    left = 0.35 / 25.0**2
    assert left < filters.RELATIVE < 2.0 * LOUDER
    # all noises 5 % larger make a linear filter's errors 5 % larger
    assert left / 2.0 < filters.OVER < 0.05


@pytest.mark.ci
def test_a_filter_that_is_told_one_percent_more_noise_states_another_covariance(
    monkeypatch,
):
    given = filters.Parameters(scenario="gimbal slow", rate=100.0)
    way = filters.course("gimbal slow", 100.0, given.seconds)
    plugin, told = find_plugin(given.algorithm, Filter), filters.told_of(given, way)
    right = filter_prediction.model_of

    def louder(told, compass):
        noise = (1.0 + LOUDER) * told.gyroscope_noise
        return right(replace(told, gyroscope_noise=noise), compass)

    monkeypatch.setattr(filter_prediction, "model_of", louder)
    stated = (plugin, told, plugin.world, ("gimbal slow", 100.0))
    (row,) = filter_prediction.stated_row(*stated)
    assert answer(row) == "fail"


def answer(row):
    (verdict,) = judge([(CellName("filter", "filter()@1"), row)])
    return verdict.answer


@pytest.mark.parametrize("residual", ["squared", "norm", "weighted", "sampson"])
def test_a_formula_that_is_off_by_a_ten_thousandth_is_seen(residual):
    sensor, u = true_sensor(0.0), fibonacci_sphere(12)
    rows = calibration.response_rows(sensor, G * u, G, residual)
    theory = calibration_moments(sensor, u, g=G, noise_std=1.0, residual=residual)
    (bias,) = (row for row in rows if row.statistic.family == BIAS_OFF)
    assert bias.value < bias.remainder < 1e-4 * np.abs(theory.bias / theory.sd).max()
    for row in rows:
        if row.statistic.family == COVARIANCE_OFF:
            assert row.value < row.remainder < 1e-4
    # at the most uneven poses that are judged, a derivative that is 0.1 % off
    assert MET * (calibration.UNEVEN / EVEN) ** 4 < 1e-3


def test_a_claim_of_one_percent_too_much_is_seen():
    # the package's estimators are within 2e-8 in 60 geometries
    assert 1000.0 * 2e-8 < estimator.LEADING_TOLERANCE < LOUDER


def test_sums_are_allowed_what_rounding_makes_of_them():
    # a mean of known rests: levels of up to 400 in amplitudes of 1, 500 of them and
    # more; each addition is off by eps/2 of the sum
    summed = 500 * 400 * EPS / 2.0
    assert summed < detector.ROUNDED < 100.0 * summed
    # 27 variances of three values, ten operations each
    off = max(abs(row.value - 1.0) for row in sampling._variance_rows())
    assert off < 270 * EPS < sampling.ROUNDED < 100.0 * 270 * EPS


def test_a_scene_is_allowed_what_rounding_makes_of_a_row():
    # ten roundings of numbers up to 1, and a thousand times that
    assert 10 * EPS < scene.ROUNDING < 1000.0 * 10 * EPS
    # a quaternion keeps eps of 1, so of a turn of 1e-6 rad nine digits
    assert EPS / 1e-6 < scene.LAG_ROUNDING < 100.0 * EPS / 1e-6


def test_the_weights_of_cubature_enlarge_rounding_by_their_sizes():
    # two vectors on each side: twelve errors, of degree seven
    _, weights = smolyak_hermite(12, estimator.DEGREE)
    assert np.abs(weights).sum() == pytest.approx(estimator.WEIGHTS, rel=0.01)


def test_a_bias_of_twice_the_ladders_greatest_is_seen():
    sensor = AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
    noise = 0.01 * G
    theory = calibration_moments(
        sensor, fibonacci_sphere(40), g=G, noise_std=noise, residual="squared"
    )
    sizes = np.array([1.0] * 6 + [G] * 3)
    greatest = np.abs(theory.bias / (0.01**2 * sizes)).max()
    assert greatest < calibrator.BIAS_ALLOWED < 3.0 * greatest


def test_a_gyroscope_s_noise_of_one_percent_and_a_bias_of_a_quarter_are_seen():
    # the mean of what segments leave out, and the covariance at a noisy estimate
    assert 5e-4 + 1e-3 < gyroscope.RELATIVE < 2.0 * LOUDER
    # eq. (V2) of 12 biases by `ENOUGH` trials, a quarter of the run's rate for them
    limit = stats.norm.isf(0.25e-3 / 12 / 2) + stats.norm.isf(0.01)
    seen = limit / np.sqrt(gyroscope.ENOUGH)
    assert 0.0017 + 0.003 < gyroscope.SMALL_BIAS < 0.25 - seen


def test_the_best_of_four_would_be_beyond_the_limits_of_the_combined_estimator():
    rng = np.random.default_rng(500)
    problems = attitude_efficiency.geometries(20, rng)
    predicted = np.array([attitude_efficiency.predicted_squares(p) for p in problems])
    combined, best, bound = np.sqrt(predicted[:, :3].T)
    assert np.all(combined >= bound * (1.0 - 1e-9))
    most = attitude_efficiency.MEDIAN + attitude_efficiency.SPREAD / np.sqrt(len(best))
    assert np.median(best / bound) > most > 1.0
    assert np.max(best / bound) > attitude_efficiency.WORST_LIMIT
    assert np.max(combined / bound) < attitude_efficiency.WORST_LIMIT


@pytest.mark.parametrize(("shift", "noise"), [(0.0, 1e-3), (3.0, 1e-4)])
def test_vectors_are_allowed_twice_what_the_first_order_leaves(shift, noise):
    """Theory is right at no noise, so all that cubature differs by falls with it."""
    given = attitude_vectors.Parameters(vectors=3, noise_std=noise, ratio=10.0)
    off = attitude_vectors.Setting(given).off(shift)
    allowed = attitude_vectors.left_out(given, shift)
    if shift:  # of the loss alone; squared errors are of no turned vector
        off, allowed = off[-1:], allowed[-1:]
    assert np.abs(off).min() > 1e-8  # far above rounding
    # the next power of the noise, ten times 1e-3 in the worst vector
    assert allowed == pytest.approx(2.0 * np.abs(off), rel=0.03)


@pytest.mark.parametrize(
    "geometries",
    [100, 137, *(pytest.param(n, marks=pytest.mark.ci) for n in (200, 500))],
)
def test_the_combined_estimator_is_within_its_limits_for_any_number(geometries):
    rng = np.random.default_rng(geometries)
    problems = attitude_efficiency.geometries(geometries, rng)
    predicted = np.array([attitude_efficiency.predicted_squares(p) for p in problems])
    name = "combined"
    ratios = np.sqrt(predicted[:, 0] / predicted[:, 2])
    rows = attitude_efficiency.ratio_rows(name, ratios, ratios, 0.0 * ratios)
    judged = [row for row in rows if row.check == "limit"]
    assert len(judged) == 2
    assert all(row.value <= row.prediction for row in judged)
