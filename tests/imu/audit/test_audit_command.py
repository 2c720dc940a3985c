"""`simval audit` of files and of a simulator's file."""

import json
import re
from runpy import run_path
from xml.etree import ElementTree

import numpy as np
import pytest
from containers import ros
from places import EXAMPLES, ROOT
from rosbags.rosbag2 import StoragePlugin

from simval.cli.audit import _text
from simval.studies.simulated_imus import MOUNT, simulated

SAID = ("--lever", "0.1,-0.05,0.2", "--gravity", "0,0,-9.81")


def rng(*seed):
    return np.random.Generator(np.random.SFC64(seed))


def quaternion():
    from scipy.spatial.transform import Rotation

    return ",".join(map(str, Rotation.from_matrix(MOUNT.T).as_quat()))


@pytest.fixture
def log(tmp_path):
    def made(name="right", **more):
        path = tmp_path / f"{name.replace(' ', '_').replace('/', '_')}.csv"
        path.write_text(_text(simulated(name, rng(3), rate=100.0, seconds=8.0, **more)))
        return path

    return made


def test_a_log_with_its_poses(simval, log, tmp_path):
    mount = ("--mount", quaternion())
    code, out, _ = simval("audit", log(), *SAID, *mount)
    assert code == 0, out
    code, out, _ = simval("audit", log("mixed"), *SAID, *mount)
    assert code == 1
    assert "mixes two instants" in out
    files = ("--junit", tmp_path / "a.xml", "--report", tmp_path / "a.html")
    code, out, _ = simval("audit", log("no lever arm"), *SAID, *mount, *files, "--json")
    found = json.loads(out)
    assert (code, found["answer"], found["exit_code"]) == (1, "fail", 1)
    assert found["wrong"][0]["what"].startswith("lacks the lever arm (0.1, -0.05, 0.2)")
    assert found["sensors"]["accelerometer"]["terms"]["lever"]["wrong"]
    suite = ElementTree.parse(tmp_path / "a.xml").getroot()
    assert suite.get("failures") == str(len(suite.findall(".//failure"))) != "0"
    assert "lacks the lever arm" in suite.find(".//failure").get("message")
    assert "lacks the lever arm" in (tmp_path / "a.html").read_text()


def test_what_is_not_declared_is_printed(simval, log):
    code, out, _ = simval("audit", log(), "--verbose", "--only", "lever,scale")
    assert code == 0, out
    assert "lever fitted" in out
    code, _, err = simval("audit", log(), "--only", "colour")
    assert code == 2
    assert "colour" in err


def test_a_folder_of_euroc(simval, tmp_path):
    """Integers of nanoseconds, and poses of another clock's rows."""
    imu = simulated("right", rng(5), seconds=8.0)
    poses = simulated("right", rng(5), seconds=8.0, rate=250.0)
    inside = tmp_path / "mav0"
    (inside / "imu0").mkdir(parents=True)
    (inside / "state_groundtruth_estimate0").mkdir()

    def rows(time, *columns):
        stamps = 1_403_715_000_000_000_000 + np.round(time * 1e9).astype(np.int64)
        table = np.hstack(columns)
        return [
            ",".join([str(t), *(f"{x:.17g}" for x in row)])
            for t, row in zip(stamps.tolist(), table, strict=True)
        ]

    heads = [f"{k}_RS_S_{a} [{u}]" for k, u in (("w", "rad s^-1"), ("a", "m s^-2"))
             for a in "xyz"]  # fmt: skip
    lines = rows(imu.time, imu.gyroscope, imu.accelerometer)
    text = "\n".join([",".join(["#timestamp [ns]", *heads]), *lines, ""])
    (inside / "imu0" / "data.csv").write_text(text)
    heads = [*(f"p_RS_R_{a} [m]" for a in "xyz"), *(f"q_RS_{a} []" for a in "wxyz")]
    lines = rows(poses.time, poses.position, np.roll(poses.attitude, 1, axis=1))
    text = "\n".join([",".join(["#timestamp", *heads]), *lines, ""])
    (inside / "state_groundtruth_estimate0" / "data.csv").write_text(text)
    code, out, err = simval("audit", tmp_path, *SAID, "--mount", quaternion())
    assert code == 0, out + err


def test_poses_of_tum(simval, log, tmp_path):
    imu = simulated("right", rng(3), rate=100.0, seconds=8.0)
    rows = np.column_stack([imu.time, imu.position, imu.attitude])
    np.savetxt(tmp_path / "poses.txt", rows, fmt="%.17g")
    path = tmp_path / "readings.csv"
    lines = [",".join(line.split(",")[:7]) for line in log().read_text().splitlines()]
    path.write_text("\n".join([*lines, ""]))
    code, out, err = simval("audit", path, "--truth", tmp_path / "poses.txt", *SAID)
    assert code == 0, out + err
    turned = ("--truth-turns", "world-to-body")
    code, out, _ = simval(
        "audit", path, "--truth", tmp_path / "poses.txt", *SAID, *turned
    )
    assert code == 1


