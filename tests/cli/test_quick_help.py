"""A help, a version and a completion load none of the libraries that calculate."""

import json
import os
import resource
import subprocess
import sys
from typing import get_args

import pytest

from simval import vocabulary
from simval.cli import COMMANDS
from simval.geometry import FRAMES
from simval.imu.calibrate.accelerometer import choices
from simval.judge import BASELINE
from simval.scene import scenes
from simval.studies import STUDIES
from simval.verdict import ALPHA

PROGRAM = """
import contextlib, io, json, sys
from simval.cli import run
said = io.TextIOWrapper(io.BytesIO())
for words in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(said):
        assert run(words) == 0, words
said.flush()
print(json.dumps([said.buffer.getvalue().decode(), sorted(sys.modules)]))
"""
HEAVY = {"numpy", "scipy", "pydantic", "rich", "mujoco", "matplotlib", "jinja2"}
"""What takes a tenth of a second and more to import."""


def loaded_by(*commands, **environment):
    """What some commands print, and the packages that are loaded after them."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, json.dumps(commands)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **environment},
    )
    said, loaded = json.loads(done.stdout)
    return said, {name.split(".")[0] for name in loaded}


def test_no_help_loads_what_calculates():
    helps = [[name, "--help"] for name, _ in COMMANDS]
    said, loaded = loaded_by(["--help"], ["--version"], *helps)
    assert said.count("Usage: simval") == len(COMMANDS) + 1
    assert loaded & HEAVY == set()


@pytest.mark.parametrize("words", ["simval ", "simval sweep ", "simval gate --"])
def test_no_completion_loads_what_calculates(words):
    asked = {"_SIMVAL_COMPLETE": "bash_complete", "COMP_WORDS": words}
    _, loaded = loaded_by([], **asked, COMP_CWORD=str(words.count(" ")))
    assert loaded & HEAVY == set()


@pytest.mark.parametrize("command", [name for name, _ in COMMANDS])
def test_a_help_takes_less_than_a_third_of_a_second(command):
    """Processor time of a process of its own, the least of three."""
    words = [sys.executable, "-m", "simval", command, "--help"]
    seconds = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(words, stdout=subprocess.DEVNULL, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = (after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime)
        seconds.append(sum(spent))
    assert min(seconds) < 0.3


@pytest.mark.parametrize(
    ("stated", "taken"),
    [
        (vocabulary.MODELS, choices()["model"]),
        (vocabulary.METHODS, choices()["method"]),
        (vocabulary.RESIDUALS, choices()["residual"]),
        (vocabulary.LOSSES, choices()["loss"]),
        (get_args(vocabulary.TruthWorld)[:-1], FRAMES),
        (vocabulary.SCENES, tuple(scenes())),
        (vocabulary.STUDIES, tuple(STUDIES)),
        (vocabulary.ALPHA, ALPHA),
        (vocabulary.BASELINE, BASELINE),
    ],
)
def test_a_help_states_what_the_code_takes(stated, taken):
    assert stated == taken
