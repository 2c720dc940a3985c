"""Readers of a run and the sweep that writes it: none keeps the other from its end."""

import os
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from simval.errors import InputError
from simval.sweep import connections as doors
from simval.sweep import load_run, run_suite, runner
from simval.sweep.holders import holders

SMALL = 'title = "S"\n[attitude]\nnoise_std = [0.01, 0.02]\nsamples = 65536\n'
HOLD = """
import sqlite3, sys
database = sqlite3.connect(sys.argv[1], isolation_level=None)
for statement in sys.argv[2:]:
    database.execute(statement).fetchall()
print("ready", flush=True)
sys.stdin.read()
"""
OPEN = ("SELECT count(*) FROM cells",)
SNAPSHOT = ("BEGIN", *OPEN)
WRITER = ("BEGIN IMMEDIATE",)


@contextmanager
def held(store, statements):
    """Another process that has a store open until the end of the block."""
    words = [sys.executable, "-S", "-c", HOLD, str(store), *statements]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, **pipes) as process:
        assert process.stdout.readline() == "ready\n"
        try:
            yield process
        finally:
            process.stdin.close()
            process.wait(timeout=60)


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


def at_the_end(monkeypatch, folder, statements, stack):
    """Let another process open the store just before the sweep seals it."""
    real = runner.seal

    def seal(database, place):
        stack.append(held(folder / "run.sqlite", statements))
        stack.append(stack[0].__enter__())
        real(database, place)

    monkeypatch.setattr(runner, "seal", seal)


@pytest.mark.ci
@pytest.mark.parametrize("statements", [OPEN, SNAPSHOT])
def test_a_reader_at_the_end_is_named_and_not_waited_for(
    statements, suite, tmp_path, simval, monkeypatch
):
    """The old end needed the file for itself: "database is locked", exit code 2."""
    monkeypatch.setattr(doors, "READERS", 0.1)
    folder, stack = tmp_path / "run", []
    at_the_end(monkeypatch, folder, statements, stack)
    code, out, err = simval("sweep", suite, "--out", folder, "--workers", 1, "--quiet")
    try:
        assert (code, out.strip()) == (0, str(folder))
        assert f"is open in process {stack[1].pid} (python" in err
        assert "the run is complete" in err
        # what the reader began with is what it still sees; all others see the end
        assert simval("gate", folder, "--no-baseline")[0] == 0
        assert {"manifest.json", "timing.json", "results.csv", "run.sqlite-wal"} <= {
            file.name for file in folder.iterdir()
        }
    finally:
        stack[0].__exit__(None, None, None)
    # the last one who closes it leaves one file
    assert simval("gate", folder, "--no-baseline")[0] == 0
    assert not (folder / "run.sqlite-wal").exists()
    cells = load_run(folder).cells
    assert [cell.status for cell in cells] == ["done", "done"]


def test_a_sweep_that_nobody_reads_leaves_one_file(suite, tmp_path, simval):
    folder = tmp_path / "run"
    assert simval("sweep", suite, "--out", folder, "--workers", 1)[0] == 0
    with (folder / "run.sqlite").open("rb") as content:
        assert content.read(20)[18:] == b"\x01\x01"  # no log is asked for
    assert not list(folder.glob("run.sqlite-*"))


def test_a_short_reader_is_waited_for(suite, tmp_path, monkeypatch):
    """A gate reads for less than a second: the run is one file again."""
    monkeypatch.setattr(doors, "READERS", 30.0)
    folder, stack = tmp_path / "run", []
    at_the_end(monkeypatch, folder, SNAPSHOT, stack)
    real = time.sleep

    def sleep(seconds):
        if stack:  # the sweep waits
            monkeypatch.setattr(time, "sleep", real)
            stack.pop(0).__exit__(None, None, None)

    monkeypatch.setattr(doors.time, "sleep", sleep)
    run_suite(suite, folder)
    assert len(stack) == 1  # it has waited
    assert not list(folder.glob("run.sqlite-*"))


@pytest.mark.ci
def test_one_who_writes_is_waited_for_and_named(suite, tmp_path, monkeypatch):
    monkeypatch.setattr(doors, "PATIENCE", 0.1)
    folder, whole = tmp_path / "run", tmp_path / "whole"
    real, stack = runner.unseal, []

    def unseal(database):
        stack.append(held(folder / "run.sqlite", WRITER))
        stack.append(stack[0].__enter__())
        real(database)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "unseal", unseal)
        with pytest.raises(InputError) as caught:
            run_suite(suite, folder)
    stack[0].__exit__(None, None, None)
    assert f"is locked by process {stack[1].pid} (python" in str(caught.value)
    assert "close it there, and continue with `simval sweep ... --resume`" in str(
        caught.value
    )
    run_suite(suite, folder, resume=True)
    run_suite(suite, whole)
    table = "results.csv"
    assert (folder / table).read_bytes() == (whole / table).read_bytes()


def test_a_reader_from_the_first_moment_keeps_no_sweep_from_its_start(
    suite, tmp_path, monkeypatch
):
    """The store appears with its log, so no change of its mode meets a reader."""
    monkeypatch.setattr(doors, "PATIENCE", 0.1)
    monkeypatch.setattr(doors, "READERS", 0.1)
    folder, stack = tmp_path / "run", []
    real = runner.create

    def create(*words):
        real(*words)
        stack.append(held(folder / "run.sqlite", SNAPSHOT))
        stack[0].__enter__()

    monkeypatch.setattr(runner, "create", create)
    run_suite(suite, folder)
    stack[0].__exit__(None, None, None)
    assert (folder / "manifest.json").exists()


def test_a_reader_writes_nothing(tiny_run):
    with (
        closing(doors.to_read(tiny_run / "run.sqlite", *STORE)) as database,
        pytest.raises(sqlite3.OperationalError, match="readonly"),
    ):
        database.execute("DELETE FROM rows")


STORE = (runner.store.TABLES, runner.store.SCHEMA_VERSION)


def test_a_journal_of_another_hand_is_not_rolled_back(tiny_run):
    """SQLite would play it back, and remove the file that it names."""
    (tiny_run / "run.sqlite-journal").write_bytes(b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7")
    with pytest.raises(InputError, match="is left of a program that was stopped"):
        load_run(tiny_run)


@pytest.mark.ci
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_a_run_on_a_medium_that_cannot_be_written(tiny_run):
    """As left by a reader at the end: a store that asks for a log, and has none."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        tiny_run.rename(folder)
        with closing(sqlite3.connect(folder / "run.sqlite")) as database:
            database.execute("PRAGMA journal_mode = WAL")
        for path in (Path(place), folder):
            path.chmod(0o555)
        program = (
            "import os, sys\n"
            "from simval.sweep import load_run\n"
            "load_run(sys.argv[1])  # all modules, which the other user cannot read\n"
            "os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
            "print(len(load_run(sys.argv[1]).cells))\n"
        )
        words = [sys.executable, "-c", program, str(folder)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert (done.stdout, done.returncode) == ("4\n", 0), done.stderr


def test_holders_are_other_processes(tiny_run):
    store = tiny_run / "run.sqlite"
    with closing(sqlite3.connect(store)) as own:
        own.execute("SELECT count(*) FROM cells").fetchone()
        assert holders(store) == []
        with held(store, OPEN) as process:
            (found,) = holders(store)
            assert found.startswith(f"process {process.pid} (python")
    assert holders(tiny_run / "nothing") == []
