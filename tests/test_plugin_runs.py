"""Plug-ins in a run: isolated failures, three worked examples, and the gate on them."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from places import EXAMPLES, ROOT
from quick_align import ALIGN

from simval.errors import CrashedPluginError
from simval.plugins import (
    Calibrator,
    PluginError,
    child,
    find_plugin,
    probe_calibrator,
)
from simval.plugins.calibrations import calibration_of
from simval.plugins.calibrator_probe import probe_sensor
from simval.poses import fibonacci_sphere
from simval.streams import Streams
from simval.studies import calibrator, custom_scene, estimator
from simval.sweep import load_run, run_suite
from simval.sweep.suite import expand
from simval.text import LIMIT

pytestmark = pytest.mark.ci

HEAD = """
import os, signal, sys, tempfile, time
import numpy as np
from simval.plugins import Calibrator

def surroundings():
    # temporary files in the cell's own folder; on Linux the first out of memory
    inside = tempfile.gettempdir() == sys.argv[1]
    linux = sys.platform == "linux"
    score = open("/proc/self/oom_score_adj").read().strip() if linux else 1000
    return f"\\udcff\\x1b\\n{inside}{score}"

def work(poses, g):
    BODY

calibrator = Calibrator(name="broken", calibrate=work)
"""


def broken(folder, body):
    path = folder / "broken.py"
    path.write_text(HEAD.replace("BODY", body))
    return str(path)


def measured(algorithm, time_limit=60.0):
    parameters = calibrator.Parameters(
        algorithm=algorithm, trials=32, time_limit=time_limit
    )
    return calibrator.run(parameters, Streams(1, (1,))).rows


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("raise ValueError(surroundings())", r"ValueError: \\udcff\\x1b \| True1000$"),
        ("sys.exit(0)", "raised SystemExit"),
        ("os._exit(0)", "ended with exit code 0 without an answer$"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", "was killed by SIGSEGV"),
        pytest.param(
            "return np.eye(3) * np.nan, np.zeros(3)",
            "non-finite",
            marks=pytest.mark.slow,
        ),
        pytest.param("return np.eye(2), np.zeros(3)", "shape", marks=pytest.mark.slow),
        (
            "print('x' * 10**6); sys.stderr.write('last'); sys.stderr.flush(); "
            "os._exit(7)",
            "exit code 7 without an answer; its last words: .*last",
        ),
    ],
)
def test_a_plugin_that_misbehaves_fails_in_words(tmp_path, body, words):
    with pytest.raises(PluginError, match=words):
        measured(broken(tmp_path, body))


@pytest.mark.skipif(sys.platform != "linux", reason="limits differ elsewhere")
def test_a_command_that_floods_us_is_ended_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(
        PluginError, match=r"`yes` was killed by SIGXFSZ \(File size .*\): silent"
    ):
        measured("command: yes {poses}")
    assert list(tmp_path.iterdir()) == []


def test_a_process_that_hangs_is_stopped_with_its_children(tmp_path, monkeypatch):
    mark = tmp_path / "processes"
    program = tmp_path / "hangs"
    program.write_text(f"#!/bin/sh\nsleep 600 &\necho $$ $! > {mark}\nsleep 600\n")
    program.chmod(0o755)
    monkeypatch.setattr(child, "sys", SimpleNamespace(executable=str(program)))
    with pytest.raises(PluginError, match="did not end within 2 s"):
        measured("any.py", time_limit=2.0)
    assert_gone(mark.read_text().split())


@pytest.mark.slow
def test_a_plugin_that_hangs_is_stopped_with_its_children(tmp_path):
    mark = tmp_path / "child"
    body = (
        f"child = os.fork(); open({str(mark)!r}, 'a').write(f'{{os.getpid()}} '); "
        "time.sleep(600)"
    )
    with pytest.raises(PluginError, match="did not end within 60 s"):
        measured(broken(tmp_path, body), time_limit=60.0)
    assert_gone(mark.read_text().split())


def assert_gone(processes):
    assert len(processes) == 2
    limit = time.monotonic() + 20.0  # a killed process needs a moment to go
    while any(alive(pid) for pid in processes):
        assert time.monotonic() < limit, "a process outlived its cell"
        time.sleep(0.05)


def alive(pid):
    # dead and waiting for its new parent to look is not alive
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        return state not in ("Z", "X")
    return False


class Said(child.Answer):
    """An answer of one number."""

    number: int = 0


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ({"number": "x"}, "no readable answer"),
        ({"number": []}, "no readable answer"),
        ({"number": 0.5}, "no readable answer"),
        ({"error": "bad\nand worse"}, r"^bad \| and worse$"),
        ({"error": "x" * 10**5}, r"^x{900}"),
        ({"error": ["x"]}, "no readable answer"),
        ("error", "no readable answer"),
        (3, "no readable answer"),
    ],
)
def test_a_forged_answer_is_refused(tmp_path, answer, words):
    (tmp_path / "answer.json").write_text(json.dumps(answer))
    with pytest.raises(PluginError, match=words) as caught:
        child.read_answer(tmp_path, 0, Said, "the plug-in")
    assert len(str(caught.value)) <= LIMIT
    (tmp_path / "answer.json").write_text(json.dumps({"number": 3}))
    assert child.read_answer(tmp_path, 0, Said, "the plug-in").number == 3


def test_an_answer_is_a_plain_file_of_a_size(tmp_path):
    file, other = tmp_path / "answer.json", tmp_path / "other.json"
    other.write_text("{}")

    def great():
        with file.open("wb") as content:
            content.truncate(child.MAX_OUTPUT + 1)

    for make in (
        lambda: file.symlink_to(other),
        lambda: file.symlink_to("/dev/zero"),
        lambda: os.mkfifo(file),  # whose other end nobody has
        file.mkdir,
        great,
    ):
        make()
        with pytest.raises(PluginError, match="left no readable answer"):
            child.read_answer(tmp_path, 0, Said, "the plug-in")
        file.rmdir() if file.is_dir() and not file.is_symlink() else file.unlink()
    with pytest.raises(CrashedPluginError, match=r"exit code 0 without an answer$"):
        child.read_answer(tmp_path, 0, Said, "the plug-in")


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_broken_plugin_fails_its_cells_and_nothing_else(tmp_path, workers):
    algorithm = broken(tmp_path, "os.kill(os.getpid(), signal.SIGKILL)")
    content = {
        "attitude": {"noise_std": 0.02, "samples": 65_536},
        "calibrator": {"algorithm": algorithm, "trials": 32},
    }
    run = run_suite(expand("mixed", content), tmp_path / "run", workers=workers)
    assert {cell.study: cell.status for cell in run.cells} == {
        "attitude": "done",
        "calibrator": "failed",
    }
    failed = next(cell for cell in run.cells if cell.status == "failed")
    assert "was killed by SIGKILL (Killed) without an answer" in failed.error


def test_the_numbers_of_a_plugin_do_not_depend_on_the_process():
    parameters = calibrator.Parameters(
        algorithm=str(EXAMPLES / "ellipsoid.py"), trials=32
    )
    streams = Streams(1, (1,))
    inside = calibrator.compute(parameters, streams).rows
    assert calibrator.run(parameters, streams).rows == inside


def test_a_claimed_covariance_is_judged(tmp_path):
    # the sound one of the probe's tests, written out, and one that claims too much
    text = ALIGN.partition("align = ")[0]
    text += """
