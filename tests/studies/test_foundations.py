"""Rows by which theory alone judges what a run stands on.

Noise that was drawn, streams, variances by n - 1, formulas and error bars beside how an
estimate answers its readings, and a detector beside rests that are known.
"""

from dataclasses import replace

import numpy as np
import pytest
from cells import answers, of_family
from power.calibration import steeper
from power.fault import changed
from scipy import stats

from simval.errors import InputError
from simval.imu.calibrate import calibrate
from simval.imu.statics import interval_counts, interval_means
from simval.plugins import Filter, find_plugin
from simval.poses import fibonacci_sphere
from simval.statistics import (
    COUNT_OFF,
    COVARIANCE_OFF,
    EDGE_OFF,
    KNOWN_RESTS,
    MEAN_OFF,
    NOISE_SQUARE,
    STRONGEST_CORRELATION,
)
from simval.streams import Streams, cell_key
from simval.studies import detector, sampling
from simval.studies import filter as filters
from simval.studies.calibration import response_rows, true_sensor
from simval.studies.detector import known_rest_rows, known_rests
from simval.studies.filter_prediction import stated_row
from simval.studies.response import apart, response
from simval.studies.trials import (
    FALSE_ALARM,
    Drawn,
    correlation_row,
    drawn_rows,
    strongest_by_chance,
    trials_of,
)
from simval.theory import calibration as theory

SETTINGS = (6.0, 51, 15)


def noise(rng, blocks=16, m=1500):
    return [
        {"a": rng.standard_normal(m), "b": rng.standard_normal(m)}
        for _ in range(blocks)
    ]


def drawn(blocks):
    kept = [{k: Drawn.of(v) for k, v in block.items()} for block in blocks]
    return drawn_rows(kept)


@pytest.mark.ci
def test_noise_that_is_right_raises_no_alarm():
    # 100 fresh seeds, three rows each, at a rate of 1e-3 in all: more than 2 alarms
    # have a probability of 1.5e-4 (Poisson of 0.1)
    alarms = sum(
        answers(drawn(noise(np.random.default_rng(seed)))) != {"pass"}
        for seed in range(100)
    )
    assert alarms <= 2


@pytest.mark.ci
@pytest.mark.parametrize("scenario", ["gimbal slow", "gimbal fast", "long rest"])
@pytest.mark.parametrize("rate", [25.0, 100.0])
def test_the_reference_filter_states_what_theory_says(scenario, rate):
    given = filters.Parameters(scenario=scenario, rate=rate)
    way = filters.course(scenario, rate, given.seconds)
    plugin, told = find_plugin(given.algorithm, Filter), filters.told_of(given, way)
    rows = stated_row(plugin, told, plugin.world, (scenario, rate))
    assert answers(rows) == {"pass"}
    assert rows[0].value < 0.3 * rows[0].remainder
    louder = replace(told, gyroscope_noise=1.01 * told.gyroscope_noise)
    other = stated_row(plugin, louder, plugin.world, (scenario, rate))
    assert answers(other) == {"pass"}  # told the same on both sides


@pytest.mark.parametrize("fault", ["louder", "again", "shared", "half shared"])
def test_noise_that_is_wrong_is_seen(fault):
    # power: 100 blocks of 1e4 numbers tell 1 % of noise by 14 standard errors
    rng = np.random.default_rng(20_261_122)
    blocks = noise(rng, 100, 10_000)
    if fault == "louder":
        blocks = [{k: 1.01 * v for k, v in block.items()} for block in blocks]
    if fault == "again":
        blocks[7] = {"a": blocks[3]["a"], "b": blocks[7]["b"]}
    if fault == "shared":
        blocks[5]["b"] = blocks[5]["a"].copy()
    if fault == "half shared":
        blocks[5]["b"] = (blocks[5]["a"] + blocks[5]["b"]) / np.sqrt(2.0)
    rows = drawn(blocks)
    assert "fail" in answers(rows)
    seen = NOISE_SQUARE if fault == "louder" else STRONGEST_CORRELATION
    assert "fail" in answers(of_family(rows, seen))


