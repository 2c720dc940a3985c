"""The store of a run: damage is one sentence, and never a pass or other numbers."""

import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from light_cells import light
from stores import raw

from simval.cli import run as simval_command
from simval.errors import InputError
from simval.results import Row
from simval.statistics import FAMILIES, Statistic
from simval.sweep import load_run, run_suite, store
from simval.sweep.cells import cell_entry, cell_result, row_entries
from simval.sweep.runner import Progress, drive
from simval.sweep.suite import expand

FILES = ("run.sqlite", "manifest.json", "timing.json", "results.csv")


def damaged(data, rng):
    """Bytes of a file with a bit, a byte or a block changed, swapped or cut off."""
    found = bytearray(data)
    place, other = (int(k) for k in rng.integers(len(found), size=2))
    size = int(rng.integers(1, 5000))
    match int(rng.integers(6)):
        case 0:
            found[place] ^= 1 << int(rng.integers(8))
        case 1:
            found[place] = int(rng.integers(256))
        case 2:
            block = found[place : place + size]
            found[place : place + size] = bytes(len(block))
        case 3:
            del found[place:]
        case 4:
            block = found[other : other + size]
            found[place : place + len(block)] = block
        case 5:
            found[place : place + size] = rng.bytes(size)
    return bytes(found)


def read(folder):
    """All that a reader makes of a run."""
    run = load_run(folder)
    return repr((run.cells, run.manifest, run.timing))


