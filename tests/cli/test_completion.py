"""What a shell completes, asked as shells ask, and by bash itself."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from simval import vocabulary
from simval.cli import COMMANDS


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


def test_commands_and_options_are_completed(complete):
    assert complete("simval ") == plain(*(name for name, _ in COMMANDS))
    assert complete("simval cal") == plain("calibrate")
    assert complete("simval sweep --dry") == plain("--dry-run")
    models = complete("simval plan --model ")
    assert models == plain(*vocabulary.MODELS)


def test_values_are_completed(complete):
    assert complete("simval sweep ") == plain(*vocabulary.builtin_suites())
    assert complete("simval sweep smoke --set attitude_l") == plain("attitude_limits.")
    assert complete("simval scene ") == plain(*vocabulary.SCENES)
    assert complete("simval scene d") == plain("die")
    assert complete("simval sweep my") == [["file", "my"]]


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


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_each_shell_asks_this_program(simval, shell):
    code, out, _ = simval("completion", shell)
    assert code == 0
    assert f"_SIMVAL_COMPLETE={shell}_complete" in out
    code, _, err = simval("completion", "tcsh")
    assert code == 2
    assert "'tcsh' is not one of" in err


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
    "environment",
    [
        {"_SIMVAL_COMPLETE": "bash_complete"},
        {"_SIMVAL_COMPLETE": "bash_complete", "COMP_WORDS": "", "COMP_CWORD": "one"},
        {"_SIMVAL_COMPLETE": "nonsense"},
    ],
    ids=["no words", "no number", "no shell"],
)
def test_a_wrong_question_is_no_bug_of_ours(simval, monkeypatch, environment):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    code, out, err = simval()
    assert (code, out) == (2, "")
    assert "Traceback" not in err


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.text("asweprt -'\"\\/.=\n{}é", max_size=20))
def test_any_line_completes_to_something_or_nothing(complete, line):
    for entry in complete(f"simval {line}"):
        assert entry[0] in ("plain", "file", "dir")
