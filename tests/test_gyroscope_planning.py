"""Plans of a gyroscope's calibration, and the bound they are made of."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from simval.cli import run
from simval.errors import GeometryError, InputError
from simval.poses import cube_faces, fibonacci_sphere
from simval.sensor import AccelerometerModel, GyroscopeModel
from simval.theory import gyroscope_moments, plan_gyroscope
from simval.theory.plans import smooth_path
from simval.turns import turns_of

NOMINAL = {
    "pose_std": 1e-3,
    "angle_random_walk": np.radians(0.01),
    "move_seconds": 2.0,
    "rest_seconds": 1.0,
}


def rms(poses, **more):
    sd = plan_gyroscope(fibonacci_sphere(poses), **{**NOMINAL, **more}).sd
    return np.sqrt((sd[:9] ** 2).mean())


@pytest.mark.ci
def test_more_poses_quicker_moves_longer_rests():
    """Directions of each dependence, and the root of the number of poses."""
    assert rms(80) < 0.8 * rms(40) < 0.8 * 0.8 * rms(20)
    assert rms(40, move_seconds=1.0) < rms(40) < rms(40, move_seconds=4.0)
    assert rms(40, pose_std=5e-4) < rms(40)
    # all noise twice is twice the bound: it is linear
    twice = rms(20, pose_std=2e-3, angle_random_walk=np.radians(0.02))
    np.testing.assert_allclose(twice, 2.0 * rms(20), rtol=1e-9)


def test_the_bound_does_not_depend_on_where_the_world_points():
    """The same tumble in other sensor axes: M's covariance turns with them."""
    u = fibonacci_sphere(14)
    path = smooth_path(*turns_of(u), 2.0)
    Q = Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix()
    turned = type(path)(turns=path.turns @ Q.T, seconds=path.seconds)
    sensors = (
        GyroscopeModel(M=np.eye(3), B=np.zeros(3)),
        AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3)),
    )
    noise = {"pose_std": 1e-3, "bias_std": 1e-5, "angle_random_walk": 2e-4}
    one = gyroscope_moments(*sensors, u, path, form="symmetric", **noise)
    two = gyroscope_moments(*sensors, u @ Q.T, turned, form="symmetric", **noise)
    K = np.kron(Q, Q)  # of Q M Q', for the symmetric form turns with the axes
    expected = K @ one.cramer_rao[9:18, 9:18] @ K.T
    scale = np.abs(expected).max()
    np.testing.assert_allclose(two.cramer_rao[9:18, 9:18], expected, atol=1e-8 * scale)


def test_the_next_turn_helps():
    plan = plan_gyroscope(fibonacci_sphere(12), **NOMINAL)
    assert np.all(plan.sd_next < plan.sd)
    assert plan.rank == 9


def test_faces_of_a_cube_do_not_tell():
    plan = plan_gyroscope(cube_faces(), **NOMINAL)
    assert plan.rank < 9
    assert np.isinf(plan.sd).all()


def test_what_cannot_be_planned_is_refused():
    u = fibonacci_sphere(12)
    for bad in ({"pose_std": 0.0}, {"move_seconds": -1.0}, {"rest_seconds": np.nan}):
        with pytest.raises(InputError):
            plan_gyroscope(u, **{**NOMINAL, **bad})
    axes, angles = turns_of(u)
    with pytest.raises(InputError, match="away from direction 1"):
        plan_gyroscope(u, turns=(axes[::-1], angles), **NOMINAL)
    path = smooth_path(axes, 0.0 * angles + 1e-9, 2.0)
    sensors = (
        GyroscopeModel(M=np.eye(3), B=np.zeros(3)),
        AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3)),
    )
    noise = {"pose_std": 1e-3, "bias_std": 1e-5, "angle_random_walk": 2e-4}
    with pytest.raises(GeometryError, match="nothing can be predicted"):
        gyroscope_moments(*sensors, u[[0] * 12], path, **noise)


COMMAND = [
    "plan",
    "--poses",
    "fibonacci:20",
    "--hold",
    "1",
    "--noise-density",
    "0.0014",
]


def test_command(capsys):
    from simval.cli.commands.plan import command

    asked = [*COMMAND[1:], "--angle-random-walk", "1.75e-4", "--json"]
    got = json.loads(CliRunner().invoke(command, asked, catch_exceptions=False).output)
    plan = got["gyroscope"]
    assert plan["names"][0] == "M_xx"
    expected = plan_gyroscope(
        fibonacci_sphere(20), pose_std=got["noise_std"], angle_random_walk=1.75e-4,
        move_seconds=2.0, rest_seconds=1.0,
    )  # fmt: skip
    np.testing.assert_allclose(plan["sd"], expected.sd, rtol=1e-12)
    assert run([*COMMAND, "--angle-random-walk", "1.75e-4"]) == 0
    assert "next turn" in capsys.readouterr().out
    assert run([*COMMAND, "--move", "2"]) == 2
    assert run(["plan", "--noise-std", "1e-3", "--angle-random-walk", "1e-4"]) == 2
