"""`MUJOCO_GL`: its value stops no command that draws nothing, and who draws is told.

MuJoCo ends its own import where the variable names a graphics library that is not
there, so a value that suits no machine would stop whatever builds a scene.
"""

import os
import subprocess
import sys

import pytest

from simval.errors import InputError
from simval.scene import render

SENSOR = """
T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
K = [0.0024, 0.0025, 0.0023]
B = [32768, 32700, 32810]
noise_std_raw = 4.0
"""
HALF_THERE = "def __getattr__(name):\n    raise AttributeError('no library ' + name)\n"
COMMANDS = [
    "list",
    "plan --noise-std 0.01",
    "scene gimbal --set poses=12 --set hold_time=0.5 --set first_hold=3 "
    "--sensor sensor.toml --every 10 --out log.csv",
    "calibrate log.csv",
]


PROGRAM = f"""
import sys
from simval.cli import run
sys.exit(max(run(words.split()) for words in {COMMANDS!r}))
"""


@pytest.mark.ci
@pytest.mark.parametrize("library", [False, True])
def test_no_value_stops_a_command(tmp_path, library):
    """A word that is none, and the name of a library of which a half is there."""
    (tmp_path / "sensor.toml").write_text(SENSOR)
    environment = {**os.environ, "MUJOCO_GL": "egl" if library else "nonsense"}
    if library:
        (tmp_path / "OpenGL").mkdir()
        (tmp_path / "OpenGL" / "__init__.py").write_text("")
        (tmp_path / "OpenGL" / "EGL.py").write_text(HALF_THERE)
        environment["PYTHONPATH"] = str(tmp_path)
    words = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(
        words, capture_output=True, text=True, env=environment, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.ci
@pytest.mark.parametrize("value", ["nonsense", "egl"])
def test_a_process_keeps_its_own_renderer(value):
    # a user's process has MuJoCo with the renderer that it asks for, if that is there
    program = (
        "import os\nfrom simval.scene.physics import mujoco\n"
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


WITHOUT = """
import sys
import simval.check, simval.judge, simval.report, simval.sweep

suite, other, run, page = sys.argv[1:]
simval.report.render(simval.sweep.load_run(run))  # that has scenes
made = simval.sweep.run_suite(suite, page)
simval.report.render(made)
simval.judge.judge_run(made)
print("mujoco" in sys.modules)
simval.sweep.run_suite(other, f"{page}2")
print("mujoco" in sys.modules)
"""


@pytest.mark.ci
def test_the_physics_is_imported_where_a_scene_is_simulated(tiny_run, tmp_path):
    suite, other = tmp_path / "suite.toml", tmp_path / "other.toml"
    suite.write_text(
        "title = 'a'\n[attitude]\nsamples = 65536\n[solvers]\nposes = 12\n"
    )
    other.write_text("title = 'b'\n[scene]\nposes = 12\n")
    words = [sys.executable, "-c", WITHOUT, suite, other, tiny_run, tmp_path / "run"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.stdout.split() == ["False", "True"], done.stderr


@pytest.mark.ci
def test_who_draws_is_told_what_there_is(monkeypatch):
    value = "nonsens\u00e9"
    monkeypatch.setenv("MUJOCO_GL", value)
    with pytest.raises(InputError, match=f"`MUJOCO_GL` {value!r}.*unset it"):
        render("gimbal", poses=2, width=64, height=48)