@pytest.mark.parametrize(
    "count",
    [
        pytest.param(24, marks=pytest.mark.ci),
        pytest.param(200, marks=pytest.mark.slow),
    ],
)
def test_damage_is_refused_or_changes_nothing(tiny_run, tmp_path, capsys, count):
    """Copies of a run are damaged; what is not refused must read the same."""
    good, same, rng = read(tiny_run), 0, np.random.default_rng([33, count > 24])
    for number in range(count):
        shutil.copytree(tiny_run, tmp_path / "bad")
        file = tmp_path / "bad" / FILES[int(rng.choice(4, p=[0.7, 0.1, 0.1, 0.1]))]
        file.write_bytes(damaged(file.read_bytes(), rng))
        code = simval_command(["gate", str(tmp_path / "bad"), "--no-baseline"])
        out, err = capsys.readouterr()
        if code == 2:
            assert err.startswith("error: "), (number, file, out, err)
            with pytest.raises(InputError):
                read(tmp_path / "bad")
        else:  # what SQLite does not use
            assert code == 0, (number, file, out, err)
            assert read(tmp_path / "bad") == good, (number, file)
            same += 1
        shutil.rmtree(tmp_path / "bad")
    assert same < count / 2


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        (
            "UPDATE rows SET value = value * 1.01 WHERE cell = 2 AND ordinal = 5",
            "cell attitude.* is not what the sweep stored",
        ),
        ("DELETE FROM rows WHERE cell = 2 AND ordinal = 5", "cell attitude"),
        ("DELETE FROM cells WHERE position = 3", "its cells are not those"),
        ("UPDATE rows SET cell = 99 WHERE cell = 1", "cell .* is not what"),
        ("UPDATE meta SET value = replace(value, 'tiny', 'tony')", "what it says"),
        ("DELETE FROM meta WHERE key = 'manifest'", "what it says of the run"),
        ("UPDATE meta SET value = '99' WHERE key = 'schema'", "this program reads 4"),
        ("DROP TABLE rows", "not the store of a run: no such table"),
    ],
)
def test_a_store_that_was_changed_is_refused(sql, words, tiny_run):
    with raw(tiny_run) as database:
        database.execute(sql)
    with pytest.raises(InputError, match=words):
        load_run(tiny_run)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("run.sqlite", b"", "not the store of a run"),
        ("run.sqlite", b"not a database at all" * 100, "not the store of a run"),
        ("run.sqlite", None, "no run folder"),
        *(("timing.json", text, r"timing\.json is damaged")
          for text in (b"{", b"3", b"\x00")),
    ],
)  # fmt: skip
def test_a_file_that_is_none_is_refused(name, content, words, tiny_run):
    """Of a run that was interrupted, too, which has no digest of its files."""
    with raw(tiny_run) as database:
        store.keep(database, complete=None, files=None)
    (tiny_run / name).unlink()
    if content is not None:
        (tiny_run / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        load_run(tiny_run)


def test_damage_is_not_taken_over_when_a_run_goes_on(tiny_suite, tiny_run):
    with raw(tiny_run) as database:
        store.keep(database, complete=None, files=None)
        database.execute("UPDATE rows SET value = 1.5 WHERE cell = 1 AND ordinal = 1")
    with pytest.raises(InputError, match=r"cell calibration.* is not what"):
        run_suite(str(tiny_suite), tiny_run, resume=True)


def test_files_beside_the_store_are_what_the_sweep_wrote(simval, tiny_run):
    table = tiny_run / "results.csv"
    table.write_text(table.read_text().replace("0.01", "0.02"))
    for command in ("gate", "report", "export"):
        code, _, err = simval(command, tiny_run)
        assert (code, f"{table} has changed since" in err) == (
            2,
            True,
        )
    table.unlink()  # what is missing is no damage: a store alone can be judged
    assert simval("gate", tiny_run, "--no-baseline")[0] == 0


class Reads(Progress):
    """Reads the run after each cell, and keeps a snapshot open to its end."""

    def __init__(self, folder):
        self.folder, self.counts, self.kept = folder, [], []

    def advance(self, name):
        if not self.kept:
            path = self.folder / "run.sqlite"
            self.kept.append(sqlite3.connect(path, isolation_level=None))
            self.kept[0].execute("BEGIN")
            self.kept[0].execute("SELECT count(*) FROM cells").fetchall()
        cells = load_run(self.folder).cells
        self.counts.append(sum(cell.status == "done" for cell in cells))


def test_readers_and_the_sweep_do_not_wait_for_each_other(tmp_path):
    suite = expand("read", {"attitude": {"geometry": [1, 2, 3], "samples": 65_536}})
    reads = Reads(tmp_path / "run")
    drive(suite, tmp_path / "run", progress=reads, work=light)
    assert reads.counts == [1, 2, 3]
    assert len(load_run(tmp_path / "run").cells) == 3
    reads.kept[0].close()
    with closing(sqlite3.connect(tmp_path / "run" / "run.sqlite")) as database:
        database.execute("PRAGMA journal_mode = DELETE")  # as it is where nobody reads
    assert not list((tmp_path / "run").glob("run.sqlite-*"))
    drive(suite, tmp_path / "unread", progress=Progress(), work=light)
    assert not list((tmp_path / "unread").glob("run.sqlite-*"))
    assert (tmp_path / "unread" / "run.sqlite").read_bytes()[18:20] == b"\x01\x01"


AS_ANOTHER = """
import os, sys
from simval.sweep import load_run, load_suite, run_suite
from simval.errors import InputError
good, folder, suite = sys.argv[1:]
suite = load_suite(suite)
run_suite(suite, good, resume=True)  # all modules, which another user cannot read
os.setgroups([]); os.setgid(65534); os.setuid(65534)
print(len(load_run(folder).cells))
for place, resume in ((folder, True), (folder + "/new", False)):
    try:
        run_suite(suite, place, resume=resume)
    except InputError as error:
        print(error)
"""


@pytest.mark.ci
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_a_folder_that_cannot_be_written_is_read_and_not_swept_into(
    tiny_suite, tiny_run
):
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        shutil.copytree(tiny_run, folder)
        for path in (Path(place), folder):
            path.chmod(0o555)
        words = [sys.executable, "-c", AS_ANOTHER, *map(str, (tiny_run, folder))]
        words.append(str(tiny_suite))
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    count, resumed, made = done.stdout.splitlines()
    assert count == "4"
    assert "run.sqlite: attempt to write a readonly database" in resumed
    assert made.startswith("cannot make ")


names = st.text(st.characters(exclude_categories=("C", "Z")), max_size=8)
numbers = st.floats(allow_nan=True) | st.just(-0.0)


@given(
    st.sampled_from(sorted(FAMILIES)),
    st.lists(names, max_size=3),
    st.booleans(),
    numbers,
    st.none() | numbers,
)
def test_every_row_is_read_as_it_was_written(
    family, entries, controlled, value, prediction
):
    kind = FAMILIES[family]
    if not kind.least <= value <= kind.most:
        value = float("nan")
    if prediction is None or not kind.least <= prediction <= kind.most:
        prediction = None
    row = Row(
        statistic=Statistic(kind, tuple(entries), controlled, "m"),
        value=value,
        prediction=prediction,
        n=2**53 - 1,
        standard_error=5e-324,
    )
    assert repr(stored_and_read(row)) == repr(row)


def stored_and_read(row):
    """The row as it comes out of a store that it was put into."""
    cell = cell_entry(0, expand("one", {"attitude": {}}).cells[0], "done")
    with closing(sqlite3.connect(":memory:")) as database:
        database.executescript(store.TABLES)
        (stored,) = row_entries(0, [row])
        marks = ", ".join("?" * len(stored))
        database.execute(f"INSERT INTO rows VALUES ({marks})", stored)
        (found,) = cell_result(cell, database.execute("SELECT * FROM rows")).rows
    return found