def test_the_strongest_correlation_has_its_law():
    # 4000 sets of three vectors of 12 numbers: the share beyond a limit that is set for
    # a share of 0.03 to first order lies within 4 binomial standard errors of the exact
    # share of the greatest of three nearly independent correlations
    rng = np.random.default_rng(3)
    X = rng.standard_normal((4000, 3, 12))
    X /= np.linalg.norm(X, axis=2, keepdims=True)
    r = np.abs(X @ np.swapaxes(X, 1, 2))[:, [0, 0, 1], [1, 2, 2]].max(axis=1)
    # an independent route: r^2 of uniform directions is Beta(1/2, (m - 1)/2)
    limit = np.sqrt(stats.beta.isf(0.01, 0.5, 5.5))
    expected = 1.0 - 0.99**3
    error = np.sqrt(expected * (1.0 - expected) / 4000)
    assert abs(np.mean(r > limit) - expected) < 4.0 * error
    ours = strongest_by_chance(3, 12)
    # the quantile of a Beta is found to 1e-9 of itself in its far tail
    assert ours**2 == pytest.approx(stats.beta.isf(FALSE_ALARM / 3, 0.5, 5.5), rel=1e-8)


def test_noise_of_nothing_does_not_pass():
    rows = drawn_rows([{"a": Drawn.of(np.zeros(2000))} for _ in range(2)])
    assert answers(of_family(rows, NOISE_SQUARE)) == {"fail"}
    (row,) = correlation_row(np.zeros((2, 2000)))
    assert row.value == 0.0


@pytest.mark.parametrize("kept", ["seed", "key", "number"])
def test_streams_that_ignore_a_part_of_their_name_are_seen(kept, monkeypatch):
    def block(self, number):
        seed = 1 if kept == "seed" else self.seed
        key = (1,) if kept == "key" else self.key
        return sampling.Streams.original(
            Streams(seed, key), 0 if kept == "number" else number
        )

    monkeypatch.setattr(Streams, "original", Streams.block, raising=False)
    monkeypatch.setattr(Streams, "block", block)
    outcome = sampling.run(sampling.Parameters(blocks=4), Streams(1, cell_key("x")))
    assert answers(of_family(outcome.rows, STRONGEST_CORRELATION)) == {"fail"}


@pytest.mark.parametrize(
    "residual", ["squared", "norm", "weighted", "sampson", "adjusted"]
)
@pytest.mark.parametrize("poses", [12, 40])
def test_theory_meets_the_response_of_every_residual(residual, poses):
    rows = response_rows(
        true_sensor(0.0), 9.80665 * fibonacci_sphere(poses), 9.80665, residual
    )
    assert answers(rows) == {"pass"}
    # far within: 100 times below what a derivative 0.1 % off makes of a deviation
    assert all(row.value < 1e-8 for row in of_family(rows, COVARIANCE_OFF))


def test_a_trial_that_is_not_finite_is_refused():
    def trial(rng):
        noise = rng.standard_normal((2, 3))
        return {"error": np.where(noise > noise.min(), noise, np.nan)}, {"all": noise}

    trials = trials_of(Streams(1, cell_key("x")), 4, 2, trial)
    with pytest.raises(InputError, match="1 of 2 trials in block 0 gave a non-finite"):
        trials.sums("error")


def test_the_response_is_of_fourth_order():
    # of a known function: errors of a first derivative fall by 2^4 with half the step
    def estimate(y):
        return np.stack([np.exp(y[:, 0]) * y[:, 1], np.sin(y[:, 1])], axis=1)

    y = np.array([0.3, 0.7])
    first = np.array([[np.exp(0.3) * 0.7, 0.0], [np.exp(0.3), np.cos(0.7)]])
    second = np.array([[np.exp(0.3) * 0.7, 0.0], [0.0, -np.sin(0.7)]])
    errors = []
    for step in (0.2, 0.1):
        found = response(estimate, y, step)
        errors.append(
            (np.abs(found.first - first).max(), np.abs(found.second - second).max())
        )
    ratios = np.divide(errors[0], errors[1])
    # the next order, h^2 of a derivative of the size of the function, is 0.04 of it
    np.testing.assert_allclose(ratios, 16.0, rtol=0.05)
    C = response(estimate, y, 1e-3).covariance(np.array([0.1, 0.2]))
    J = first * np.array([[0.1], [0.2]])
    assert apart(C, J.T @ J) < 1e-10  # h^4 and rounding over h


