"""What the studies of plug-ins see, and that code and numbers belong together."""

import os
import pickle
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import rows_by_name
from click.testing import CliRunner
from places import EXAMPLES
from rounding import EPS

from simval.attitude import two_vector_quaternion
from simval.calibrate import calibrate
from simval.cli.listing import command as list_command
from simval.errors import InputError
from simval.geometry import compose, normalize
from simval.plugins import (
    Calibrator,
    Estimator,
    PluginError,
    answers,
)
from simval.plugins.loading import chosen, spelled
from simval.plugins.probe import probe_sensor
from simval.plugins.programs import MOVE, RATE, REST, log_of
from simval.poses import fibonacci_sphere
from simval.scene import models_folder
from simval.streams import Streams
from simval.studies import calibrator, custom_scene, estimator
from simval.studies.study import Cell
from simval.sweep import provenance, run_suite
from simval.sweep.suite import expand, load_suite
from simval.verdict import judge

GOOD = Estimator(
    name="two",
    estimate=two_vector_quaternion,
    components="xyzs",
    matrix="passive",
)
STREAMS = Streams(1, (1,))


def turned(q, vector):
    """A quaternion turned by a small rotation vector."""
    small = normalize(np.append(np.asarray(vector) / 2.0, 1.0))
    return compose(q, np.broadcast_to(small, q.shape))


def davenport(b1, b2, r1, r2):
    """Wahba's solution as the eigenvector of Davenport's matrix, scalar first."""
    B = np.einsum("ni,nj->nij", b1, r1) + np.einsum("ni,nj->nij", b2, r2)
    z = np.cross(b1, r1) + np.cross(b2, r2)
    s = np.trace(B, axis1=1, axis2=2)
    K = np.empty((len(b1), 4, 4))
    K[:, 1:, 1:] = B + np.swapaxes(B, 1, 2) - s[:, None, None] * np.eye(3)
    K[:, 0, 1:] = K[:, 1:, 0] = z
    K[:, 0, 0] = s
    return np.linalg.eigh(K)[1][:, :, -1]


def leading(b1, b2, r1, r2, noise_std, factor=1.0):
    """Leading covariance of `davenport`."""
    size = (b1**2 + b2**2).sum(axis=1)[:, None, None]
    H = size * np.eye(3) - b1[:, :, None] * b1[:, None] - b2[:, :, None] * b2[:, None]
    return factor * noise_std**2 * np.linalg.inv(H)


def limits(plugin, noise_std=0.05, geometry=3):
    """Rows without chance of the study of one estimator."""
    parameters = estimator.Parameters(
        algorithm="any", noise_std=noise_std, geometry=geometry, samples=1024
    )
    rows = estimator.outcome(plugin, parameters, STREAMS).rows
    return {str(row.statistic): row for row in rows if row.check == "limit"}


@pytest.mark.parametrize("geometry", range(6))
@pytest.mark.parametrize("noise_std", [0.001, 0.05])
def test_a_sound_bias_is_of_second_order(geometry, noise_std):
    rows = limits(GOOD, noise_std, geometry)
    for name in ("cubature_bias", "cubature_bias_at_small_noise"):
        assert rows[name].value <= rows[name].prediction
    assert rows["cubature_bias_at_small_noise"].prediction < 3e-6  # no blank cheque


@pytest.mark.ci
@pytest.mark.parametrize(
    "noise",
    [
        0.05,
        # smaller ones differ by their number alone: by night
        pytest.param(0.01, marks=pytest.mark.slow),
        pytest.param(0.02, marks=pytest.mark.slow),
    ],
)
def test_a_covariance_that_is_wrong_at_one_noise_alone_fails_there(noise):
    """Its order is kept from this noise to half of it: only its size is wrong."""

    def plugin(factor):
        def covariance(*given):
            return leading(*given, factor=factor if given[-1] == noise else 1.0)

        return Estimator(
            name="d",
            estimate=davenport,
            components="sxyz",
            matrix="passive",
            covariance=covariance,
        )

    rows = limits(plugin(1.0), noise)
    assert rows["claim_off_at_the_noise"].value <= (
        rows["claim_off_at_the_noise"].prediction
    )
    for factor in (0.6, 0.85, 1.25):
        rows = limits(plugin(factor), noise)
        over = rows["claim_off_at_the_noise"]
        assert over.value > over.prediction
        half = rows["claim_off_at_half_noise"]
        assert half.value <= half.prediction  # which alone would let it pass


