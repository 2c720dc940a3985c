"""Models chosen by evidence: the bias, and the sensitivity to force."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from tumbles import ACCELEROMETER, GYROSCOPE, WALK, M, tumble

from simval.calibrate import calibrate_imu, moves_between
from simval.calibrate.gyroscope.covariance import (
    GyroscopeNoise,
    rest_bias,
    rest_weights,
    sensitivity_noise,
    walk_covariance,
)
from simval.calibrate.gyroscope.imu import Rests, choose_bias, choose_sensitivity
from simval.calibrate.gyroscope.residuals import across, gap_rows, gap_values, gravity
from simval.calibrate.gyroscope.turn import end_of, turn
from simval.errors import GeometryError, InputError, RefusedError, SaturatedError
from simval.poses import fibonacci_sphere
from simval.sensor import GyroscopeModel

N = np.full(3, WALK)
G = np.array([[2.0, -1.0, 0.5], [0.3, 1.0, 0.0], [0.0, 0.4, -2.0]]) * 1e-4
FORCE = 9.81 * fibonacci_sphere(20)


def rests(rng, walk=0.0, sensitivity=None, spacing=3.6):
    """Twenty rests of a second, with white noise, a walk and a sensitivity."""
    rates = WALK * rng.standard_normal((20, 3))
    rates += walk * np.sqrt(spacing) * np.cumsum(rng.standard_normal((20, 3)), axis=0)
    if sensitivity is not None:
        rates += FORCE @ sensitivity.T
    return Rests(
        rates=rates, times=spacing * np.arange(20), seconds=np.ones(20),
        moves=np.full(19, 2.6),
    )  # fmt: skip


def kept(count, seed, **options):
    rng = np.random.default_rng(seed)
    walk = options.get("walk", 0.0)
    return sum(
        choose_sensitivity(rests(rng, **options), FORCE, N, walk).kept
        for _ in range(count)
    )


@pytest.mark.ci
def test_sensitivity_is_kept_where_there_is_none_as_often_as_stated():
    """1 % with and without a walk; binomial limit of one false alarm in 1e4."""
    most = stats.binom.isf(5e-5, 600, 0.01)
    assert kept(600, 1) <= most
    assert kept(600, 2, walk=2e-4) <= most


def test_sensitivity_is_seen_where_there_is_one():
    assert kept(50, 3, sensitivity=G) == 50
    found = choose_sensitivity(
        rests(np.random.default_rng(4), sensitivity=G), FORCE, N, 0.0
    )
    sd = WALK * np.sqrt(found.shape.diagonal()[1:])
    assert np.all(np.abs(found.G - G) < 4.8 * sd)  # nine: one in 1e5
    assert "F = " in found.reason


def test_a_walk_held_for_white_passes_for_a_sensitivity():
    """Power: why the rests are whitened."""
    rng = np.random.default_rng(5)
    false = sum(
        choose_sensitivity(rests(rng, walk=2e-4), FORCE, N, 0.0).kept for _ in range(60)
    )
    assert false > 20


def test_rests_in_a_plane_tell_no_sensitivity():
    flat = FORCE * np.array([1.0, 1.0, 0.0])
    found = choose_sensitivity(rests(np.random.default_rng(6)), flat, N, 0.0)
    assert not found.kept
    assert "in a plane" in found.reason


def test_bias_by_evidence():
    rng = np.random.default_rng(7)
    assert choose_bias(rests(rng), N, 0.0)[0] == "constant"
    assert choose_bias(rests(rng, walk=5e-4), N, 5e-4)[0] == "line"
    # scatter that does not grow with time is no walk, however large
    still = replace(rests(rng), rates=1e-2 * rng.standard_normal((20, 3)))
    assert choose_bias(still, N, None)[0] == "constant"
    kind, drift, said = choose_bias(rests(rng, walk=5e-4), N, None)
    assert kind == "line"
    assert 2.5e-4 < drift < 1e-3  # from 57 differences: a factor of two is ample
    assert "measured between rests" in said


def test_walk_covariance_is_that_of_walks():
    """Against 20 000 simulated walks, in steps of 0.05 s; five standard errors."""
    rng = np.random.default_rng(8)
    at, seen = np.array([1.0, 4.5, 7.0]), np.array([0.0, 3.0, 9.0])
    w = np.array([0.5, 0.3, 0.2])
    walks = np.cumsum(rng.standard_normal((20_000, 181)) * np.sqrt(0.05), axis=1)
    walks -= walks[:, :1]
    rows = np.round(np.concatenate([at, seen]) / 0.05).astype(int)
    values = walks[:, rows[:3]] - walks[:, rows[3:]] @ w[:, None]
    expected = walk_covariance(at, w, seen)
    sampled = values.T @ values / len(values)
    d = expected.diagonal()
    sd = np.sqrt((np.outer(d, d) + expected**2) / len(values))
    assert np.all(np.abs(sampled - expected) < 5.0 * sd)


def logs(count, seed, *, drift=0.0, sensitivity=None):
    """Whole logs of twenty poses, every sample of both sensors drawn."""
    truth = tumble(20, first_hold=5.0)
    sensor = GyroscopeModel(M=M, B=GYROSCOPE.B, G=sensitivity)
    rng, h = np.random.default_rng(seed), 0.01
    for _ in range(count):
        force = ACCELEROMETER.distort(truth.force, rng)
        force = force + 0.01 * rng.standard_normal(force.shape)
        rate = sensor.distort(truth.rate, rng, specific_force=truth.force)
        rate = rate + WALK / np.sqrt(h) * rng.standard_normal(rate.shape)
        steps = drift * np.sqrt(h) * rng.standard_normal(rate.shape)
        yield truth, force, rate + np.cumsum(steps, axis=0)


def nees(count, seed, *, drift=0.0, actual=None, **options):
    """Of the accelerometer and M, 18 of them, of each log."""
    expected, found = np.concatenate([ACCELEROMETER.parameters, M.ravel()]), []
    for truth, force, rate in logs(count, seed, drift=drift, sensitivity=actual):
        fit = calibrate_imu(
            truth.time, force, rate, truth.intervals, g=truth.g, chunk=2,
            start=np.eye(3), angle_random_walk=WALK,
            **{"bias_random_walk": drift, **options},
        )  # fmt: skip
        got = np.concatenate([fit.accelerometer.parameters, fit.gyroscope.M.ravel()])
        e, C = got - expected, fit.gyroscope.covariance[:18, :18]
        found.append(e @ np.linalg.solve(C, e))
    return np.array(found), fit


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "bias", "keeps"),
    [
        ("plain", "constant", False),
        ("force", "constant", True),
        ("walk", "line", False),
    ],
)
def test_error_bars_of_what_was_chosen_hold(name, bias, keeps):
    """NEES 18 of 100 logs within 4 standard errors, the choice made anew in each."""
    how = {"force": {"actual": G}, "walk": {"drift": 2e-4}}.get(name, {})
    values, fit = nees(100, 9, **how)
    assert abs(values.mean() - 18.0) < 4.0 * values.std(ddof=1) / 10.0
    assert (fit.gyroscope.bias, bool(fit.G.any())) == (bias, keeps)


@pytest.mark.slow
def test_a_walk_that_is_measured_leaves_the_bars_nearly_right():
    """Twenty rests tell K within a half: NEES 18 to 21, and 24 with a moment's K."""
    values, _ = nees(100, 9, drift=1e-4, actual=G, bias_random_walk=None)
    error = values.std(ddof=1) / 10.0
    assert 18.0 - 4.0 * error < values.mean() < 20.0 + 4.0 * error


