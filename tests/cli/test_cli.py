"""The program as a user meets it: help, exit codes, messages."""

import subprocess
import sys

import pytest
from snapshots import same

from simval import cli
from simval.cli import COMMANDS


def test_what_each_command_is_called_with(simval):
    helps = [simval("--help"), *(simval(name, "--help") for name, _ in COMMANDS)]
    assert {code for code, _, _ in helps} == {0}
    same("help.txt", "\n".join(out for _, out, _ in helps))


def test_python_m_is_the_same_program():
    words = [sys.executable, "-m", "simval", "--version"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0
    assert "simval, version" in done.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["swep"], "No such command"),
        (["sweep", "no-such-suite"], "there is no suite `no-such-suite`"),
        (["sweep", "smoke", "--workers", "0"], "workers"),
        (["sweep", "smoke", "--set", "attitude.nois=1"], "not a known key"),
        (["report", "no-such-run"], "no run folder"),
        (["gate", "no-such-run"], "no run folder"),
    ],
)
def test_misuse_is_exit_code_2_in_words(simval, words, message):
    code, _, err = simval(*words)
    assert code == 2
    assert message in err
    assert "Traceback" not in err


def test_an_existing_run_folder_is_refused(simval, tiny_suite, tiny_run):
    code, _, err = simval("sweep", tiny_suite, "--out", tiny_run)
    assert code == 2
    assert "exists" in err


@pytest.mark.ci
def test_sweep_prints_the_folder_last(simval, tiny_suite, tmp_path):
    folder = tmp_path / "run"
    code, out, err = simval("sweep", tiny_suite, "--out", folder, "--workers", 1)
    assert code == 0
    assert out.splitlines()[-1] == str(folder)
    assert "4/4" in err


def test_a_crashed_cell_is_exit_code_4(simval, tiny_suite, tmp_path, monkeypatch):
    from simval.sweep import executors

    def broken(cell):
        msg = "on purpose"
        raise RuntimeError(msg)

    monkeypatch.setattr(executors, "execute", broken)
    words = ("sweep", tiny_suite, "--out", tmp_path / "run", "--workers", 1)
    code, _, err = simval(*words)
    assert code == 4
    assert "RuntimeError: on purpose" in err


@pytest.mark.ci
def test_ctrl_c_is_130(simval, tiny_suite, tmp_path, monkeypatch):
    from simval.sweep import executors

    def interrupted(cell):
        raise KeyboardInterrupt

    monkeypatch.setattr(executors, "execute", interrupted)
    words = ("sweep", tiny_suite, "--out", tmp_path / "run", "--workers", 1)
    assert simval(*words)[0] == 130
    monkeypatch.undo()
    assert simval(*words, "--resume")[0] == 0


def test_a_bug_of_ours_is_70(monkeypatch, capsys):
    def broken(arguments):
        msg = "a bug"
        raise RuntimeError(msg)

    monkeypatch.setattr(cli, "run", broken)
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 70
    assert "please report it" in capsys.readouterr().err


def test_dry_run_lists_the_cells(simval, tiny_suite):
    code, out, _ = simval("sweep", tiny_suite, "--dry-run")
    assert code == 0
    assert len(out.splitlines()) == 5


def test_list_names_suites_studies_and_scenes(simval):
    code, out, _ = simval("list")
    assert code == 0
    for word in ("smoke", "accuracy", "attitude", "noise_std", "gimbal", "die"):
        assert word in out