# a log for a command


def test_a_rest_of_the_log_is_its_pose_and_white_noise():
    poses = probe_sensor().distort(9.8 * fibonacci_sphere(24), np.random.default_rng(0))
    log = log_of(poses, 0.01)
    rest, move = round(REST * RATE), round(MOVE * RATE)
    # differences of times up to 300 s, each rounded to eps of that
    np.testing.assert_allclose(
        np.diff(log[:, 0]), 1.0 / RATE, rtol=0, atol=2 * EPS * log[-1, 0]
    )
    parts = log[:, 1:].reshape(len(poses), rest + move, 3)[:, :rest]
    # 1000 additions of readings below 10: 1e-13 of rounding
    np.testing.assert_allclose(parts.mean(axis=1), poses, rtol=0, atol=1e-11)
    noise = parts - poses[:, None]
    n = noise.size
    sigma = 0.01 * np.sqrt(rest)
    # one false alarm in 1e4 seeds: 3.9 standard errors; the mean is taken off (1/1000)
    assert abs(noise.std(ddof=72) / sigma - 1.0) < 3.9 / np.sqrt(2 * n)
    for lag in (1, 2, 10):
        product = (noise[:, lag:] * noise[:, :-lag]).mean() / sigma**2
        assert abs(product + 1.0 / rest) < 3.9 / np.sqrt(n)
    # an eps of the poses, and of the 1000 additions behind them
    assert np.array_equal(log, log_of(poses * (1.0 + 1e-15), 0.01)) or np.allclose(
        log, log_of(poses * (1.0 + 1e-15), 0.01), rtol=0, atol=1e-12
    )


def answering(**more):
    def work(poses, g):
        fit = calibrate(poses, g)
        return {"matrix": fit.matrix, "B": fit.B, "covariance": fit.covariance, **more}

    plugin = Calibrator(name="c", calibrate=work)
    parameters = calibrator.Parameters(algorithm="any", trials=32)
    rows = calibrator.outcome(plugin, parameters, STREAMS).rows
    return next(row.value for row in rows if str(row.statistic) == "nees")


@pytest.mark.ci
def test_a_type_a_covariance_is_judged_by_its_own_law():
    plain = answering()
    known = answering(covariance_kind="known sigma", dof=15)
    scaled = answering(covariance_kind="type A", dof=15)
    assert known == plain
    # an eps of the poses, times the condition of the fit
    assert scaled == pytest.approx(plain * 13 / 15, rel=100 * EPS, abs=0)
    with pytest.raises(PluginError, match="14 poses or more"):
        answering(covariance_kind="type A", dof=4)


# the code that was measured is the code that was meant


@pytest.mark.ci
def test_a_cell_takes_its_plugin_with_it_to_another_folder(tmp_path, monkeypatch):
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
        shutil.copy(EXAMPLES / "ellipsoid.py", folder)
    (there / "ellipsoid.py").write_text("stale = 1 / 0\n")
    monkeypatch.chdir(here)
    parameters = calibrator.Parameters(algorithm="ellipsoid.py", trials=32)
    rows = calibrator.run(parameters, STREAMS).rows
    sent = pickle.dumps(Cell("calibrator", parameters, 1))
    monkeypatch.chdir(there)
    cell = pickle.loads(sent)
    assert cell.name.startswith("calibrator(algorithm=ellipsoid.py,")
    assert calibrator.run(cell.parameters, STREAMS).rows == rows
    # the same path on a machine whose disk is another one
    (here / "ellipsoid.py").write_text("other = 1\n")
    with pytest.raises(PluginError, match=r"ellipsoid\.py has changed.*all workers"):
        calibrator.run(cell.parameters, STREAMS)
    (here / "ellipsoid.py").unlink()
    with pytest.raises(PluginError, match=r"ellipsoid\.py is missing"):
        calibrator.run(cell.parameters, STREAMS)


