"""Rotations between rests: paths against integrators that share no step, limits."""

from itertools import pairwise

import numpy as np
import pytest
from magnetometer_sets import squares
from rounding import EPS
from scipy import stats
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from tumbles import ACCELEROMETER, FIRST_UP, GENERIC, GYROSCOPE, M, gyroscope_of, rolled

from simval.errors import RefusedError, SaturatedError
from simval.imu.calibrate import calibrate, inter_rest_rotations
from simval.imu.calibrate.gyroscope.rotation import final_rotations, rotations
from simval.imu.calibrate.path_statistics import SCHEMES, path_statistics

RNG = np.random.default_rng(7)
MATRICES = np.eye(3) + 0.05 * RNG.standard_normal((2, 3, 3))
BIASES = 0.1 * RNG.standard_normal((2, 3))


def smooth_rate(t):
    """A rate that is zero at both ends, with its axis turning; raw units.

    Three derivatives are zero there too: of a minimum-jerk move the second is not, and
    a cubic across that end is of order three.
    """
    hump = 630.0 * t**4 * (1.0 - t) ** 4
    along = [2.0 * np.cos(3.0 * t), -1.5 * np.sin(2.0 * t + 0.4), 1.0 + t]
    return np.stack([hump * each for each in along], axis=-1)


def rows(n, scheme):
    """Rows of one second: 3 before, n + 1 from its start to its end, 3 after."""
    t = np.arange(-3, n + 4) / n
    inside = np.clip(t, 0.0, 1.0)
    if scheme != "averages":
        return np.where(((t >= 0) & (t <= 1))[:, None], smooth_rate(inside), 0.0)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    mean = np.zeros((len(t), 3))
    for x, w in zip(nodes, weights, strict=True):
        at = t - (0.5 - 0.5 * x) / n
        moving = ((at > 0) & (at < 1))[:, None]
        mean += 0.5 * w * np.where(moving, smooth_rate(np.clip(at, 0, 1)), 0.0)
    return mean


def exact(matrix):
    """The turn by SciPy's integrator of the kinematic equation, to 1e-12."""

    def slope(t, c):
        w = matrix @ smooth_rate(np.array(t))
        skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return (c.reshape(3, 3) @ skew).ravel()

    found = solve_ivp(slope, (0, 1), np.eye(3).ravel(), rtol=1e-12, atol=1e-13)
    return found.y[:, -1].reshape(3, 3)


def by_scheme(n, scheme, chunk=1, matrix=MATRICES[0], bias=(0.0, 0.0, 0.0)):
    made = path_statistics(
        rows(n, scheme)[None], np.full(n + 7, 1.0 / n),
        np.array([3]), np.array([n + 3]), scheme, chunk,
    )  # fmt: skip
    return final_rotations(made, matrix[None], np.array([bias]))[0, 0]


def off(C, truth):
    return Rotation.from_matrix(C @ truth.T).magnitude()


@pytest.mark.parametrize(
    ("scheme", "order"), [("averages", 4), ("cubic", 4), ("linear", 2)]
)
def test_order_of_each_integrator(scheme, order):
    """Halving the step divides the error by 2 to the order; without a bias, whose jump
    at the ends of the rate no scheme is asked to follow."""
    truth = exact(MATRICES[0])
    error = [off(by_scheme(n, scheme), truth) for n in (50, 100, 200)]
    slopes = np.log2(np.array(error[:-1]) / error[1:])
    np.testing.assert_allclose(slopes, order, atol=0.3)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("chunk", [1, 4])
