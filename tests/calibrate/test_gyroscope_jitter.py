"""Time stamps that are off: what they add to the turn of a move, and its error bars."""

import numpy as np
import pytest
import scipy

from simval.calibrate import calibrate, calibrate_gyroscope, moves_between
from simval.calibrate.gyroscope.covariance import GyroscopeNoise, jitter_noise
from simval.calibrate.gyroscope.turn import turn
from simval.errors import InputError
from simval.poses import fibonacci_sphere
from simval.sensor import AccelerometerModel, GyroscopeModel
from simval.streams import cell_key, stream
from simval.turns import turns_of

KEY = cell_key("test gyroscope jitter")
STEP, MOVE, REST, G = 0.01, 100, 50, 9.80665
WALK, POSE_STD = 1e-4, 1e-3
M = np.array([[1.02, 0.02, -0.01], [0.03, 1.03, 0.02], [0.0, 0.01, 1.0]])
SENSOR = GyroscopeModel(M=M, B=np.array([0.02, -0.01, 0.03]), angle_random_walk=WALK)


def tumble(directions):
    """Time, mean rates over the steps of moves of a second, and the rests."""
    axis, angle = turns_of(directions)
    s = np.linspace(0.0, 1.0, MOVE + 1)
    course = np.diff(s**3 * (10.0 + s * (6.0 * s - 15.0))) / STEP
    still = np.zeros((REST, 3))
    parts = [still]
    for a, b in zip(axis, angle, strict=True):
        parts += [course[:, None] * a * b, still]
    rate = np.concatenate(parts)
    starts = np.arange(len(directions)) * (MOVE + REST)
    rests = np.stack([starts, starts + REST], axis=1)
    return np.arange(len(rate)) * STEP, rate, rests


def told(jitter):
    return GyroscopeNoise(
        angle_random_walk=np.zeros(3),
        bias_random_walk=0.0,
        clock_jitter=jitter,
        pose_std=np.zeros((1, 3)),
    )


@pytest.mark.ci
@pytest.mark.parametrize("chunk", [1, 2, 4])
def test_the_turn_of_a_move_scatters_as_predicted(chunk):
    """Every row as it was and every stamp drawn, against the closed form."""
    jitter, draws = 3e-4, 30
    time, rate, rests = tumble(fibonacci_sphere(9))
    clean = GyroscopeModel(M=M, B=SENSOR.B)
    rows, rng = clean.distort(rate, np.random.default_rng(0)), stream(1, KEY, 0)

    def ends(clock):
        moves = moves_between(clock, rows, rests, chunk=chunk, margin=5)
        B = SENSOR.B - moves.centre
        return moves, turn(moves.statistics, M[None], B), B

    moves, true, B = ends(time)
    predicted = jitter_noise(true, moves, M[None], B, told(jitter))[0]
    rotation = scipy.spatial.transform.Rotation
    theta = np.array(
        [
            rotation.from_matrix(
                ends(time + jitter * rng.standard_normal(len(time)))[1].C[0]
                @ np.swapaxes(true.C[0], -1, -2)
            ).as_rotvec()
            for _ in range(draws)
        ]
    )
    # moves share no stamps; each turns about one axis, so its error has one direction,
    # and the 8 x 30 squares of it over their variance are a chi-square; one false
    # alarm in 1e4 for each chunk; evenness over a chunk of c steps is good to
    # (c pi/100)^2/6, as a sine of that wavelength is
    along = np.linalg.eigh(predicted)[1][:, :, -1]
    size = np.einsum("dki,ki->dk", theta, along)
    share = size**2 / np.trace(predicted, axis1=-2, axis2=-1)
    n = share.size
    low, high = scipy.stats.chi2.ppf([5e-5, 1.0 - 5e-5], n) / n
    even = (chunk * np.pi / MOVE) ** 2 / 6.0
    assert low - even < share.mean() < high + even
    # across it nothing to first order
    assert (theta**2).sum() < 1.02 * (size**2).sum()


def error_squares(jitter, stated, trials):
    directions = fibonacci_sphere(20)
    time, rate, rests = tumble(directions)
    values = np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
    force = AccelerometerModel.from_parameters(values, noise_std=POSE_STD)
    truth = np.concatenate([SENSOR.M.ravel(), SENSOR.B])
    rng, found = stream(1, KEY, 1), []
    for _ in range(trials):
        clock = time + jitter * rng.standard_normal(len(time))
        rows = SENSOR.distort(rate, rng, timestep=STEP)
        poses = force.distort(G * directions, rng)
        fit = calibrate_gyroscope(
            moves_between(clock, rows, rests, chunk=2),
            poses,
            calibrate(poses, G),
            pose_std=POSE_STD,
            angle_random_walk=WALK,
            clock_jitter=stated,
            start=np.eye(3),
            estimator="generalised",
        )
        error = fit.parameters - truth
        found.append(error @ np.linalg.solve(fit.own_covariance, error))
    return np.array(found)


@pytest.mark.ci
def test_error_bars_hold_with_the_jitter_that_is_stated():
    """NEES of twelve; one false alarm in 1e4, and the jitter left out is seen."""
    trials, jitter = 8, 1e-3
    limit = scipy.stats.norm.isf(5e-5) * np.sqrt(2.0 * 12.0 / trials)
    assert abs(error_squares(jitter, jitter, trials).mean() - 12.0) < limit
    assert error_squares(jitter, 0.0, trials).mean() > 12.0 + limit  # power


@pytest.mark.parametrize("value", [-1e-4, np.nan, np.inf, "late"])
def test_a_jitter_that_is_none(value):
    directions = fibonacci_sphere(12)
    time, rate, rests = tumble(directions)
    moves = moves_between(time, rate, rests)
    poses = G * directions
    with pytest.raises(InputError, match="clock_jitter"):
        calibrate_gyroscope(
            moves, poses, calibrate(poses, G), pose_std=1e-3, clock_jitter=value
        )