def _covariance(b1, b2, r1, r2, noise_std):
    size = (b1**2 + b2**2).sum(axis=1)[:, None, None]
    H = size * np.eye(3) - b1[:, :, None] * b1[:, None] - b2[:, :, None] * b2[:, None]
    return noise_std**2 * np.linalg.inv(H)

align = Estimator(name="align", estimate=_align, components="xyzs", matrix="active",
                  covariance=_covariance, claim=CLAIM)
"""
    rows = {}
    for claim in ("2", '"exact"'):
        path = tmp_path / f"claim{len(claim)}.py"
        path.write_text(text.replace("CLAIM", claim))
        parameters = estimator.Parameters(
            algorithm=str(path), noise_std=0.05, samples=1024
        )
        found = estimator.compute(parameters, Streams(1, (1,))).rows
        rows[claim] = {str(row.statistic): row for row in found}
    earned = rows["2"]["claim_off_at_half_noise"]
    assert 0.0 < earned.value <= earned.prediction
    assert rows["2"]["nees"].remainder > 0.0
    assert rows['"exact"']["nees"].remainder == 0.0
    assert "claim_off_at_half_noise" not in rows['"exact"']


def test_a_scene_of_ones_own(tmp_path):
    shutil.copy(ROOT / "models" / "gimbal.xml", tmp_path / "mine.xml")
    path = tmp_path / "mine.py"
    path.write_text(
        "from pathlib import Path\n"
        "from simval.scene import Scene, find_scene\n"
        "scene = Scene(name='mine', summary='a gimbal of mine',\n"
        "              model=Path(__file__).with_name('mine.xml'),\n"
        "              drive=find_scene('gimbal').drive)\n"
    )
    parameters = custom_scene.Parameters(scene=str(path))
    rows = custom_scene.run(parameters, Streams(1, (1,))).rows
    assert {str(row.statistic) for row in rows} >= {"rest_force", "rank", "rate_lag"}
    with pytest.raises(PluginError, match="never rests"):
        custom_scene.run(custom_scene.Parameters(scene="freefall"), Streams(1, (1,)))


def gated(folder, *plugin):
    """From an empty folder to a gated run, by the commands of the documentation."""

    def call(*words):
        return subprocess.run(
            [sys.executable, "-m", "simval", *words],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=900,
        )

    (folder / "suite.toml").write_text("[attitude]\nsamples = 65536\n")
    words = ("sweep", "suite.toml", *plugin, "--workers", "1", "--quiet")
    assert call(*words, "--out", "first").returncode == 0
    first = call("gate", "first")
    assert first.returncode == 1, first.stdout + first.stderr  # writes the baseline
    done = call("gate", "first")
    assert done.returncode == 0, done.stdout + done.stderr
    return load_run(folder / "first")


def test_a_plugin_is_gated_beside_the_built_in_ones(simval, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("align.py").write_text(ALIGN)
    Path("suite.toml").write_text("[attitude]\nsamples = 65536\n")
    words = ("sweep", "suite.toml", "--plugin", "align.py", "--workers", 1, "--quiet")
    fewer = ("--set", "estimator.samples=4096")
    assert simval(*words, *fewer, "--out", "first")[0] == 0
    assert [simval("gate", "first")[0] for _ in range(2)] == [1, 0]
    # beside it, unasked, what stands in its table
    assert [c.parameters["algorithm"] for c in load_run("first").of("estimator")] == [
        "align.py:align",
        "simval:wahba",
        "simval:triad",
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plugin", "study", "cells"),
    [("align.py", "estimator", 3), ("ellipsoid.py", "calibrator", 2)],
)
def test_worked_examples_from_an_empty_folder_to_a_gated_run(
    tmp_path, plugin, study, cells
):
    shutil.copy(EXAMPLES / plugin, tmp_path)
    lines = (EXAMPLES / plugin).read_text().splitlines()
    assert sum(bool(line.strip()) for line in lines) < 15
    run = gated(tmp_path, "--plugin", plugin)
    assert len(run.of(study)) == cells  # with the built-in ones


@pytest.mark.slow
def test_an_external_command_from_an_empty_folder_to_a_gated_run(tmp_path):
    shutil.copy(EXAMPLES / "command.py", tmp_path)
    words = f"command: {sys.executable} command.py {{poses}} {{g}}"
    # as few trials as a judgement needs: each is a process of its own
    run = gated(tmp_path, "--plugin", words, "--set", "calibrator.trials=896")
    assert len(run.of("calibrator")) == 2  # with the built-in one


def test_an_external_command_is_probed():
    words = f"{sys.executable} {EXAMPLES / 'command.py'} {{poses}} {{g}}"
    plugin = find_plugin(f"command: {words}", Calibrator)
    # an ellipsoid by linear least squares: the square of the condition, some hundred
    assert probe_calibrator(plugin) <= 1e-11
    for program, complaint in (
        ("false {poses}", "exit code 1"),
        ("echo {poses}", "did not print one JSON object"),
        ("no-such-program {poses}", "cannot be run"),
        ("sh -c 'echo 3' {poses}", "print one JSON object"),
        ("sh -c 'kill -SEGV $$' {poses}", r"`sh` was killed by SIGSEGV \(.*\): silent"),
        (r"sh -c 'printf bad\\033 >&2; exit 7' {poses}", r"code 7: bad\\x1b$"),
        ("head -c 2000000 /dev/zero {poses}", "printed more than 1048576 bytes"),
        ("""echo '{"B": 0, "B": 1}' '{poses}'""", "the key `B` is given twice"),
    ):
        with pytest.raises(PluginError, match=complaint):
            probe_calibrator(find_plugin(f"command: {program}", Calibrator))


def test_what_a_command_leaves_behind_is_not_waited_for(tmp_path):
    mark = tmp_path / "left"
    program = tmp_path / "program"
    program.write_text(
        f"#!/bin/sh\nsleep 600 &\necho $! > {mark}\n"
        'echo \'{"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "B": [0, 0, 0]}\'\n'
    )
    program.chmod(0o755)
    plugin = find_plugin(f"command: {program} {{poses}}", Calibrator)
    found = calibration_of(plugin, np.eye(3), 9.8, 0.0)  # not after 60 s, and refused
    assert np.array_equal(found.matrix, np.eye(3))
    os.kill(int(mark.read_text()), signal.SIGKILL)  # it was there all the time


def test_simval_calibrate_is_itself_an_external_calibrator():
    # a whole recorded log, rests found by the detector; noise-free but for its stripes
    words = f"{sys.executable} -m simval calibrate {{log}} --g {{g}} --json"
    sensor = probe_sensor()
    raw = sensor.distort(9.80665 * fibonacci_sphere(24), np.random.default_rng(0))
    plugin = find_plugin(f"command: {words}", Calibrator)
    found = calibration_of(plugin, raw, 9.80665, 1e-4)
    # the detector leaves out what is near a turn, so means keep at most one stripe of
    # 1e-4 sqrt(200) in some 100 samples
    assert abs(found.bias - sensor.B).max() <= 10 * 1e-4 * 200**0.5 / 100