def test_derivative_is_that_of_the_turn(scheme, chunk):
    """(N3), (N4) against central differences of the turns, whose own code has no J."""
    y = RNG.standard_normal((2, 400, 3)).cumsum(axis=1) * 0.2
    first = np.array([3, 100, 220])
    last = first + np.array([90, 60, 77])
    made = path_statistics(y, np.full(400, 0.01), first, last, scheme, chunk)
    found = rotations(made, MATRICES, BIASES)
    ends = final_rotations(made, MATRICES, BIASES)
    np.testing.assert_allclose(found.C, ends, atol=1e-13)
    h = 1e-6
    for p in range(12):
        ends = []
        for s in (h, -h):
            values = np.concatenate([MATRICES.reshape(2, 9), BIASES], axis=1)
            values[:, p] += s
            matrices = values[:, :9].reshape(2, 3, 3)
            ends.append(final_rotations(made, matrices, values[:, 9:]))
        turned = ends[0] @ np.swapaxes(ends[1], -1, -2)
        theta = Rotation.from_matrix(turned.reshape(-1, 3, 3)).as_rotvec() / (2 * h)
        # rounding 1e-16 / 2e-6 and h^2 of the third derivative
        np.testing.assert_allclose(
            found.slopes[..., p], theta.reshape(2, 3, 3), atol=5e-9 * 4.0
        )


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("chunk", [1, 4])
def test_a_centre_is_a_bias(scheme, chunk):
    """Readings and bias less a centre turn alike: (N1) is an identity in it, merged or
    not. Turns of some ten radians round by 1e-15 each, in sums of a hundred."""
    y = RNG.standard_normal((2, 200, 3)).cumsum(axis=1) * 0.2
    centre = 3.0 * RNG.standard_normal((2, 3))
    told = np.full(200, 0.01), np.array([3, 90]), np.array([80, 180]), scheme, chunk
    ends = final_rotations(path_statistics(y, *told), MATRICES, BIASES)
    centred = path_statistics(y, *told, centre)
    found = final_rotations(centred, MATRICES, BIASES - centre)
    np.testing.assert_allclose(found, ends, rtol=0, atol=1e-12)


# time stamps


@pytest.mark.ci
def test_error_bars_hold_with_the_jitter_that_is_stated():
    """NEES of twelve; one false alarm in 1e4, and the jitter left out is seen."""
    trials, jitter, walk, std = 16, 1e-3, 1e-4, 1e-3
    time, rate, rests, attitudes = rolled(GENERIC, hold=50, move=100)
    up, rng, truth = attitudes.inv().apply(FIRST_UP), np.random.default_rng(1), []
    truth = np.concatenate([M.ravel(), GYROSCOPE.B])
    found = {jitter: [], 0.0: []}
    for _ in range(trials):
        clock = time + jitter * rng.standard_normal(len(time))
        y = GYROSCOPE.distort(rate, rng) + 10 * walk * rng.standard_normal(rate.shape)
        poses = ACCELEROMETER.distort(9.81 * up, rng)
        poses = poses + std * rng.standard_normal(poses.shape)
        for stated, values in found.items():
            fit = gyroscope_of(
                inter_rest_rotations(clock, y, rests, chunk=2), poses,
                calibrate(poses, 9.81), pose_std=std, angle_random_walk=walk,
                clock_jitter=stated, start=np.eye(3), estimator="generalised",
            )  # fmt: skip
            values.append(squares(fit.parameters - truth, fit.own_covariance))
    limit = stats.norm.isf(5e-5) * np.sqrt(2.0 * 12.0 / trials)
    assert abs(np.mean(found[jitter]) - 12.0) < limit
    assert np.mean(found[0.0]) > 12.0 + limit  # power


def test_a_lost_row_of_a_move_is_between_its_neighbours():
    """A rate that grows linearly loses nothing; the last row alone leaves 6e-4."""
    time = 0.01 * np.arange(400)
    ramp = np.clip(time - 1.0, 0.0, 1.0) * np.clip(3.0 - time, 0.0, 1.0)
    rates = ramp[:, None] * [1.0, -2.0, 0.5]
    rests = np.array([[0, 90], [310, 400]])
    whole = inter_rest_rotations(time, rates, rests)
    keep = np.delete(np.arange(400), [120, 140, 141, 160, 180])
    found = inter_rest_rotations(time[keep], rates[keep], np.searchsorted(keep, rests))
    turned = [m.statistics[..., :3, :].sum(axis=-1) for m in (whole, found)]
    assert np.abs(turned[1] - turned[0]).max() < 1e-4 * np.abs(turned[0]).max()


# limits

STEP, ROWS, CLOSE = 0.01, 56, 1e-6  # the last of a limit
RESTS = [[0, 12], [22, 34], [44, 56]]


def readings():
    return 1.0 + 0.1 * np.random.default_rng(5).standard_normal((ROWS, 3))


def clock(row=None, steps=1.0):
    """A clock with one step so many times as long."""
    every = np.full(ROWS, STEP)
    if row is not None:
        every[row] = steps * STEP
    return np.cumsum(every)


