"""Trajectories: what they claim, their clock, and two negative controls."""

import json
from itertools import product

import mujoco
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from simval.cli import run
from simval.errors import InputError, RefusedError, SimulationError
from simval.geometry import attitude_matrix
from simval.imu.calibrate import calibrate
from simval.imu.calibrate.solver import METHODS
from simval.imu.sensor import AccelerometerModel
from simval.poses import cube_corners, cube_faces, fibonacci_sphere, observability
from simval.scene import scenes, simulate
from simval.scene.physics import load_model
from simval.scene.run import CLOCK_TOLERANCE, is_regular

G = 9.80665
QUICK = {"move_time": 0.5, "hold_time": 0.1, "first_hold": 0.1}


@pytest.fixture(scope="module")
def gimbal():
    return simulate("gimbal")


def test_a_rest_reads_g_along_the_chosen_direction(gimbal):
    means = gimbal.hold_means()
    assert means.shape == (40, 3)
    # rest_force is the scene's own bound; 2 eps g for the mean's rounding
    assert np.abs(np.linalg.norm(means, axis=1) - G).max() <= 1e-12
    # the servo's gravity torque is zero on a balanced gimbal, so it reaches the
    # chosen pose: 1e-12 relative of settling, 1e-14 of the angles' rounding
    np.testing.assert_allclose(means / G, fibonacci_sphere(40), rtol=0.0, atol=1e-11)


def test_a_row_is_of_one_instant(gimbal):
    """Field, attitude and rests agree row by row; one row later they would not."""
    matrix = attitude_matrix(gimbal.attitude)
    seen = np.einsum("nij,j->ni", matrix, gimbal.magnetic)
    # unit quaternions: a few eps of the field's length
    atol = 16 * np.finfo(float).eps * np.linalg.norm(gimbal.magnetic)
    np.testing.assert_allclose(gimbal.magnetic_field, seen, rtol=0.0, atol=atol)
    late = np.abs(gimbal.magnetic_field[1:] - seen[:-1]).max()
    assert late > 1e6 * atol  # power: a pairing one step off is seen


def test_gyro_is_the_rate_of_the_attitude(gimbal):
    """Independent of MuJoCo's rate: a central difference of the attitude matrix."""
    matrix = attitude_matrix(gimbal.attitude)
    h = gimbal.time[1] - gimbal.time[0]
    derivative = (matrix[2:] - matrix[:-2]) / (2 * h)
    # A(q) takes world to sensor, so A' = -[w x] A and [w x] = -A' A^T
    skew = -derivative @ np.swapaxes(matrix[1:-1], 1, 2)
    rate = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    # remainder h^2/6 |A'''|: |A'''| <= w^3 + 3 w alpha + jerk, about 5e3 rad/s^3 in
    # moves of half a turn per second; the trajectory itself is first order, h alpha/2
    worst = np.abs(rate - gimbal.angular_velocity[1:-1]).max()
    assert worst < h * 100.0
    assert worst > 1e-6  # it is a difference, not the same number twice


def test_clock_and_provenance(gimbal):
    np.testing.assert_allclose(
        # the engine adds up 51 000 steps: eps of 100 s at each, one way at worst
        # (7e-10)
        gimbal.time,
        0.002 * np.arange(len(gimbal.time)),
        rtol=0.0,
        atol=1e-9,
    )
    # the drift of the time above, over its length
    assert gimbal.rate == pytest.approx(500.0, rel=1e-11, abs=0)
    assert gimbal.provenance["mujoco"] == mujoco.__version__
    assert len(gimbal.provenance["model_sha256"]) == 64
    assert gimbal.provenance["parameters"]["poses"] == 40
    for rows in (gimbal.time, gimbal.hold):
        with pytest.raises(ValueError, match="read-only"):
            rows[0] = 1


@pytest.mark.parametrize("directions", [cube_faces(), cube_corners(), [[0, 0, -3.0]]])
def test_any_directions_are_reached(directions):
    trajectory = simulate("gimbal", poses=directions, **QUICK)
    wanted = np.asarray(directions) / np.linalg.norm(directions, axis=1, keepdims=True)
    # the scene's own limit of rest, 1e-12 of g, with room for the mean over a hold
    np.testing.assert_allclose(trajectory.hold_means() / G, wanted, rtol=0, atol=1e-12)


