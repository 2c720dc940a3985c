"""Readers of a run and the sweep that writes it: none keeps the other from its end."""

import os
import random
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest

from simval.errors import InputError
from simval.sweep import connections as doors
from simval.sweep import load_run, run_suite, runner
from simval.sweep.connections import JOURNAL_MAGIC
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


def interrupted(run, statement):
    """Leave a run as a sweep does that is killed in the middle of a transaction."""
    path = run / "run.sqlite"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        for each in ("PRAGMA cache_size = 1", "BEGIN", statement):
            database.execute(each)
        parts = [path, Path(f"{path}-journal")]
        content = [part.read_bytes() for part in parts]
        assert content[1]
        database.execute("ROLLBACK")
    for part, each in zip(parts, content, strict=True):
        part.write_bytes(each)
    return parts[1]


MEDDLED = "UPDATE rows SET value = value + 1"


def test_a_sweep_that_is_killed_in_a_change_of_mode_is_read(tiny_run):
    """A journal is left then, and SQLite brings the store back by it."""
    before = load_run(tiny_run)
    journal = interrupted(tiny_run, MEDDLED)
    now = load_run(tiny_run)
    assert [cell.rows for cell in now.cells] == [cell.rows for cell in before.cells]
    assert not journal.exists()


def named(journal, file):
    """A journal that ends with the name of another one, which SQLite then removes."""
    name = str(file).encode()
    tail = struct.pack(">II", len(name), sum(name)) + JOURNAL_MAGIC
    return struct.pack(">I", 0x40000001) + name + tail


def test_a_journal_of_another_hand_is_not_rolled_back(tiny_run, tmp_path):
    """SQLite would play it back, and remove the file that it names."""
    journal = interrupted(tiny_run, MEDDLED)
    mine = tmp_path / "mine"
    mine.write_bytes(b"kept")
    journal.write_bytes(journal.read_bytes() + named(journal, mine))
    with pytest.raises(InputError, match="is of no sweep: it names another file"):
        load_run(tiny_run)
    assert mine.read_bytes() == b"kept"
    # and that it would have been removed: what is tested can happen
    with closing(sqlite3.connect(tiny_run / "run.sqlite")) as database:
        database.execute("SELECT count(*) FROM rows")
    assert not mine.exists()


@pytest.mark.parametrize(("more", "page"), [(1, 4096), (2**20, 4096), (2**20, 0)])
def test_a_journal_does_not_make_a_store_longer(tiny_run, more, page):
    """A page of 0 bytes stands for one of the store's."""
    journal = interrupted(tiny_run, MEDDLED)
    length = (tiny_run / "run.sqlite").stat().st_size
    content = bytearray(journal.read_bytes())
    content[16:20] = struct.pack(">I", length // 4096 + more)
    content[24:28] = struct.pack(">I", page)
    journal.write_bytes(content)
    with pytest.raises(InputError, match="is of no sweep: it makes the store longer"):
        load_run(tiny_run)
    assert (tiny_run / "run.sqlite").stat().st_size == length


@pytest.mark.parametrize("suffix", ["-journal", "-wal"])
def test_what_is_left_is_not_written_to_a_file_of_another_name(
    tiny_run, tmp_path, suffix
):
    """SQLite brings it into whatever has the name of the store."""
    journal, path = interrupted(tiny_run, MEDDLED), tiny_run / "run.sqlite"
    journal.rename(f"{path}{suffix}")
    mine = tmp_path / "mine"
    mine.write_bytes(b"kept\n" * 10_000)
    path.unlink()
    os.link(mine, path)
    with pytest.raises(InputError, match="is a file that has another name"):
        load_run(tiny_run)
    assert mine.read_bytes() == b"kept\n" * 10_000


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read it")
def test_a_journal_that_cannot_be_read_is_said(tiny_run):
    journal = interrupted(tiny_run, MEDDLED)
    journal.chmod(0)
    with pytest.raises(InputError, match="is it yours to read"):
        load_run(tiny_run)


@pytest.mark.parametrize("seed", range(2))
def test_damaged_journals_end_in_words(tiny_run, seed):
    """Bytes of the journal changed, cut and repeated, at random."""
    rows = [cell.rows for cell in load_run(tiny_run).cells]
    journal = interrupted(tiny_run, MEDDLED)
    kept = [(file, file.read_bytes()) for file in (tiny_run / "run.sqlite", journal)]
    names = {file.name for file in tiny_run.iterdir()}
    rng = random.Random(seed)
    for _ in range(30):
        for file, content in kept:
            file.write_bytes(content)
        content = bytearray(kept[1][1])
        place = rng.choice([rng.randrange(28), rng.randrange(len(content))])
        match rng.randrange(4):
            case 0:
                content[place] = rng.randrange(256)
            case 1:
                del content[place:]
            case 2:
                content[place:place] = rng.randbytes(rng.randrange(1, 40))
            case 3:
                content += content[place:]
        journal.write_bytes(content)
        with suppress(InputError):  # what is read is what was there
            now = load_run(tiny_run)
            assert [cell.rows for cell in now.cells] == rows
        assert (tiny_run / "run.sqlite").stat().st_size <= len(kept[0][1])
        assert {file.name for file in tiny_run.iterdir()} <= names


READ = """
import os, sys
from simval.errors import InputError
from simval.sweep import load_run
load_run(sys.argv[1])  # all modules, which the other user cannot read
os.setgroups([]); os.setgid(65534); os.setuid(65534)
try:
    print(len(load_run(sys.argv[2]).cells))
except InputError as error:
    print(error)
"""


@pytest.mark.ci
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize("killed", [False, True])
def test_a_run_on_a_medium_that_cannot_be_written(tiny_run, killed):
    """As left by a reader at the end: a store that asks for a log, and has none.

    Or with a journal, which cannot be played back there: never half of a store.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        shutil.copytree(tiny_run, folder)
        with closing(sqlite3.connect(folder / "run.sqlite")) as database:
            database.execute("PRAGMA journal_mode = WAL")
            if killed:
                database.execute("PRAGMA journal_mode = DELETE")
        if killed:
            interrupted(folder, MEDDLED)
        for path in (Path(place), folder):
            path.chmod(0o555)
        words = [sys.executable, "-c", READ, str(tiny_run), str(folder)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        wanted = "readonly database; is the disk full or read-only?" if killed else "4"
        assert done.stdout.strip().endswith(wanted)


def test_holders_are_other_processes(tiny_run):
    store = tiny_run / "run.sqlite"
    with closing(sqlite3.connect(store)) as own:
        own.execute("SELECT count(*) FROM cells").fetchone()
        assert holders(store) == []
        with held(store, OPEN) as process:
            (found,) = holders(store)
            assert found.startswith(f"process {process.pid} (python")
    assert holders(tiny_run / "nothing") == []
