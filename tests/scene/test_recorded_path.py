"""Recorded poses as a trajectory: `simval scene --trajectory`."""

import numpy as np
import pytest

from simval.errors import InputError
from simval.path import PosePath
from simval.scene.recorded_path import recorded_trajectory
from simval.studies.simulated_imus import G, Motion, Truth

UP = np.array([0.0, 0.0, 9.80665])


def truth(t):
    motion = Motion.of(np.random.Generator(np.random.SFC64(3)))
    return Truth(motion, t, 0.01, np.array([0.1, -0.05, 0.2]), np.eye(3))


def test_a_path_has_the_rates_and_forces_of_the_motion():
    """Of a motion in closed form; the error falls with the sixth power of the step."""
    at = np.linspace(3.0, 5.0, 77)
    exact = truth(at)
    errors = []
    for step in (0.1, 0.05):
        poses = truth(np.arange(0.0, 8.0, step))
        path = PosePath(poses.t, poses.motion.place(poses.t), -poses.R.as_quat()).at(at)
        force = path.specific_force(exact.lever, np.array([0.0, 0.0, -G]))
        errors.append(
            [np.abs(path.rate - exact.w).max(), np.abs(force - exact.force()).max()]
        )
    assert np.all(np.array(errors[1]) < [2e-6, 2e-5])
    assert np.all(np.log2(np.array(errors[0]) / errors[1]) > 5.0)


@pytest.fixture
def poses(tmp_path):
    x = truth(np.arange(0.0, 8.0, 0.02))
    rows = np.column_stack([1.7e9 + x.t, x.motion.place(x.t), x.R.as_quat()])
    np.savetxt(tmp_path / "poses.txt", rows, fmt="%.17g")
    return tmp_path / "poses.txt"


def test_what_is_written_passes_the_audit(simval, poses, tmp_path):
    """TUM's form at 50 Hz; a log at 200 Hz with its poses, right by the audit."""
    out = tmp_path / "log.csv"
    code, said, err = simval("scene", "--trajectory", poses, "--rate", "200",
                             "--out", out)  # fmt: skip
    assert code == 0, err
    assert "degree 5 changes the specific force by" in said
    told = ("--lever", "0,0,0", "--mount", "0,0,0,1")
    code, said, _ = simval("audit", out, *told)
    assert code == 0, said
    assert "the mean over the step before it" in said
    code, said, _ = simval("audit", out, "--lever", "0,0,0.1", *told[2:])
    assert (code, "lever arm" in said) == (1, True)


def test_what_the_interpolation_changes_is_stated(poses):
    found = recorded_trajectory(poses, 200.0)
    exact = truth(found.time)
    off = np.linalg.norm(found.specific_force - exact.body(exact.a + UP),
                         axis=1)  # fmt: skip
    assert np.sqrt(np.mean(off**2)) < 3.0 * found.provenance["force_error"]


def test_a_hole_is_refused(poses, tmp_path):
    rows = np.loadtxt(poses)
    np.savetxt(tmp_path / "hole.txt", np.delete(rows, slice(100, 200), 0), fmt="%.17g")
    with pytest.raises(InputError, match="no pose for"):
        recorded_trajectory(tmp_path / "hole.txt")


def test_options_of_poses_need_them(simval, poses):
    assert simval("scene", "--rate", "100")[0] == 2
    assert simval("scene", "--trajectory", poses)[0] == 2
    assert simval("scene", "die", "--trajectory", poses, "--out", "x.csv")[0] == 2