def test_a_rest_that_moves_is_refused_or_left_out():
    with pytest.raises(
        SimulationError, match=r"rest 1 moves at row \d+.*settle longer"
    ):
        simulate("gimbal", poses=3, settle_time=0.05)
    trajectory = simulate("die", poses=12, settle_time=0.7, hold_time=0.3)
    assert 0 < len(trajectory.unsettled) < 12
    assert not np.isin(trajectory.hold, trajectory.unsettled).any()
    with pytest.raises(SimulationError, match="rest 0 moves"):
        simulate("die", poses=3, settle_time=0.1, hold_time=0.1)


def test_the_same_bits_again():
    first, second = (simulate("die", poses=3) for _ in range(2))
    np.testing.assert_array_equal(first.specific_force, second.specific_force)
    other = simulate("die", poses=3, seed=1)
    assert np.any(first.specific_force != other.specific_force)


@pytest.mark.parametrize(
    ("scene", "setting", "words"),
    [
        ("gimbol", {}, "`gimbal`"),
        ("gimbal", {"directions": 3}, "`poses`"),
        ("gimbal", {"poses": 0}, "`poses` is 0"),
        ("gimbal", {"poses": 10**9}, "`poses`"),
        ("gimbal", {"poses": np.full((1, 3), np.nan)}, "`poses`"),
        ("gimbal", {"poses": np.ones((0, 3))}, "with k of 1 or more"),
        ("gimbal", {"poses": np.ones((1, 2, 3))}, "with k of 1 or more"),
        ("gimbal", {"hold_time": float("nan")}, "`hold_time`"),
        ("gimbal", {"timestep": -0.01}, "`timestep`"),
        ("gimbal", {"integrator": "discrete"}, "`integrator`"),
        ("gimbal", {"site_offset": [0, 0]}, "`site_offset`"),
    ],
)
def test_bad_requests_are_refused(scene, setting, words, unchecked):
    with pytest.raises(InputError, match=words):
        simulate(scene, **setting)


@pytest.mark.parametrize(
    ("name", "parameters", "least"),
    [
        ("gimbal", {"poses": 12}, 12),
        ("die", {"poses": 6}, 6),
        ("shaker", {"poses": 5}, 3),
        ("pivot", {"spin_rate": 0.5}, 40),
        ("handheld", {"poses": 6}, 6),
        ("cube", {"poses": 6}, 6),
        ("freefall", {"seconds": 2.0}, 0),
    ],
)
def test_every_scene_keeps_its_own_bound(name, parameters, least):
    trajectory = simulate(name, **parameters)
    rest = trajectory.hold >= 0
    assert len(trajectory.hold_indices()) >= least
    force = np.linalg.norm(trajectory.specific_force[rest], axis=1) - trajectory.g
    rate = np.linalg.norm(trajectory.angular_velocity[rest], axis=1)
    assert np.abs(force).max(initial=0.0) <= trajectory.rest_force
    assert rate.max(initial=0.0) <= trajectory.rest_rate
    planned = set(trajectory.hold_indices()) | set(trajectory.unsettled)
    assert planned == set(range(len(planned)))


def deepest_after(friction, attitude, seconds=1.0):
    """How deep the shaker's die is in its walls, begun 8 mm deep in a corner."""
    model = load_model(scenes()["shaker"].model).model
    model.geom_friction[:, 0] = friction
    data = mujoco.MjData(model)
    balls = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    lowest = (model.geom_pos[balls] @ attitude.as_matrix().T).min(axis=0)
    radius, wall, centre = 0.003, -0.1, np.array([0.0, 0.0, 0.3])
    data.qpos[2:5] = centre + wall + radius - lowest - 0.008
    data.qpos[5:9] = np.roll(attitude.as_quat(), 1)
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    return -min((contact.dist for contact in data.contact), default=0.0)


@pytest.mark.ci
def test_the_shakers_die_does_not_jam_in_a_corner():
    """With a friction of 0.8 two walls held it against the third, until it was through.

    Two walls hold with twice their friction at the most: below 1/2 they let it go.
    """
    rng = np.random.default_rng(20_261_122)
    attitudes = Rotation.random(24, random_state=rng)
    own = load_model(scenes()["shaker"].model).model.geom_friction[:, 0]
    assert own.max() < 0.5
    assert max(deepest_after(own, each) for each in attitudes) < 1e-3
    # the test can fail: what it was before
    assert max(deepest_after(0.8, each) for each in attitudes) > 5e-3


OFF = 1e-9  # relative, of a step that is wrong
ROWS = 10_000


