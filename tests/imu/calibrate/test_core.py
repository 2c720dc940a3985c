"""The calibration core: rows of each block, blocks left out, and a sensor added."""

from dataclasses import replace

import numpy as np
import pytest
from magnetometer_sets import BODY, BODY_STD, FIELD, IRON, IRON_STD, G, random_set
from nine_axes import DIP, fields_of
from scipy import stats
from tumbles import ACCELEROMETER, GYROSCOPE, WALK, M, tumble

from simval.imu.calibrate import calibrate
from simval.imu.calibrate.equations import (
    Accelerometer,
    Equation,
    Magnetometer,
    Problem,
    Sensor,
    minimize,
    weighed,
)
from simval.imu.calibrate.estimate import NORMAL_95
from simval.imu.calibrate.gyroscope import moves_between
from simval.imu.calibrate.gyroscope.noise import noise_of
from simval.imu.calibrate.gyroscope.residuals import InterRest
from simval.imu.sensor import MODELS, forms
from simval.theory.plans import error_bars, next_best

FORTY = random_set(40, 5)


def pair(model="triangular", trials=2, *, off=0.01, poses=FORTY, noise=1.0):
    """Two sensors with noise, and parameters away from their solution."""
    rng = np.random.default_rng(2)
    body, iron = poses.noisy(trials, rng, noise * BODY_STD, noise * IRON_STD)
    std = [np.full(body.shape, each) for each in (BODY_STD, IRON_STD)]
    problem = Problem(
        sensors=(
            Accelerometer(readings=body, std=std[0], model=model),
            Magnetometer(readings=iron, std=std[1]),
        )
    )
    own, _ = forms.convert(BODY.parameters, None, source="triangular", target=model)
    own[slice(0, 6) if model == "symmetric" else slice(3, 6)] /= G
    iron = [*(IRON.M / FIELD).ravel(), *IRON.b, np.sin(DIP)]
    theta = np.r_[own, iron] * (1.0 + off * rng.standard_normal((trials, 22)))
    return problem, theta


def values(problem, theta):
    """Equations of the rests, not whitened."""
    told = problem.equations(problem.corrected(theta), theta)
    return np.stack([each.value for _, each in told], axis=-1)


@pytest.mark.parametrize("model", MODELS)
def test_rows_are_differentiated_by_parameters_and_readings(model, unchecked):
    """Complex steps: exact, and they share no code with the chain rule."""
    problem, theta = pair(model)
    _, J, L = problem.rests(problem.corrected(theta), theta)
    for k, e in enumerate(np.eye(22)):
        exact = values(problem, theta + 1e-30j * e).imag / 1e-30
        # some products of numbers near 1, or near 200 counts
        np.testing.assert_allclose(J[..., k], exact, rtol=1e-13, atol=1e-12)
    for s, sensor in enumerate(problem.sensors):
        for axis, e in enumerate(np.eye(3)):
            moved = replace(sensor, readings=sensor.readings + 1e-30j * e)
            sensors = (*problem.sensors[:s], moved, *problem.sensors[s + 1 :])
            slope = values(Problem(sensors=sensors), theta).imag / 1e-30
            exact = slope * sensor.std[..., axis, None]
            np.testing.assert_allclose(L[..., 3 * s + axis], exact, atol=1e-15)
    white = problem.local(theta).white @ L
    one = white @ np.swapaxes(white, -1, -2)
    np.testing.assert_allclose(one, np.broadcast_to(np.eye(3), one.shape), atol=1e-12)


def with_turns(*, walk, bias_std=None):
    """Three sensors without noise, and the truth."""
    truth = tumble(12, move_time=1.5, first_hold=1.0, hold_time=0.5)
    quiet = np.random.default_rng(0)  # draws nothing
    poses = ACCELEROMETER.distort(truth.directions, quiet)[None]
    rows = GYROSCOPE.distort(truth.rate, quiet)[None]
    moves = moves_between(truth.time, rows, truth.intervals, chunk=1)
    noise = noise_of(moves, bias="constant", angle_random_walk=walk, bias_std=bias_std)
    fields = fields_of(truth)[None]
    problem = Problem(
        sensors=(
            Accelerometer(
                readings=poses, std=np.full(poses.shape, 1e-3), model="triangular"
            ),
            Magnetometer(readings=fields, std=np.full(fields.shape, IRON_STD)),
        ),
        turns=InterRest(moves=moves, noise=noise, each=3),
    )
    own = np.array(ACCELEROMETER.parameters)
    own[3:6] /= truth.g
    iron = [*(IRON.M / FIELD).ravel(), *IRON.b, np.sin(DIP)]
    gyroscope = [*M.ravel(), *(GYROSCOPE.B - moves.centre[0])]
    return problem, np.array([[*own, *iron, *gyroscope]])


def raw(problem, theta):
    """Rows, not whitened."""
    here = problem.local(theta)
    return np.linalg.solve(here.white[0], here.rows[0])