@pytest.mark.ci
@pytest.mark.parametrize(
    ("plugin", "form"),
    [
        (None, "geometry_msgs/msg/PoseStamped"),
        (None, "nav_msgs/msg/Odometry"),
        (StoragePlugin.SQLITE3, "geometry_msgs/msg/TransformStamped"),
        (StoragePlugin.MCAP, "nav_msgs/msg/Odometry"),
        (StoragePlugin.MCAP, "geometry_msgs/msg/PoseWithCovarianceStamped"),
    ],
)
def test_a_bag_with_a_topic_of_poses(simval, tmp_path, plugin, form):
    """Two frames' names of any length stand before the numbers of some messages."""
    said = (*SAID, "--mount", quaternion())

    def bag(name, file, form=form):
        imu = simulated(name, rng(3), rate=100.0, seconds=8.0)
        poses = None if form is None else (form, imu.position, imu.attitude)
        us = np.round(imu.time * 1e6).astype(np.int64)
        how = dict(plugin=plugin, poses=poses, frames=("imu", "a", "world"))
        return ros(tmp_path / file, us, imu.accelerometer, imu.gyroscope, **how)

    right = bag("right", "right")
    code, out, err = simval("audit", right, *said)
    assert code == 0, out + err
    assert simval("audit", right, *said, "--truth", "/body")[:2] == (code, out)
    code, _, err = simval("audit", right, *said, "--truth", "/other")
    assert code == 2
    assert "poses in /body" in err
    code, _, err = simval("audit", right, *said, "--truth", right)
    assert code == 2
    assert "record the poses and the readings in one bag" in err
    code, out, _ = simval("audit", bag("late", "late"), *said)
    assert code == 1
    assert "steps late" in out
    code, _, err = simval("audit", bag("right", "alone", None), *said)
    assert code == 2
    assert "no topic with positions; record one of geometry_msgs/PoseStamped" in err


@pytest.mark.ci
def test_the_log_of_a_scene(simval, tmp_path):
    """Its positions are the sensor's, so there is no lever arm."""
    log, turn = tmp_path / "log.csv", ("--mount", "0,0,0,1")
    assert simval("scene", "freefall", "--out", log)[0] == 0
    right = ("--gravity", "0,0,-9.80665", *turn, "--until", "8")
    code, out, err = simval("audit", log, "--lever", "0,0,0", *right)
    assert code == 0, out + err
    code, out, _ = simval("audit", log, "--lever", "0.1,0,0", *right)
    assert code == 1
    assert "lacks the lever arm (0.1, 0, 0)" in out


@pytest.mark.slow
def test_the_power_that_the_page_states(capsys):
    """What is allowed, and an error of the gyroscope's scale that is found."""
    made = run_path(EXAMPLES / "audit_power.py")
    made["main"](1, ("scale of the gyroscope",), (0.25, 4.0))
    *allowed, _, _, found = capsys.readouterr().out.splitlines()
    page = (ROOT / "docs" / "audit.md").read_text()
    assert [line for line in allowed if line.rstrip() not in page] == []
    assert found.split()[-2:] == ["0.00", "1.00"]


def test_a_right_one_of_those_that_the_page_counts(capsys):
    """Draw 821: a mount turns the bias and the lever arm that are fitted, too."""
    run_path(EXAMPLES / "audit_right.py")["main"](821, 822)
    moved = capsys.readouterr().out.splitlines()[2]
    assert moved.split() == ["moves", "under", "1", "s", "0", "1", "0", "0"]


SIMULATOR = """
import numpy as np
def simulate(request):
    t = np.arange(int(request.seconds * request.rate)) / request.rate
    z = 0.0 * t
    quarter = np.stack([z, z, np.sin(t / 2), np.cos(t / 2)], axis=1)
    return dict(time=t, position=np.stack([z, z, z], axis=1), attitude=quarter,
                gyroscope=np.stack([z, z, z + 1.0], axis=1),
                accelerometer=np.stack([z, z, z + SIGN * 9.81], axis=1),
                gravity=(0, 0, -9.81), lever=(0, 0, 0), mount=(0, 0, 0, 1))
"""


@pytest.mark.ci
@pytest.mark.parametrize(("name", "code"), [("mujoco_step", 1), ("mujoco_forward", 3)])
def test_the_adapters_of_mujoco(simval, name, code):
    """As docs/simulated_imus.md has them; the engines beside it want their packages."""
    page = (ROOT / "docs" / "simulated_imus.md").read_text()
    (row,) = [each for each in page.splitlines() if f"`{name}.py` |" in each]
    file = ROOT / "docs" / "examples" / "simulators" / f"{name}.py"
    got, out, err = simval("audit", file, "--seconds", "8")
    assert got == code, out + err
    assert ("the mean over the step before it" in out) == (" | 0.5 | " in row)
    figures = re.findall(r"-?\d\.\d+ ± \d\.\d+", row)
    assert len(figures) >= 3
    assert [each for each in figures if each not in out] == []


def test_a_simulator_s_file(simval, tmp_path):
    """It is run in a process of its own; what it declares is taken."""
    file = tmp_path / "mine.py"
    file.write_text(SIMULATOR.replace("SIGN", "1"))
    out_file = tmp_path / "made.csv"
    code, out, _ = simval("audit", file, "--only", "gravity", "--out", out_file)
    assert code == 0, out
    assert simval("audit", out_file, "--only", "gravity", *SAID[2:])[0] == 0
    assert simval("audit", file, "--seconds", "5")[0] == 3
    file.write_text(SIMULATOR.replace("SIGN", "-1"))
    code, out, _ = simval("audit", file)
    assert code == 1
    assert "opposite sign" in out
    for text, code, said in (
        ("x = 1", 3, "no function simulate"),
        ("def simulate(r): return {}", 3, "returned no `time`"),
        ("def simulate(r): 1 / 0", 4, "ZeroDivisionError"),
    ):
        file.write_text(text)
        got, _, err = simval("audit", file)
        assert got == code, err
        assert said in err