def added(timestep, rows):
    """Time of each row, by one addition after the other."""
    steps = np.full(rows, timestep)
    steps[0] = 0.0
    return np.add.accumulate(steps)


def test_a_long_run_has_a_regular_clock():
    # whose steps drift by 0.43 of what sums are allowed: of random ones none by half
    timestep, rows = 7.935674347825694e-4, 600_000
    clock = added(timestep, rows)
    assert is_regular(clock, timestep).all()
    # power: the constant limit of a millionth of a step would refuse it, or a third
    end = timestep * (rows - 1)
    third = rows * np.spacing(end) / 6.0 + CLOCK_TOLERANCE * timestep
    assert abs(clock[-1] - end) > third
    wrong = added(timestep * (1.0 + OFF), rows)
    assert not is_regular(wrong, timestep)[rows // 10 :].any()
    clock[rows // 2 :] -= timestep
    clock[rows // 3] = np.nan
    refused = np.flatnonzero(~is_regular(clock, timestep))
    assert refused[:2].tolist() == [rows // 3, rows // 2]
    assert len(refused) == 1 + rows - rows // 2


@given(
    timestep=st.floats(1e-6, 1.0),
    rows=st.integers(4000, ROWS),
    lost=st.floats(0.0, 1.0),
    late=st.booleans(),
)
@example(timestep=1e-3, rows=ROWS, lost=0.5, late=True)
@example(timestep=2.0**-10, rows=ROWS, lost=1.0, late=False)  # every sum is exact
def test_any_step_added_up_is_regular_and_another_is_not(timestep, rows, lost, late):
    clock = added(timestep, rows)
    assert is_regular(clock, timestep).all()
    # beyond a millionth of a step from the thousandth row on, and its sum may drift
    # the other way by k spacing(end)/2, at most 10 000^2 eps = 2e-8 of a step
    off = added(timestep * (1.0 + (OFF if late else -OFF)), rows)
    assert not is_regular(off, timestep)[2000:].any()
    row = 1 + round(lost * (rows - 2))
    clock[row:] += -timestep if late else timestep
    assert np.flatnonzero(~is_regular(clock, timestep)).tolist() == list(
        range(row, rows)
    )


SENSOR = AccelerometerModel.from_parameters(
    np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1]), noise_std=0.01
)
RESIDUALS = ("squared", "norm", "weighted", "sampson")


FACES = {"cube": cube_faces(), "die": np.concatenate([cube_faces(), cube_corners()])}
"""A cube's; of a truncated octahedron 6 squares and 8 hexagons, along the diagonals."""


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "off", "least"), [("cube", 1e-6, 6), ("die", 1e-3, 7)]
)
def test_what_is_thrown_rests_on_its_faces(name, off, least):
    trajectory = simulate(name, poses=30)
    means = trajectory.hold_means() / trajectory.g
    assert trajectory.unsettled == ()
    nearest = (means @ FACES[name].T).argmax(axis=1)
    # it lies flat: corner balls sink in equally, 1e-5 m of 3e-2 m
    assert np.linalg.norm(means - FACES[name][nearest], axis=1).max() < off
    assert len(np.unique(nearest)) >= least
    assert observability(means).rank == (6 if name == "cube" else 9)


@pytest.mark.ci
def test_free_fall_never_passes_for_a_calibration():
    falling = simulate("freefall")
    readings = SENSOR.distort(falling.specific_force, np.random.default_rng(2))[::250]
    for method, residual in product(METHODS, RESIDUALS):
        with pytest.raises(RefusedError):
            calibrate(
                readings, g=falling.g, method=method, residual=residual
            ).require_converged()


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "setting", "message"),
    [
        ("cube", "poses=12", "add poses between them"),
        ("freefall", "seconds=10", "static interval"),
    ],
)
def test_their_logs_are_refused_by_the_command(
    tmp_path, capsys, name, setting, message
):
    sensor = tmp_path / "sensor.json"
    values = {"T": SENSOR.T, "K": SENSOR.K, "B": SENSOR.B}
    plain = {key: value.tolist() for key, value in values.items()}
    sensor.write_text(json.dumps(plain | {"noise_std_raw": 0.01}))
    log = tmp_path / "log.csv"
    words = ["--sensor", str(sensor), "--out", str(log), "--set", setting]
    assert run(["scene", name, *words]) == 0
    capsys.readouterr()
    assert run(["calibrate", str(log)]) == 3
    assert message in capsys.readouterr().err
