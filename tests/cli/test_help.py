"""The program as a user meets it: helps, what a shell completes, and a bug of ours.

A help, a version and a completion load none of the libraries that calculate.
"""

import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from snapshots import same

from simval import cli, vocabulary
from simval.cli import COMMANDS
from simval.geometry import FRAMES
from simval.imu.calibrate.accelerometer import choices
from simval.judge import BASELINE
from simval.scene import scenes
from simval.studies import STUDIES
from simval.verdict import ALPHA

NAMES = [name for name, _ in COMMANDS]


def test_what_each_command_is_called_with(simval):
    helps = [simval("--help"), *(simval(name, "--help") for name in NAMES)]
    assert {code for code, _, _ in helps} == {0}
    same("help.txt", "\n".join(out for _, out, _ in helps))


def test_a_bug_of_ours_is_70(monkeypatch, capsys):
    def broken(arguments):
        msg = "a bug"
        raise RuntimeError(msg)

    monkeypatch.setattr(cli, "run", broken)
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 70
    assert "please report it" in capsys.readouterr().err


def test_what_there_is_is_listed(simval, tiny_suite):
    code, out, _ = simval("sweep", tiny_suite, "--dry-run")
    assert (code, len(out.splitlines())) == (0, 5)
    code, out, _ = simval("list")
    assert code == 0
    for word in ("smoke", "accuracy", "attitude", "noise_std", "gimbal", "die"):
        assert word in out


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


def test_no_help_and_no_completion_loads_what_calculates():
    helps = [[name, "--help"] for name in NAMES]
    said, loaded = loaded_by(["--help"], ["--version"], *helps)
    assert said.count("Usage: simval") == len(NAMES) + 1
    assert "simval, version" in said
    assert loaded & HEAVY == set()
    for words in ("simval ", "simval sweep ", "simval gate --"):
        asked = {"_SIMVAL_COMPLETE": "bash_complete", "COMP_WORDS": words}
        _, loaded = loaded_by([], **asked, COMP_CWORD=str(words.count(" ")))
        assert loaded & HEAVY == set()


def seconds(command):
    """Processor time of a help in a process of its own."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "simval", command, "--help"]
    subprocess.run(words, stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


@pytest.mark.parametrize("command", ["--version", "calibrate", "sweep"])
def test_a_help_takes_less_than_a_third_of_a_second(command):
    """In the best of three tries; most need one."""
    assert any(seconds(command) < 0.3 for _ in range(3))


@pytest.mark.parametrize(
    ("stated", "taken"),
    [
        *((getattr(vocabulary, f"{name.upper()}S"), choices()[name])
          for name in ("model", "method", "residual")),
        (vocabulary.LOSSES, choices()["loss"]),
        (get_args(vocabulary.TruthWorld)[:-1], FRAMES),
        (vocabulary.SCENES, tuple(scenes())),
        (vocabulary.STUDIES, tuple(STUDIES)),
        (vocabulary.ALPHA, ALPHA),
        (vocabulary.BASELINE, BASELINE),
    ],
)  # fmt: skip
def test_a_help_states_what_the_code_takes(stated, taken):
    assert stated == taken


# what a shell completes, asked as shells ask


@pytest.fixture
def complete(simval, monkeypatch):
    """Words that bash is offered for the last one of a line."""

    def ask(line):
        words = line.split(" ")
        monkeypatch.setenv("_SIMVAL_COMPLETE", "bash_complete")
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
        code, out, err = simval()
        assert (code, err) == (0, "")
        return [entry.split(",", 1) for entry in out.splitlines() if entry]

    return ask


def plain(*names):
    return [["plain", name] for name in names]


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("", NAMES),
        ("cal", ["calibrate"]),
        ("sweep --dry", ["--dry-run"]),
        ("plan --model ", vocabulary.MODELS),
        ("sweep ", vocabulary.builtin_suites()),
        ("sweep smoke --set attitude_l", ["attitude_limits."]),
        ("scene ", vocabulary.SCENES),
        ("scene d", ["die"]),
    ],
)
def test_commands_options_and_values_are_completed(complete, line, names):
    assert complete(f"simval {line}") == plain(*names)


@pytest.mark.parametrize(
    "line", ["report ", "gate ", "export ", "compare a ", "repro cell --run "]
)
def test_runs_are_completed_the_newest_first(complete, line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert complete(f"simval {line}") == [["file", ""]]
    for age, name in ((30, "old"), (20, "new")):
        store = tmp_path / vocabulary.RUNS / name / "run.sqlite"
        store.parent.mkdir(parents=True)
        store.touch()
        os.utime(store, (2e9 - age, 2e9 - age))
    (tmp_path / vocabulary.RUNS / "no-run").mkdir()
    folders = [str(vocabulary.RUNS / name) for name in ("new", "old")]
    assert complete(f"simval {line}") == plain("latest", *folders)
    assert complete(f"simval {line}reports/runs/o") == plain(folders[1])
    assert complete(f"simval {line}elsewhere") == [["file", "elsewhere"]]


def test_the_script_of_each_shell_asks_this_program(simval):
    for shell in ("bash", "zsh", "fish"):
        code, out, _ = simval("completion", shell)
        assert (code, f"_SIMVAL_COMPLETE={shell}_complete" in out) == (0, True)
    code, _, err = simval("completion", "tcsh")
    assert (code, "'tcsh' is not one of" in err) == (2, True)


def test_bash_completes_by_the_script(tmp_path):
    program = Path(sys.executable).with_name("simval")
    if not (shutil.which("bash") and program.exists()):
        pytest.skip("needs bash and the installed program")
    script = (
        f'eval "$({program} completion bash)"; COMP_WORDS=(simval sweep smo); '
        f'COMP_CWORD=2; _simval_completion {program}; echo "${{COMPREPLY[@]}}"'
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", script], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.stdout == "smoke\n", done.stderr


@pytest.mark.parametrize(
    "asked",
    [
        {"_SIMVAL_COMPLETE": "bash_complete"},
        {"_SIMVAL_COMPLETE": "bash_complete", "COMP_WORDS": "", "COMP_CWORD": "one"},
        {"_SIMVAL_COMPLETE": "nonsense"},
    ],
)
def test_a_wrong_question_is_no_bug_of_ours(simval, monkeypatch, asked):
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    code, out, err = simval()
    assert (code, out, "Traceback" in err) == (2, "", False)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.text("asweprt -'\"\\/.=\n{}é", max_size=20))
def test_any_line_completes_to_something_or_nothing(complete, line):
    for entry in complete(f"simval {line}"):
        assert entry[0] in ("plain", "file", "dir")
