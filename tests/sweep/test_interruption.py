"""Ctrl-C: never lost, whatever swallows it, and never a bug of ours."""

import gc
import os
import signal
import subprocess
import sys
import weakref

import pytest

from simval.cli import main
from simval.cli.interruption import Interruption, heed, watch
from simval.sweep import executors, load_run


@pytest.fixture
def handlers():
    """Whatever a test installs is taken away."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def swallowed(number=signal.SIGINT):
    """Send a signal where Python drops what its handler raises."""

    class Thing:
        pass

    thing = Thing()
    kept = weakref.ref(thing, lambda _: os.kill(os.getpid(), number))
    del thing
    gc.collect()
    assert kept() is None


def mistaken(number=signal.SIGINT):
    """Send a signal where an extension module makes another error of it."""
    try:
        os.kill(os.getpid(), number)
    except KeyboardInterrupt:
        msg = "initialization failed"
        raise ImportError(msg) from None


def ended(monkeypatch, *words):
    """Exit code of the program."""
    monkeypatch.setattr(sys, "argv", ["simval", *map(str, words)])
    with pytest.raises(SystemExit) as caught:
        main()
    return caught.value.code


@pytest.mark.ci
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize(
    ("number", "words"), [(signal.SIGINT, ()), (signal.SIGTERM, ("--quiet",))]
)
def test_a_sweep_stops_though_its_ctrl_c_was_dropped(
    tiny_suite, tmp_path, monkeypatch, capsys, words, number
):
    done = []

    def execute(cell):
        done.append(cell)
        swallowed(number)
        msg = "not of interest"
        raise RuntimeError(msg)

    monkeypatch.setattr(executors, "execute", execute)
    words = ("sweep", tiny_suite, "--out", tmp_path / "run", "--workers", 1, *words)
    assert ended(monkeypatch, *words) == 130
    assert len(done) == 1  # the cell in which it came, and no other
    assert capsys.readouterr().err.endswith("interrupted\n")
    status = [cell.status for cell in load_run(tmp_path / "run").cells]
    assert status == ["failed", *["pending"] * 3]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize("how", [swallowed, mistaken])
def test_what_was_interrupted_is_neither_done_nor_a_bug(how, monkeypatch, capsys):
    monkeypatch.setattr("simval.cli.run", lambda words: how() or 0)
    assert ended(monkeypatch) == 130
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.usefixtures("handlers")
def test_a_ctrl_c_that_the_shell_ignores_stays_ignored():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    handler = watch()
    os.kill(os.getpid(), signal.SIGINT)
    assert not handler.asked
    heed()
    assert isinstance(signal.getsignal(signal.SIGTERM), Interruption)


STOPPED = """
import os, signal
from simval import cli

def run(words):
    try:
        exec("os.kill(os.getpid(), signal.SIGINT)")
    except KeyboardInterrupt:
        return 130

cli.run = run
cli.main()
"""


def test_an_interrupted_text_leaves_the_exit_code_ours(tmp_path):
    """`python -m` ends by the signal once `exec` of a text was interrupted."""
    (tmp_path / "stopped.py").write_text(STOPPED)
    words = [sys.executable, "-m", "stopped"]
    listening = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    ended = subprocess.run(words, cwd=tmp_path, timeout=60, **listening)
    assert ended.returncode == 130
