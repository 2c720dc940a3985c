"""Rows by which theory alone judges what a run stands on.

Noise that was drawn, formulas and error bars beside how an estimate answers its
readings, and a detector beside rests that are known. That each sees the faults it is
there for is what `tests/power` asks.
"""

import numpy as np
import pytest
from cells import answers, of_family
from scipy import stats

from simval.errors import InputError
from simval.imu.statics import interval_counts, interval_means
from simval.poses import fibonacci_sphere
from simval.statistics import (
    BIAS_OFF,
    COVARIANCE_OFF,
    EDGE_OFF,
    NOISE_SQUARE,
    STRONGEST_CORRELATION,
)
from simval.streams import Streams, cell_key
from simval.studies import calibration, detector
from simval.studies.detector import known_rest_rows, known_rests
from simval.studies.response import MET, apart, response
from simval.studies.trials import (
    FALSE_ALARM,
    Drawn,
    correlation_row,
    drawn_rows,
    strongest_by_chance,
    trials_of,
)
from simval.theory.calibration import EVEN, calibration_moments

G = 9.80665
SETTINGS = (6.0, 51, 15)


def noise(rng, blocks, m):
    return [
        {"a": rng.standard_normal(m), "b": rng.standard_normal(m)}
        for _ in range(blocks)
    ]


def drawn(blocks):
    return drawn_rows([{k: Drawn.of(v) for k, v in b.items()} for b in blocks])


def test_noise_that_is_right_raises_no_alarm():
    # 300 seeds, three rows each; 600 scores of standard error 0.029 of their deviation
    found = [drawn(noise(np.random.default_rng(k), 4, 1100)) for k in range(300)]
    squares = [row for rows in found for row in of_family(rows, NOISE_SQUARE)]
    scores = [(row.value - row.prediction) / row.standard_error for row in squares]
    assert abs(np.std(scores) - 1.0) < 4.0 * 0.029
    assert abs(np.mean(scores)) < 4.0 / np.sqrt(len(scores))
    # at a rate of 1e-3 in all, more than 3 alarms have a probability of 3e-4
    assert sum(answers(rows) != {"pass"} for rows in found) <= 3


def louder(blocks):
    return [{k: 1.01 * v for k, v in block.items()} for block in blocks]


def again(blocks):
    return [*blocks[:7], {"a": blocks[3]["a"], "b": blocks[7]["b"]}]


def half_shared(blocks):
    a, b = blocks[5]["a"], blocks[5]["b"]
    return [*blocks[:5], {"a": a, "b": (a + b) / np.sqrt(2.0)}]


@pytest.mark.parametrize(
    ("fault", "seen"),
    [
        (louder, NOISE_SQUARE),
        (again, STRONGEST_CORRELATION),
        (half_shared, STRONGEST_CORRELATION),
    ],
)
def test_noise_that_is_wrong_is_seen(fault, seen):
    # power: 100 blocks of 1e4 numbers tell 1 % of noise by 14 standard errors
    blocks = noise(np.random.default_rng(20_261_122), 100, 10_000)
    assert answers(of_family(drawn(fault(blocks)), seen)) == {"fail"}


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


def test_a_trial_that_is_not_finite_is_refused():
    def trial(rng):
        noise = rng.standard_normal((2, 3))
        return {"error": np.where(noise > noise.min(), noise, np.nan)}, {"all": noise}

    trials = trials_of(Streams(1, cell_key("x")), 4, 2, trial)
    with pytest.raises(InputError, match="1 of 2 trials in block 0 gave a non-finite"):
        trials.sums("error")


@pytest.mark.parametrize(
    "residual", ["squared", "norm", "weighted", "sampson", "adjusted"]
)
@pytest.mark.parametrize("poses", [12, 40])
def test_theory_meets_the_response_of_every_residual(residual, poses):
    sensor, u = calibration.true_sensor(0.0), fibonacci_sphere(poses)
    rows = calibration.response_rows(sensor, G * u, G, residual)
    assert answers(rows) == {"pass"}
    # far within, and a formula that is off by 1e-4 is seen
    for row in of_family(rows, COVARIANCE_OFF):
        assert row.value < 1e-8 < row.remainder < 1e-4
    theory = calibration_moments(sensor, u, g=G, noise_std=1.0, residual=residual)
    for row in of_family(rows, BIAS_OFF):
        least = 1e-4 * np.abs(theory.bias / theory.sd).max()
        assert row.value < row.remainder < least
    # at the most uneven poses that are judged, a derivative that is 0.1 % off
    assert MET * (calibration.UNEVEN / EVEN) ** 4 < 1e-3


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


@pytest.mark.parametrize(
    "settings", [SETTINGS, (2.5, 3, 0), (6.0, 101, 0), (1e3, 51, 15), (10.0, 51, 200)]
)
def test_known_rests_are_found_to_the_sample(settings):
    rows = known_rest_rows(detector.detect, interval_means, interval_counts, settings)
    assert len(rows) == 4
    assert answers(rows) == {"pass"}

    def late(*given):
        intervals, *more = detector.detect(*given)
        return intervals + 1, *more

    rows = known_rest_rows(late, interval_means, interval_counts, settings)
    assert answers(of_family(rows, EDGE_OFF)) == {"fail"}


def test_known_rests_are_known_by_brute_force():
    # each window's own variance, of samples that belong to one rest or not
    known = known_rests(*SETTINGS)
    half = SETTINGS[1] // 2
    windows = np.lib.stride_tricks.sliding_window_view(known.samples, 2 * half + 1, 0)
    spread = np.linalg.norm(np.var(windows, axis=2, ddof=1), axis=1)
    start, stop = known.intervals[0] + np.array([-15, 15])
    first = np.linalg.norm(np.var(known.samples[start:stop], axis=0, ddof=1))
    below = np.flatnonzero(spread < 6.0 * first) + half
    for a, b in known.intervals + np.array([-15, 15]):
        inside = below[(below >= a - 1) & (below <= b)]
        assert (inside[0], inside[-1] + 1) == (a, b)
    total = np.sum(np.diff(known.intervals)) + 30 * len(known.intervals)
    assert len(below) == total  # and nothing else is