@pytest.mark.ci
def test_rows_of_the_turns_are_differentiated():
    """Central differences at the truth, where the rows are zero and E drops out."""
    problem, theta = with_turns(walk=WALK)
    here = problem.local(theta)
    J = np.linalg.solve(here.white[0], here.slopes[0])
    h, rng = 1e-5, np.random.default_rng(2)
    size = np.r_[np.ones(9), np.full(9, 1e-3), np.full(3, 100.0), np.ones(13)]
    for unit in rng.standard_normal((4, 34)) * size:  # any column that is wrong shows
        ends = [raw(problem, theta + s * h * unit) for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * h)
        # h^2 over 6 of a third derivative of some tens; moves turn by radians, and at
        # 100 Hz the rows are not zero but 1e-6, by which E counts
        scale = max(1.0, np.abs(slope).max())
        np.testing.assert_allclose(J @ unit, slope, rtol=0, atol=1e-5 * scale)


@pytest.mark.ci
def test_covariance_of_the_rows_counts_each_pose_once():
    """V is what unit noise of each reading does to all rows, by differences."""
    problem, theta = with_turns(walk=1e-9, bias_std=1e-7)
    white = problem.local(theta).white[0]
    V = np.linalg.inv(white) @ np.linalg.inv(white).T
    columns = []
    for s, (sensor, h) in enumerate(zip(problem.sensors, (1e-5, 1e-3), strict=True)):
        for at in np.ndindex(sensor.readings.shape):
            ends = []
            for sign in (1.0, -1.0):
                other = sensor.readings.copy()
                other[at] += sign * h
                sensors = list(problem.sensors)
                sensors[s] = replace(sensor, readings=other)
                moved = replace(problem, sensors=tuple(sensors))
                ends.append(raw(moved, theta))
            columns.append((ends[0] - ends[1]) / (2 * h) * sensor.std[at])
    L = np.array(columns).T
    inter_rest = 3 * problem.turns.item[0]
    every = np.r_[0:inter_rest, inter_rest + 3 : len(V)]  # all but the rows of the bias
    sd = np.sqrt(np.diagonal(V))[every]
    shown = V[np.ix_(every, every)] / np.outer(sd, sd)
    off = shown - (L @ L.T)[np.ix_(every, every)] / np.outer(sd, sd)
    # the rows at 100 Hz are not zero but 1e-6, by which their axes turn with a reading
    assert np.abs(off).max() < 3e-6
    # power: neighbouring rotations share the field of a pose, and with poses readings
    assert np.diagonal(shown[2:inter_rest:3, 5:inter_rest:3]).max() < -0.4
    assert np.abs(shown[:inter_rest, inter_rest:]).max() > 0.05


@pytest.mark.parametrize("model", MODELS)
def test_the_accelerometer_alone_is_its_fit_by_moments(model):
    """All other blocks left out: the same as the fast case, and its covariance."""
    problem, theta = pair(model, 5, off=0.0)
    alone = Problem(sensors=problem.sensors[:1])
    found = minimize(alone, theta[:, :9], 30)
    assert found.converged.all()
    fit = calibrate(
        alone.accelerometer.readings, 1.0, model, residual="weighted",
        noise_std=BODY_STD, tolerance=1e-13,
    )  # fmt: skip
    # both end within 1e-8 of a step that shrinks a thousandfold
    assert np.abs((found.theta - fit.parameters) / fit.sd).max() < 1e-9
    covariance, _ = alone.local(found.theta).covariance()
    size = fit.sd[:, :, None] * fit.sd[:, None]
    # (U1) is the same at the minimum of the weighted residual
    assert np.abs((covariance - fit.covariance) / size).max() < 1e-8


def test_each_trial_is_handed_back_as_if_it_were_alone():
    """The linearisation of trials that end after other numbers of steps."""
    problem, theta = pair(trials=3, off=0.0)
    off = np.array([0.1, 1e-9, 0.01])[:, None]
    start = theta * (1.0 + off * np.random.default_rng(3).standard_normal((3, 22)))
    found = minimize(problem, start, 30)
    assert found.iterations[0] > found.iterations[1] < found.iterations[2]
    for k in range(3):
        alone = minimize(problem.take([k]), start[[k]], 30)
        for name in ("rows", "slopes", "L", "white"):
            both = (getattr(each.here, name) for each in (found, alone))
            np.testing.assert_array_equal(next(both)[k], next(both)[0])


@pytest.mark.ci
def test_rows_that_are_handed_back_are_those_of_the_end():
    """They are normal to their slopes, though these are of a point before."""
    problem, theta = with_turns(walk=WALK)
    start = theta * (1.0 + 1e-3 * np.random.default_rng(3).standard_normal((1, 34)))
    found = minimize(problem, start, 30)
    assert found.converged.all()
    here = found.here
    size = np.linalg.norm(here.slopes[0], axis=0)
    # the last step is below 1e-8 standard deviations of any combination
    assert np.abs(here.rows[0] @ here.slopes[0] / size).max() < 1e-7
    assert np.abs(here.rows).max() > 1e-3  # power: of chunks at 100 Hz