@pytest.mark.slow
def test_a_sensitivity_that_is_ignored_is_seen():
    """Power: the same logs with none asked for, eight standard errors of NEES."""
    values, _ = nees(20, 9, actual=G, sensitivity=False)
    assert values.mean() > 18.0 + 8.0 * np.sqrt(2.0 * 18.0 / len(values))


def one_log():
    (log,) = logs(1, 10)
    return log


@pytest.mark.ci
def test_bad_input_is_refused_in_words():
    truth, force, rate = one_log()
    good = (truth.time, force, rate, truth.intervals)

    def spoilt(at, value):
        return [value if i == at else given for i, given in enumerate(good)]

    late = np.arange(len(truth.time)) > truth.intervals[3, 1] + 60
    hole = truth.time + 0.2 * late
    back = truth.time.copy()
    back[100] = back[98]
    nan = rate.copy()
    nan[7, 1] = np.nan
    cases = [
        (spoilt(0, hole), RefusedError, "rows are missing in the move between rests 3"),
        (spoilt(0, back), InputError, "does not rise"),
        (spoilt(0, truth.time[:-1]), InputError, "shape"),
        (spoilt(1, force[:-1]), InputError, "shape"),
        (spoilt(2, nan), InputError, "non-finite"),
        (spoilt(2, 0.0 * rate), InputError, "reads nothing"),
        (spoilt(3, truth.intervals[::-1]), InputError, "in order"),
        (spoilt(3, truth.intervals + 10**6), InputError, "beyond row"),
        (spoilt(3, truth.intervals[:2]), RefusedError, "pose"),
        (spoilt(2, rate[::-1]), GeometryError, "from where gravity is"),
    ]
    for arguments, kind, words in cases:
        with pytest.raises(kind, match=words):
            calibrate_imu(*arguments, g=truth.g)
    with pytest.raises(SaturatedError, match="range ends at 4"):
        calibrate_imu(*good, g=truth.g, full_scale=4.0)
    options = {
        "full_scale": -1.0,
        "bias": "parabola", "scheme": "simpson", "chunk": 3, "margin": -1,
        "pose_std": -1.0, "angle_random_walk": [1.0, 2.0], "bias_random_walk": -1.0,
        "estimator": "magic",
    }  # fmt: skip
    for name, bad in options.items():
        with pytest.raises(InputError, match=f"`{name}`"):
            calibrate_imu(*good, g=truth.g, **{name: bad})


