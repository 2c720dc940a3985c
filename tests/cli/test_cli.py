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
