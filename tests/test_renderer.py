"""`MUJOCO_GL`: its value stops no command that draws nothing, and who draws is told.

MuJoCo ends its own import where the variable names a graphics library that is not
there, so a value that suits no machine would stop whatever builds a scene.
"""

import json
import os
import subprocess
import sys

import pytest

from simval.errors import InputError
from simval.scene import frames, render

COMMANDS = {  # {0} is a folder; each runs in a process that has not imported MuJoCo
    "list": "list",
    "schema": "suite-schema",
    "completion": "completion bash",
    "plan": "plan --noise-std 0.01",
    "scene": "scene gimbal --set poses=12 --set hold_time=0.5 --set first_hold=3 "
    "--sensor {0}/sensor.toml --every 10 --out {0}/log.csv",
    "sweep": "sweep {0}/suite.toml --out {0}/runs/1 --workers 1 --quiet",
    "gate": "gate {0}/runs/1 --no-baseline",
    "report": "report {0}/runs/1",
    "export": "export {0}/runs/1",
    "compare": "compare {0}/run {0}/runs/1",
    "trend": "trend {0}/runs",
    "repro": "repro calibration(hold_time=0.2,noise_std=0.01,poses=10,scene=gimbal,"
    "trials=128)@1 --run {0}/runs/1",
    "calibrate": "calibrate {0}/log.csv --out {0}/found.json",
    "correct": "correct {0}/log.csv --calibration {0}/found.json "
    "--out {0}/corrected.csv",
    "noise": "noise {0}/log.csv",
    "filter": "filter {0}/corrected.csv --plugin simval:mekf",
}
PROGRAM = """
import json, os, sys
from simval.startup import load_lightly
load_lightly()
import simval.cli
folder, commands = sys.argv[1], json.loads(sys.argv[2])
codes = {}
for name, words in commands.items():
    child = os.fork()
    if child == 0:
        os.dup2(os.open(f"{folder}/{name}.txt", os.O_WRONLY | os.O_CREAT), 1)
        os.dup2(1, 2)
        sys.argv[1:] = words.format(folder).split()
        simval.cli.main()
    codes[name] = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
print(json.dumps(codes), "mujoco._structs" in sys.modules)
"""
SENSOR = """
T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
K = [0.0024, 0.0025, 0.0023]
B = [32768, 32700, 32810]
noise_std_raw = 4.0
"""
HALF_THERE = "def __getattr__(name):\n    raise AttributeError('no library ' + name)\n"
VALUES = [
    "nonsense",
    "EGL ",
    "egl of a machine without it",
    "osmesa",
    "glfw",
    "wgl",
    "disable",
    "0",
    "on",
    "\u00e9",
]


def codes(folder, value, commands):
    """Exit codes of commands, each in a process of its own."""
    folder.mkdir()
    (folder / "suite.toml").write_text("[calibration]\nposes = 10\ntrials = 128\n")
    (folder / "sensor.toml").write_text(SENSOR)
    environment = {**os.environ, "MUJOCO_GL": value.partition(" of")[0]}
    if "without it" in value:
        (folder / "OpenGL").mkdir()
        (folder / "OpenGL" / "__init__.py").write_text("")
        (folder / "OpenGL" / "EGL.py").write_text(HALF_THERE)
        environment["PYTHONPATH"] = str(folder)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder), json.dumps(commands)],
        capture_output=True,
        text=True,
        env=environment,
    )
    found, end = done.stdout.rsplit(" ", 1)
    assert end.strip() == "False"
    said = {name: (folder / f"{name}.txt").read_text() for name in commands}
    assert not [words for words in said.values() if "Traceback" in words]
    return json.loads(found)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Exit codes with no value at all."""
    return codes(tmp_path_factory.mktemp("plain") / "here", "", COMMANDS)


@pytest.mark.slow
@pytest.mark.parametrize("value", VALUES)
def test_no_value_stops_a_command(tmp_path, plain, value):
    # the codes are not all 0: a log of the gimbal has no gyroscope to filter with
    assert plain["scene"] == plain["sweep"] == plain["calibrate"] == 0
    assert codes(tmp_path / "here", value, COMMANDS) == plain


@pytest.mark.ci
@pytest.mark.parametrize("value", ["nonsense", "egl of a machine without it"])
def test_no_value_stops_a_scene(tmp_path, value):
    few = {name: COMMANDS[name] for name in ("list", "plan", "scene", "sweep")}
    assert codes(tmp_path / "here", value, few) == dict.fromkeys(few, 0)


@pytest.mark.ci
@pytest.mark.parametrize("light", [True, False])
@pytest.mark.parametrize("value", ["nonsense", "egl"])
def test_a_process_keeps_its_own_renderer(light, value):
    # a user's process has MuJoCo with the renderer that it asks for, if that is there
    program = (
        "import os\n"
        + ("import simval.startup; simval.startup.load_lightly()\n" if light else "")
        + "from simval.scene.library import mujoco\n"
        "print(mujoco.MjModel.__name__, hasattr(mujoco, 'GLContext'))\n"
        "print(os.environ['MUJOCO_GL'])"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "MUJOCO_GL": value},
    )
    assert done.stdout.split() == ["MjModel", str(value == "egl"), value]


def refused(monkeypatch, value, backends):
    monkeypatch.setenv("MUJOCO_GL", value)
    monkeypatch.setattr(frames, "BACKENDS", backends)
    with pytest.raises(InputError) as caught:
        render("gimbal", poses=2, width=64, height=48)
    return str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("value", ["nonsense", "glfw", "disable", "0", "1", "\u00e9"])
def test_who_draws_is_told_what_there_is(monkeypatch, value):
    said = refused(monkeypatch, value, ("egl", "osmesa", "off"))
    assert f"`MUJOCO_GL` is {value!r}" in said
    if "with egl or osmesa it can" in said:  # a machine that has both
        assert said.endswith("so set it to egl or osmesa, or unset it")


@pytest.mark.ci
def test_who_cannot_draw_is_told_what_to_install(monkeypatch):
    said = refused(monkeypatch, "nonsense", ("off", "false"))
    assert "invalid value" in said
    assert "nor with off or false; install EGL" in said
    assert said.endswith(", and unset it")
