"""A help, a version and a completion load none of the libraries that calculate."""

import json
import os
import subprocess
import sys

import pytest

from simval import vocabulary
from simval.calibrate.arguments import choices
from simval.cli import COMMANDS
from simval.judge import BASELINE
from simval.plugins.attitudes import FRAMES
from simval.recorded.run import TIME_LIMIT
from simval.scene import scenes
from simval.studies import STUDIES
from simval.verdict import ALPHA

LIGHT = ("cli", "errors", "startup", "text", "vocabulary", "whole")
OWN = {f"simval.{x}" for x in LIGHT}
"""Packages and modules of simval that a help may load."""
OTHERS = {"click", "typing_extensions"}
"""Packages beside the standard library's that it may load."""

PROGRAM = """
import contextlib, io, json, sys
before = {name.split('.')[0] for name in sys.modules}  # what the interpreter's site has
from simval.cli import run
said = io.TextIOWrapper(io.BytesIO())
for words in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(said):
        assert run(words) == 0, words
said.flush()
loaded = set(sys.modules)
print(json.dumps([said.buffer.getvalue().decode(), sorted(loaded), sorted(before)]))
"""


def asked(words):
    """Environment of the program when bash asks what completes the last word."""
    number = str(words.count(" "))
    return {"_SIMVAL_COMPLETE": "bash_complete", "COMP_WORDS": words} | {
        "COMP_CWORD": number
    }


def loaded_by(*commands, environment=()):
    """What some commands print, and the modules that are loaded after them."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, json.dumps(commands)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **dict(environment)},
    )
    said, loaded, before = json.loads(done.stdout)
    return said, set(loaded), set(before)


def strangers(loaded, before):
    """Modules that a quick command must not load."""
    own = {
        ".".join(name.split(".")[:2]) for name in loaded if name.startswith("simval.")
    }
    roots = {name.split(".")[0] for name in loaded} - before
    known = sys.stdlib_module_names | OTHERS | {"simval", "__main__", "__mp_main__"}
    return sorted((own - OWN) | (roots - known))


def test_no_help_loads_more_than_click():
    helps = [[name, "--help"] for name, _ in COMMANDS]
    said, loaded, before = loaded_by(["--help"], ["--version"], *helps)
    assert said.count("Usage: simval") == len(COMMANDS) + 1
    assert strangers(loaded, before) == []
    # what does the work of a command is not loaded, not even by another command
    own = {name for name in loaded if name.startswith("simval.cli.")}
    assert {f"simval.cli.{name}" for name, _ in COMMANDS} & own == set()


@pytest.mark.parametrize("words", ["simval ", "simval sweep ", "simval gate --"])
def test_no_completion_loads_more_than_click(words):
    _, loaded, before = loaded_by([], environment=asked(words))
    assert "click.shell_completion" in loaded
    assert strangers(loaded, before) == []


def test_a_stranger_is_seen():
    """The power of the tests above."""
    light = {"os", "click.core", "json.decoder", "simval", "simval.cli.commands.gate"}
    assert strangers(light, set()) == []
    heavy = {"numpy.linalg", "simval.sweep.run", "pydantic", "_site_of_this_machine"}
    found = strangers(light | heavy, {"_site_of_this_machine"})
    assert found == ["numpy", "pydantic", "simval.sweep"]


@pytest.mark.parametrize(
    ("stated", "taken"),
    [
        (vocabulary.MODELS, choices()["model"]),
        (vocabulary.METHODS, choices()["method"]),
        (vocabulary.RESIDUALS, choices()["residual"]),
        (vocabulary.LOSSES, choices()["loss"]),
        (vocabulary.FRAMES, FRAMES),
        (vocabulary.SCENES, tuple(scenes())),
        (vocabulary.STUDIES, tuple(STUDIES)),
        (vocabulary.ALPHA, ALPHA),
        (vocabulary.BASELINE, BASELINE),
        (vocabulary.FILTER_SECONDS, TIME_LIMIT),
    ],
)
def test_a_help_states_what_the_code_takes(stated, taken):
    assert stated == taken