def test_white_noise_is_measured_within_the_rests():
    truth, _, rate = one_log()
    moves = moves_between(truth.time, rate, truth.intervals)
    # differences of some 2400 rows: 1.22 / sqrt(2 n) of a standard deviation each
    rows = np.diff(truth.intervals)[:, 0].sum() - 22 * 20
    error = np.sqrt(1.5 / (2.0 * rows))
    assert np.all(np.abs(moves.white[0] / WALK - 1.0) < 4.5 * error)


def test_noise_of_a_sensitivity_is_what_a_wrong_one_does():
    """Its map to the rows and to the bias, against moves with another one taken out."""
    truth, _, rate = one_log()
    force = truth.force
    plain = moves_between(truth.time, rate, truth.intervals)
    known = Rests(
        rates=plain.rest_rates[0], times=plain.rest_times,
        seconds=plain.rest_seconds, moves=plain.seconds,
    )  # fmt: skip
    shape = choose_sensitivity(known, truth.directions, N, 0.0, asked=True).shape
    moves, at = [], np.random.default_rng(2).standard_normal((3, 3))
    root = np.linalg.cholesky(shape[1:, 1:])
    wrong = 10.0 * WALK * at @ root.T  # rows of G by unit noises, ten of them
    for G_out in (np.zeros((3, 3)), wrong):
        moves.append(
            moves_between(
                truth.time, rate, truth.intervals, offset=force @ G_out.T,
                force=force, force_noise=shape,
            )
        )  # fmt: skip
    poses = ACCELEROMETER.distort(truth.directions, np.random.default_rng(0))
    theta = ACCELEROMETER.parameters[None]
    found = gravity("triangular", theta, poses[None], truth.g)
    E = across(found.u[:, 1:])
    B = GYROSCOPE.B[None]
    values = [
        gap_values(end_of(m.statistics, M[None], B - m.centre), found.u, E)
        for m in moves
    ]
    noise = GyroscopeNoise(
        clock_jitter=0.0,
        angle_random_walk=N,
        bias_random_walk=0.0,
        pose_std=np.full((20, 3), 1e-3),
    )
    moved = turn(moves[0].statistics, M[None], B - moves[0].centre)
    rows = gap_rows(found, moved, noise.pose_std)
    gaps, of_bias = sensitivity_noise(rows, moved, moves[0], M[None], noise)
    expected = 10.0 * (gaps @ at.ravel())
    # linear in what is wrong: the second order of 1e-3 rad is left
    room = 2e-3 * np.abs(expected).max()
    np.testing.assert_allclose(values[1] - values[0], expected, atol=room)
    # the row of the bias is B less what the rests say of it
    w = rest_weights(plain)
    told = [rest_bias(m, noise, w)[0][0] + m.centre[0] for m in moves]
    np.testing.assert_allclose(
        told[0] - told[1], 10.0 * of_bias @ at.ravel(), rtol=1e-6, atol=1e-9 * WALK
    )
