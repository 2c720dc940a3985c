"""The calibration core: rows of each block, blocks left out, and a sensor added."""

from dataclasses import replace

import numpy as np
import pytest
from magnetometer_sets import BODY, BODY_STD, FIELD, IRON, IRON_STD, G, random_set
from nine_axes import DIP
from scipy import stats

from simval.imu.calibrate.equations import (
    Accelerometer,
    Equation,
    Magnetometer,
    Problem,
    Sensor,
)
from simval.imu.calibrate.gauss_newton import TOLERANCE, minimize
from simval.imu.sensor import MODELS, forms
from simval.imu.sensor.readable import NORMAL_95
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


def test_a_fit_ends_where_no_step_is_left():
    """The last step is not made where two show that it will be a tenth of `TOLERANCE`;
    it must be less than that."""
    problem, theta = pair(trials=20)
    found = minimize(problem, theta, 30)
    assert found.converged.all()
    here = problem.local(found.theta)
    step = here.step(here.rows, np.zeros(20))
    assert np.linalg.norm(np.matvec(here.slopes, step), axis=1).max() < TOLERANCE


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