TREE = {
    "mine.py": "import helper\nfrom pack import part\nMODEL = 'mine.xml'\n",
    "helper.py": "def late():\n    import deep\n",
    "deep.py": "import numpy, mine\n",
    "pack/__init__.py": "",
    "pack/part.py": "from . import sibling\nfrom .. import helper\n",
    "pack/sibling.py": "W = 'weights.csv'\n",
    "pack/weights.csv": "1\n",
    "mine.xml": '<mujoco><compiler meshdir="m"/><mesh file="b.stl"/></mujoco>',
    "m/b.stl": "solid",
    "unrelated.py": "",
    "other.xml": "",
}


def tree(folder):
    for name, text in TREE.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


@pytest.mark.parametrize("name", TREE)
def test_all_that_a_plugin_names_is_known_again(tmp_path, name):
    tree(tmp_path)
    parameters = custom_scene.Parameters(scene=str(tmp_path / "mine.py"))
    grid = {"custom_scene": {"scene": parameters.scene}}
    before = provenance.file_hashes(grid)
    parameters.require_same_sources()
    (tmp_path / name).write_text(TREE[name] + ("<!-- -->" if name[-1] == "l" else "#"))
    after = provenance.file_hashes(grid)
    if name in ("unrelated.py", "other.xml"):
        assert after == before
        parameters.require_same_sources()
        return
    changed = provenance.differences(before, after)
    assert [line.partition(":")[0] for line in changed] == [Path(name).name]
    with pytest.raises(PluginError, match=f"{name} has changed"):
        parameters.require_same_sources()


@pytest.mark.ci
def test_a_run_with_another_helper_cannot_go_on(tmp_path):
    (tmp_path / "helper.py").write_text("K = 1\n")
    (tmp_path / "mine.py").write_text("import helper\n1 / 0\n")
    content = {"calibrator": {"algorithm": str(tmp_path / "mine.py"), "trials": 32}}
    run_suite(expand("s", content), tmp_path / "run")
    run_suite(expand("s", content), tmp_path / "run", resume=True)
    (tmp_path / "helper.py").write_text("K = 2\n")
    with pytest.raises(InputError, match=r"files\.helper\.py: .* -> "):
        run_suite(expand("s", content), tmp_path / "run", resume=True)


def installed_package(folder, monkeypatch, version="1.0"):
    shutil.copy(EXAMPLES / "align.py", folder / "their_align_module.py")
    info = folder / "theirs.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: theirs\nVersion: {version}\n"
    )
    (info / "entry_points.txt").write_text(
        "[simval.plugins]\ntheir-align = their_align_module:align\n"
    )
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder))


@pytest.mark.ci
def test_an_installed_plugin_is_listed_chosen_and_known_again(tmp_path, monkeypatch):
    installed_package(tmp_path, monkeypatch)
    listed = CliRunner().invoke(list_command, standalone_mode=False).output
    assert "their-align: theirs 1.0" in listed
    assert spelled(chosen(("their-align",))) == ["estimator.algorithm=their-align"]
    parameters = estimator.Parameters(algorithm="their-align")
    grid = {"estimator": {"algorithm": ["their-align"]}}
    assert provenance.file_hashes(grid) == {"theirs": "1.0"}
    installed_package(tmp_path, monkeypatch, "1.1")
    assert provenance.file_hashes(grid) == {"theirs": "1.1"}
    with pytest.raises(PluginError, match="theirs has changed"):
        parameters.require_same_sources()


