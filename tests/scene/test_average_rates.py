"""Rates of a scene are averages over a step, and give its attitudes back."""

import numpy as np
import pytest
from scipy.integrate import fixed_quad
from scipy.spatial.transform import Rotation

from simval.errors import InputError
from simval.imu.logs import Rows
from simval.scene import average_rates, scenes, simulate
from simval.scene.drivers import minimum_jerk
from simval.scene.trajectory import gyroscope_rows, increments
from simval.vocabulary import ROW_KINDS

FROM, TO = np.array([0.3, -0.5, 1.1]), np.array([-1.9, 0.8, -1.4])


def attitude(t):
    """Sensor to world of a move of one second, three Euler angles at once."""
    return Rotation.from_euler("ZYX", FROM + minimum_jerk(t)[:, None] * (TO - FROM))


def body_rate(t):
    """Its body rate by the kinematics of Euler angles, no attitude in it."""
    angles = FROM + minimum_jerk(t)[:, None] * (TO - FROM)
    speed = 30.0 * t**2 * (1.0 - t) ** 2
    yaw, pitch, roll = (speed[:, None] * (TO - FROM)).T
    _, theta, phi = angles.T
    return np.stack(
        [
            roll - yaw * np.sin(theta),
            pitch * np.cos(phi) + yaw * np.cos(theta) * np.sin(phi),
            yaw * np.cos(theta) * np.cos(phi) - pitch * np.sin(phi),
        ],
        axis=1,
    )


def integrated(rates, h):
    """Turn of averages, each with the coning of its two neighbours, by SciPy."""
    S = rates * h
    wide = np.concatenate([2 * S[:1] - S[1:2], S, 2 * S[-1:] - S[-2:-1]])
    phi = S + (np.cross(wide[:-2], S) + np.cross(S, wide[2:])) / 24.0
    turns = Rotation.from_rotvec(phi)
    while len(turns) > 1:  # neighbours first, in pairs
        odd = Rotation.identity(len(turns) % 2)
        turns = Rotation.concatenate([turns, odd])
        turns = turns[::2] * turns[1::2]
    return turns[0]


def test_averages_are_the_integral_of_the_rate_to_fourth_order():
    """Against Gauss quadrature of the analytic body rate: halving h gives 1/16."""
    error = []
    for n in (50, 100, 200, 400):
        t = np.arange(n + 1) / n
        exact = np.array(
            [
                fixed_quad(lambda x: body_rate(x).T, a, a + 1 / n, n=8)[0] * n
                for a in t[:-1]
            ]
        )
        S = increments(attitude(t).as_quat()) * n
        inside = slice(2, -2)  # the rate is a parabola there, not at the ends
        error.append(np.abs(S - exact)[inside].max())
    slopes = np.log2(np.array(error[:-1]) / error[1:])
    np.testing.assert_allclose(slopes, 4.0, atol=0.2)
    assert error[-1] < 2e-6


@pytest.mark.parametrize("name", sorted(scenes()))
def test_rates_of_every_scene_give_its_attitude_back(name, trajectories):
    trajectory = trajectories(name)
    h = trajectory.time[1] - trajectory.time[0]
    whole = Rotation.from_quat(trajectory.attitude)
    total = integrated(average_rates(trajectory)[1:], h)
    off = (total.inv() * whole[0].inv() * whole[-1]).magnitude()
    assert off < 1e-10  # rounding of each step, and of the clock's


@pytest.mark.parametrize("every", [2, 5])
def test_a_sensor_read_less_often_adds_increments(every, trajectories):
    trajectory = trajectories("gimbal")
    time = trajectory.time[::every]
    rates = average_rates(trajectory, every)
    assert rates.shape == (len(time), 3)
    full = average_rates(trajectory)[1:] * np.diff(trajectory.time)[:, None]
    some = rates[1:] * np.diff(time)[:, None]
    count = (len(time) - 1) * every
    np.testing.assert_allclose(
        some, full[:count].reshape(-1, every, 3).sum(axis=1), atol=1e-15
    )
    np.testing.assert_array_equal(rates[0], rates[1])


@pytest.mark.parametrize("name", ["gimbal", "freefall"])
@pytest.mark.parametrize("kind", ROW_KINDS)
@pytest.mark.parametrize("delay", [0.0, 0.006, -0.003])
def test_rows_of_a_kind_turn_by_what_averages_turn_by(name, kind, delay, trajectories):
    """Back to averages by their own splines: through five steps, not through one."""
    trajectory, rows = trajectories(name), Rows(kind=kind, delay=delay)
    time, exact = trajectory.time[::5], average_rates(trajectory, 5)
    found = rows.means(time, gyroscope_rows(trajectory, 5, rows))
    there = np.isfinite(found).all(axis=1)
    assert np.count_nonzero(~there) <= 2  # at the ends
    size = np.sqrt(np.mean(exact**2))
    # the third order in a step at the least, of moves of a second; less at the ends
    assert np.sqrt(np.mean((found - exact)[3:-3] ** 2)) < 1e-4 * size
    # and rows of another kind, or late ones, are not these
    raw = gyroscope_rows(trajectory, 5, rows)
    assert (np.abs(raw - exact).max() > 1e-3 * size) == (rows != Rows())


def test_what_cannot_be_told_is_refused(trajectories):
    trajectory = trajectories("gimbal")
    for every in (0, -1, len(trajectory.time)):
        with pytest.raises(InputError, match="`every`"):
            average_rates(trajectory, every)
    spun = Rotation.from_rotvec(np.outer(np.arange(5), [0.0, 0.0, 1.5])).as_quat()
    with pytest.raises(InputError, match=r"1\.5 rad in one step"):
        increments(spun)


@pytest.fixture(scope="module")
def trajectories():
    """Short runs of the scenes, each simulated once."""
    short = {
        "gimbal": {"poses": 3, "first_hold": 0.1, "hold_time": 0.1},
        "handheld": {"poses": 3, "first_hold": 0.1, "hold_time": 0.1},
        "shaker": {"poses": 2, "hold_time": 0.1},
        "die": {"poses": 2},
        "cube": {"poses": 2},
        "pivot": {"turns": 0.05, "poses": 2},
        "freefall": {"seconds": 2.0},
    }
    made = {}

    def get(name):
        if name not in made:
            made[name] = simulate(name, **short[name])
        return made[name]

    return get