@pytest.mark.parametrize(("row", "move"), [(17, 0), (39, 1)])
def test_a_hole_in_a_move_is_three_and_a_half_steps(row, move):
    def moves(row, steps, **how):
        return inter_rest_rotations(clock(row, steps), readings(), RESTS, **how)

    whole, found = moves(row, 3.5 * (1 - CLOSE)), moves(row, 3.5 * (1 + CLOSE))
    assert whole.before.tolist() == [0, 1]
    assert whole.left_out == ""
    assert found.before.tolist() == [1 - move]
    assert found.left_out.endswith(f"between rests {move} and {move + 1}")
    kept = whole.statistics[:, 1 - move : 2 - move]
    np.testing.assert_array_equal(found.statistics, kept)
    np.testing.assert_array_equal(found.rest_rates, whole.rest_rates)
    # in the middle of a rest it hides no turn; the margin's rows belong to the move
    assert moves(28, 10.0, margin=2).before.tolist() == [0, 1]
    assert moves(32, 10.0, margin=2).before.tolist() == [0]
    every = clock(17, 10.0) + clock(39, 10.0)
    with pytest.raises(RefusedError, match="missing in each of the 2 rotations"):
        inter_rest_rotations(every, readings(), RESTS)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_reading_at_the_end_of_the_range_is_refused_in_a_move_only(sign):
    y = readings()
    y[17, 1] = 2.5 * sign
    inter_rest_rotations(clock(), y, RESTS, full_scale=2.5 + CLOSE)
    with pytest.raises(SaturatedError, match="in row 17"):
        inter_rest_rotations(clock(), y, RESTS, full_scale=2.5)
    y[17, 1], y[28, 1] = 1.0, 2.5 * sign  # in the middle of a rest
    inter_rest_rotations(clock(), y, RESTS, full_scale=2.5, margin=2)


@pytest.mark.parametrize(("margin", "inner"), [(0, 0), (2, 2), (4, 4), (10, 4)])
def test_rests_are_the_means_of_their_inner_rows(margin, inner):
    """A move reaches into a rest by the margin, by a third of the rest at most."""
    y, time = readings(), clock()
    found = inter_rest_rotations(time, y, RESTS, margin=margin)
    # nothing moves before the first rest, nor after the last one
    parts = [(0, 12 - inner), (22 + inner, 34 - inner), (44 + inner, 56)]
    means = np.array([y[a:b].mean(axis=0) for a, b in parts])
    np.testing.assert_allclose(found.rest_rates[0], means, rtol=16 * EPS)
    np.testing.assert_allclose(found.centre[0], means.mean(axis=0), rtol=16 * EPS)
    seconds = [STEP * (b - a) for a, b in parts]
    middles = [0.5 * (time[a] + time[b - 1]) for a, b in parts]
    # a clock that is summed up has a few roundings of its own
    np.testing.assert_allclose(found.rest_seconds, seconds, rtol=1e-12)
    np.testing.assert_allclose(found.rest_times, middles, rtol=1e-12)
    # from the last row of a rest's inner part to the first of the next one's
    ends = [(11 - inner, 22 + inner), (33 - inner, 44 + inner)]
    lengths = [time[b] - time[a] for a, b in ends]
    np.testing.assert_allclose(found.seconds, lengths, rtol=1e-12)
    # white noise: half the mean square of neighbouring differences, over the rate
    steps = np.concatenate([np.diff(y[a:b], axis=0) for a, b in parts])
    white = np.sqrt(0.5 * np.mean(steps**2, axis=0) * STEP)
    np.testing.assert_allclose(found.white[0], white, rtol=1e-12)


def test_between_mean_attitudes_is_what_the_attitudes_say():
    """Rests that creep by half a degree: the mean attitudes by quaternions of all rows.

    Rotations in a rest commute to a half of the square of what it turns, 4e-5 rad."""
    time, rate, rests, _ = rolled(GENERIC[:4], hold=60, move=80)
    for k, (a, b) in enumerate(rests):
        rate[a:b] = np.radians([0.4, -0.2, 0.3]) * (-1) ** k / (0.01 * (b - a))
    turned = Rotation.concatenate([Rotation.identity()])
    every = [turned := turned * Rotation.from_rotvec(0.01 * w) for w in rate]
    means = [Rotation.concatenate(every[a:b]).mean() for a, b in rests]
    expected = Rotation.concatenate([one.inv() * two for one, two in pairwise(means)])
    off = {}
    for between in (False, True):
        found = inter_rest_rotations(time, rate, rests, means=between)
        C = final_rotations(found.statistics, np.eye(3)[None], -found.centre)
        angles = expected.inv() * Rotation.from_matrix(C[0])
        off[between] = angles.magnitude().max()
    assert off[True] < 4e-5 < 4e-3 < off[False]
    # half of each rest, and the move
    half = 0.5 * np.diff(rests)[:, 0] - 0.5
    seconds = 0.01 * (half[1:] + half[:-1] + rests[1:, 0] - rests[:-1, 1] + 1)
    np.testing.assert_allclose(found.seconds, seconds, rtol=1e-12)