# a fourth sensor: an inclinometer of two axes, z = A u + b


class Inclinometer(Sensor):
    name = "inclinometer"
    size = 8  # rows of A, and b

    def equations(self, w, theta):
        u, (t, n, _) = w["accelerometer"], self.readings.shape
        A, b = theta[:, :6].reshape(-1, 2, 3), theta[:, None, 6:]
        off = u @ np.swapaxes(A, 1, 2) + b - self.readings
        rows = []
        for i in range(2):
            own, noise = np.zeros((t, n, 8)), np.zeros((t, n, 2))
            own[..., 3 * i : 3 * i + 3], own[..., 6 + i] = u, 1.0
            noise[..., i] = -self.std[..., i]
            by = {"accelerometer": np.broadcast_to(A[:, None, i], u.shape)}
            rows.append(Equation(off[..., i], by, own, noise))
        return rows


def inclined(poses=FORTY, trials=1, noise=1.0, told=1.0):
    """All three sensors in these poses, and their parameters."""
    problem, theta = pair(trials=trials, off=0.0, poses=poses, noise=noise)
    rng = np.random.default_rng(4)
    A, b = rng.standard_normal((2, 3)), rng.standard_normal(2)
    z = BODY.correct(poses.body) / G @ A.T + b
    z = z + noise * 1e-4 * rng.standard_normal((trials, *z.shape))
    own = Inclinometer(readings=z, std=np.full(z.shape, 1e-4 * told))
    return Problem(sensors=(*problem.sensors, own)), np.r_[theta[0], A.ravel(), b]


def test_a_fourth_sensor_gets_fit_bound_coverage_and_plan():
    problem, truth = inclined(trials=300)
    found = minimize(problem, np.tile(1.01 * truth, (300, 1)), 30)
    at_truth, other_poses = (
        inclined(poses, noise=0.0)[0].local(truth[None])
        for poses in (FORTY, random_set(60, 8))
    )
    bound = error_bars(at_truth.information.sum(axis=0))
    held = np.abs(found.theta - truth) < NORMAL_95 * found.here.sd
    now, after, best = next_best(at_truth, other_poses, slice(22, None))

    # the core gave all of that; what follows only judges it
    assert found.converged.all()
    off, here = found.theta - truth, found.here
    squares = np.vecdot(off, np.matvec(here.normal, off))
    # means of 300 chi-squares, 4.5 of their standard errors
    for each, dof in ((squares, 30), (here.chi_square, 5 * 40 - 30)):
        assert abs(each.mean() - dof) < 4.5 * np.sqrt(2 * dof / 300)
    low, high = stats.binom.ppf([1e-4 / 60, 1.0 - 1e-4 / 60], 300, 0.95)
    count = np.count_nonzero(held, axis=0)
    assert np.all((low <= count) & (count <= high))
    # 300 errors tell a deviation to a 24th
    seen = np.sqrt(np.mean(off**2, axis=0)) / bound
    assert np.all(np.abs(seen - 1.0) < 4.5 / np.sqrt(600))
    # no other pose would help more: each is tried whole, together with the forty
    more, tried = random_set(60, 8), []
    for k in range(60):
        body = np.vstack([FORTY.body, more.body[k]])
        iron = np.vstack([FORTY.iron, more.iron[k]])
        whole, _ = inclined(replace(FORTY, body=body, iron=iron), noise=0.0)
        tried.append(whole.local(truth[None]).sd[0])
    np.testing.assert_allclose(error_bars(after), tried[best], rtol=1e-9)
    # M is of a field over counts, so what is told of b in counts is little beside it
    *_, of_M = next_best(at_truth, other_poses, slice(9, 18))
    for number, wanted in ((best, slice(22, None)), (of_M, slice(9, 18))):
        total = np.sum(np.square(tried)[:, wanted], axis=1)
        assert total[number] <= total.min() * (1.0 + 1e-9)
    np.testing.assert_allclose(error_bars(now), bound)


def test_a_fourth_sensor_gets_its_honesty():
    """Its noise is stated five times too small: it is blamed, and it alone."""
    problem, truth = inclined(told=0.2)
    found = minimize(problem, truth[None], 30)
    *_, noise = weighed(problem, found, 30)
    assert noise.sources == ("accelerometer", "magnetometer", "inclinometer")
    assert problem.names[8:10] == ("B_z", "magnetometer M_xx")
    np.testing.assert_array_equal(noise.factor[:2], 1.0)
    # a scatter of 72 degrees of freedom is known to a twelfth
    assert abs(noise.factor[2] / 5.0 - 1.0) < 4.0 / 12.0
    # in stated deviations: of two rows a rest, chi-squares of two by what was found
    squares = (noise.sensors[2].deviations / noise.factor[2]) ** 2
    assert abs(squares.mean() - 2.0) < 4.5 * 2.0 / np.sqrt(40)
    assert noise.p_value < 1e-3
