"""Trajectories: what they claim, and that a sensor's truth is exact at rest."""

import mujoco
import numpy as np
import pytest
from rounding import EPS
from scipy.spatial.transform import Rotation

from simval.errors import InputError, SimulationError
from simval.geometry import attitude_matrix
from simval.poses import cube_corners, cube_faces, fibonacci_sphere
from simval.scene import scenes, simulate
from simval.scene.drivers import gimbal_angles, minimum_jerk
from simval.scene.physics import load_model, model_path

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


def test_every_row_that_is_called_a_rest_is_one(gimbal):
    rest = gimbal.hold >= 0
    force = np.linalg.norm(gimbal.specific_force[rest], axis=1)
    assert np.abs(force - gimbal.g).max() <= gimbal.rest_force == 1e-12
    rate = np.linalg.norm(gimbal.angular_velocity[rest], axis=1)
    assert rate.max() <= gimbal.rest_rate == 1e-10
    # power: the rows in between are far from rest
    assert np.linalg.norm(gimbal.angular_velocity[~rest], axis=1).max() > 5.0


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
    with pytest.raises(ValueError, match="read-only"):
        gimbal.time[0] = 1.0


def test_hold_means_of_other_rows(gimbal):
    indices = gimbal.hold_indices()
    np.testing.assert_array_equal(indices, np.arange(40))
    rows = np.stack([gimbal.hold, 2.0 * gimbal.hold], axis=1)
    np.testing.assert_array_equal(
        gimbal.hold_means(rows), np.stack([indices, 2.0 * indices], axis=1)
    )


@pytest.mark.parametrize("directions", [cube_faces(), cube_corners(), [[0, 0, -3.0]]])
def test_any_directions_are_reached(directions):
    trajectory = simulate("gimbal", poses=directions, **QUICK)
    wanted = np.asarray(directions) / np.linalg.norm(directions, axis=1, keepdims=True)
    # the scene's own limit of rest, 1e-12 of g, with room for the mean over a hold
    np.testing.assert_allclose(trajectory.hold_means() / G, wanted, rtol=0, atol=1e-12)


def test_gimbal_angles_put_the_direction_along_the_vertical():
    """Against MuJoCo's own kinematics."""
    model = load_model(model_path("gimbal")).model
    data = mujoco.MjData(model)
    directions = fibonacci_sphere(25)
    for direction, angles in zip(directions, gimbal_angles(directions), strict=True):
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        to_world = data.site("imu").xmat.reshape(3, 3)
        # a dozen operations on numbers below 1
        np.testing.assert_allclose(
            to_world @ direction, [0, 0, 1], rtol=0, atol=12 * EPS
        )


def test_minimum_jerk_starts_and_ends_at_rest():
    t = np.linspace(0.0, 1.0, 10_001)
    position = minimum_jerk(t)
    assert (position[0], position[-1]) == (0.0, 1.0)
    assert np.all(np.diff(position) >= 0.0)
    first = np.gradient(position, t)
    second = np.gradient(first, t)
    # s' = 30 t^2 and s'' = 60 t near 0: one-sided differences over 1e-4
    assert max(first[0], first[-1]) < 30 * 1e-8
    assert max(abs(second[0]), abs(second[-1])) < 60 * 1e-4
    assert first.max() == pytest.approx(1.875, abs=1e-6)


@pytest.mark.ci
def test_the_die_rests_on_its_faces():
    trajectory = simulate("die", poses=25)
    means = trajectory.hold_means() / G
    assert trajectory.unsettled == ()
    # truncated octahedron: 6 squares along the axes, 8 hexagons along the diagonals
    faces = np.concatenate([cube_faces(), cube_corners()])
    cosine = means @ faces.T
    # a hexagon rests on balls that sink in equally, 1e-5 m of a face of 3e-2 m
    assert np.arccos(np.clip(cosine.max(axis=1), -1, 1)).max() < 1e-3
    assert len(np.unique(cosine.argmax(axis=1))) >= 7


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
        ("gimbal", {"hold_time": float("nan")}, "`hold_time`"),
        ("gimbal", {"timestep": -0.01}, "`timestep`"),
        ("gimbal", {"integrator": "discrete"}, "`integrator`"),
        ("gimbal", {"site_offset": [0, 0]}, "`site_offset`"),
    ],
)
def test_bad_requests_are_refused(scene, setting, words):
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_shakers_die_stays_in_its_box(seed):
    """With 400 poses, half an hour of it; each of eight seeds had left it by then."""
    trajectory = simulate("shaker", poses=400, seed=seed)
    assert len(trajectory.unsettled) <= 12