@pytest.mark.ci
def test_what_can_be_given_as_a_plugin(tmp_path):
    file = str(EXAMPLES / "align.py")
    assert spelled(chosen((f"{file}:align",))) == [f"estimator.algorithm={file}:align"]
    shutil.copy(file, tmp_path / "align.txt")
    for plugin, words in (
        (f"{file}:other", "no plug-in named other; it has: align"),
        (str(tmp_path / "align.txt"), r"must end in \.py"),
        ("no-such-name", "no installed package offers"),
    ):
        with pytest.raises(PluginError, match=words):
            spelled(chosen((plugin,)))


# words of a command


@pytest.fixture
def suite_of_a_command(tmp_path, monkeypatch):
    """The folder of a suite whose command is in a folder beside it, seen from above."""
    folder = tmp_path / "suites"
    (folder / "my tools").mkdir(parents=True)
    shutil.copy(EXAMPLES / "command.py", folder / "my tools" / "fit.py")
    (folder / "python").write_text("")  # a program without a slash is in PATH
    (folder / "s.toml").write_text(
        "[calibrator]\ntrials = 32\n"
        "algorithm = \"command: python 'my tools/fit.py' {poses} {g}\"\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", os.path.dirname(sys.executable), prepend=os.pathsep)
    return folder


def test_a_command_in_a_suite_finds_its_files_in_the_suite_s_folder(suite_of_a_command):
    suite = load_suite("suites/s.toml")
    (cell,) = suite.cells
    path = suite_of_a_command / "my tools" / "fit.py"
    assert cell.parameters.algorithm == f"command: python '{path}' {{poses}} {{g}}"
    # the name, and so the numbers, do not depend on where the folder is
    assert cell.key_name.startswith(
        "calibrator(algorithm=command: python fit.py {poses} {g},"
    )
    assert provenance.file_hashes(suite.grid).keys() == {"fit.py"}


def test_words_that_are_no_files_stay_what_they_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text in ("command: sh -c 'cat {poses}; exit 3'", "command: a {poses} b/c"):
        assert calibrator.Parameters(algorithm=text).algorithm == text


# scenes of the documentation

SHELF = """
<mujoco><option timestep="0.002" gravity="0 0 -9.80665" magnetic="2e-5 0 -4e-5">
<flag autoreset="disable"/></option><worldbody><body name="body" pos="0 0 1">
<geom type="box" size=".06 .04 .02" mass=".3"/><site name="imu"/></body></worldbody>
<sensor><accelerometer name="accelerometer" site="imu"/><gyro name="gyro" site="imu"/>
<magnetometer name="magnetometer" site="imu"/><clock name="clock"/>
<framequat name="attitude" objtype="site" objname="imu"/></sensor></mujoco>
"""


@pytest.mark.ci
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")  # it never turns
def test_the_documented_scenes_are_judged_as_documented(tmp_path):
    text = (EXAMPLES.parent / "scenes.md").read_text()
    blocks = {
        name: code
        for name, code in re.findall(r"```python\n# (\w+)\.py(.*?)```", text, re.S)
    }
    (tmp_path / "shelf.xml").write_text(SHELF)
    shutil.copy(models_folder() / "gimbal.xml", tmp_path / "mine.xml")
    answers = {}
    for name, code in blocks.items():
        path = tmp_path / f"{name}.py"
        path.write_text("#" + code)
        parameters = custom_scene.Parameters(scene=str(path))
        rows = custom_scene.compute(parameters, STREAMS).rows
        judged = judge(rows_by_name.named(rows))
        answers[name] = {str(v.row.statistic): v.answer for v in judged}
        assert all(
            f"`{row.statistic}`" in text for row in rows if row.check != "record"
        )
    assert set(answers["mine"].values()) == {"pass"}
    assert answers["shelf"]["rank"] == "fail"
    assert answers["shelf"]["rest_force"] == "pass"


@pytest.mark.parametrize("shape", [(), (3,), (3, 3)])
def test_an_answer_stands_rows_first_in_its_own_shape(shape):
    given = np.asarray(np.arange(float(np.prod(shape))).reshape(shape), order="F")
    read = answers.numbers("mine", "x", given, shape)
    assert read.shape == shape
    assert read.flags.c_contiguous
    assert np.array_equal(read, given)
