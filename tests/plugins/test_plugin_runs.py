"""Plug-ins in a run: isolated failures, three worked examples, and the gate on them."""

import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from places import EXAMPLES, ROOT
from quick_align import ALIGN

from simval.plugins import (
    Calibrator,
    PluginError,
    find_plugin,
    probe_calibrator,
)
from simval.plugins.answers import calibration_of
from simval.plugins.probe import probe_sensor
from simval.poses import fibonacci_sphere
from simval.streams import Streams
from simval.studies import calibrator, custom_scene
from simval.sweep import load_run

pytestmark = pytest.mark.ci


@pytest.mark.skipif(sys.platform != "linux", reason="limits differ elsewhere")
def test_a_command_that_floods_us_is_ended_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    parameters = calibrator.Parameters(algorithm="command: yes {poses}", trials=32)
    with pytest.raises(
        PluginError, match=r"`yes` was killed by SIGXFSZ \(File size .*\): silent"
    ):
        calibrator.run(parameters, Streams(1, (1,)))
    assert list(tmp_path.iterdir()) == []


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