def test_a_derivative_a_thousandth_off_is_beyond_the_response():
    with changed(theory, "_equations", steeper(1.001)):
        rows = response_rows(true_sensor(0.0), 9.80665 * fibonacci_sphere(20), 9.80665)
    assert answers(of_family(rows, COVARIANCE_OFF)) == {"fail"}


@pytest.mark.parametrize(
    "settings", [SETTINGS, (2.5, 3, 0), (6.0, 101, 0), (1e3, 51, 15), (10.0, 51, 200)]
)
def test_known_rests_are_found_to_the_sample(settings):
    rows = known_rest_rows(detector.detect, interval_means, interval_counts, settings)
    assert len(rows) == 4
    assert answers(rows) == {"pass"}


def test_known_rests_are_known_by_brute_force():
    # each window's own variance, of samples that belong to one rest or not
    known = known_rests(*SETTINGS)
    half = SETTINGS[1] // 2
    spread = np.array(
        [
            np.linalg.norm(
                np.var(known.samples[k - half : k + half + 1], axis=0, ddof=1)
            )
            for k in range(half, len(known.samples) - half)
        ]
    )
    start, stop = known.intervals[0] + np.array([-15, 15])
    first = np.linalg.norm(np.var(known.samples[start:stop], axis=0, ddof=1))
    below = np.flatnonzero(spread < 6.0 * first) + half
    for a, b in known.intervals + np.array([-15, 15]):
        inside = below[(below >= a - 1) & (below <= b)]
        assert (inside[0], inside[-1] + 1) == (a, b)
    total = np.sum(np.diff(known.intervals)) + 30 * len(known.intervals)
    assert len(below) == total  # and nothing else is


@pytest.mark.parametrize("factor", [50.0 / 51.0, 1.004])
def test_a_threshold_of_another_variance_finds_other_rests(factor, monkeypatch):
    # 50/51: a window's variance by n; 1.004: the initial rest's by n, of 500 samples
    whole, rest = detector.variance_magnitude, detector.initial_rest
    monkeypatch.setattr(
        detector, "variance_magnitude", lambda raw, window: factor * whole(raw, window)
    )
    monkeypatch.setattr(
        detector, "initial_rest", lambda *given: rest(*given[:4], given[4] / factor)
    )
    assert seen(detector.detect, interval_means, interval_counts, KNOWN_RESTS)


def seen(detect, means, counts, family):
    rows = known_rest_rows(detect, means, counts, SETTINGS)
    return answers(of_family(rows, family)) == {"fail"}


@pytest.mark.parametrize("change", [(-1, 0), (0, 1), (1, 1), (-15, 15)])
def test_a_detector_that_is_a_sample_off_fails(change):
    def detect(*given):
        intervals, *more = detector.detect(*given)
        return intervals + np.array(change), *more

    def late(samples, rests):
        return interval_means(samples, rests - np.array([0, 1]))

    assert seen(detect, interval_means, interval_counts, EDGE_OFF)
    assert seen(detector.detect, late, interval_counts, MEAN_OFF)
    more = seen(
        detector.detect, interval_means, lambda r: interval_counts(r) + 1, COUNT_OFF
    )
    assert more


def test_stated_type_a_variances_are_unbiased_and_one_degree_more_is_seen():
    # 2048 trials of 20 poses: 11 degrees of freedom, a standard error of 0.9 %
    rng = np.random.default_rng(5)
    sensor, u = true_sensor(0.0), fibonacci_sphere(20)
    clean = sensor.distort(9.80665 * u, rng)
    noisy = clean + 0.01 * rng.standard_normal((2048, 20, 3))
    fit = calibrate(noisy, 9.80665)
    known = calibrate(clean, 9.80665, noise_std=0.01)
    ratio = np.mean((fit.sd / known.sd) ** 2, axis=1)
    error = np.std(ratio) / np.sqrt(len(ratio))
    # once in 1e4 seeds; 0.3 % of unequal scales, as `simval.studies.coverage` says
    limit = stats.norm.isf(1e-4 / 2) * error + 0.003
    assert abs(ratio.mean() - 1.0) < limit
    assert abs(ratio.mean() * 11.0 / 12.0 - 1.0) > limit
