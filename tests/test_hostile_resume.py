"""A run folder of an enemy that is continued: nothing is written outside of it.

Who resumes writes: tables, times, manifest, seal. Whatever stands under a name that is
written is replaced or refused, never opened; what the store says of machines and times
is checked before a cell is computed.
"""

import json
import os

import numpy as np
import pytest
from hostile import JSON_VALUES, put
from stores import raw
from test_safety import watched

from simval.errors import InputError
from simval.studies import STUDIES
from simval.sweep.suite import load_suite

WRITTEN = ("results.csv", "timing.json", "manifest.json")
PLACES = (
    *WRITTEN,
    *(f"{name}.part" for name in WRITTEN),
    *("artifacts", "results", "results.part"),
    *(f"run.sqlite{end}" for end in ("-shm", "-wal", "-journal", ".part")),
)
KINDS = ("file", "hard", "dir", "new", "loop", "pipe", "socket", "folder")


@pytest.fixture
def outside(tmp_path):
    """What is not the run's: a file and a folder."""
    place = tmp_path / "outside"
    (place / "folder").mkdir(parents=True)
    (place / "mine").write_text("mine")
    (place / "folder" / "kept").write_text("kept")
    return place


def content(folder):
    return {f: f.is_dir() or f.read_bytes() for f in sorted(folder.rglob("*"))}


def lay(path, kind, outside):
    """Something else under a name in a run folder."""
    if path.is_file():
        path.unlink()
    match kind:
        case "file":
            path.symlink_to(outside / "mine")
        case "hard":
            os.link(outside / "mine", path)
        case "dir":
            path.symlink_to(outside / "folder")
        case "new":
            path.symlink_to(outside / "new")
        case "loop":
            path.symlink_to(path.name)
        case _:
            put(path, kind)


@pytest.mark.ci
@pytest.mark.parametrize("name", PLACES)
def test_a_resume_writes_nothing_outside(name, tiny_run, tiny_suite, outside, simval):
    before, kept = content(outside), content(tiny_run)
    for number, kind in enumerate(KINDS):
        for file in tiny_run.iterdir():
            put(file, "folder")
            file.rmdir()
        for file, data in kept.items():
            file.write_bytes(data)
        if (number + PLACES.index(name)) % 2:  # as one that was interrupted
            with raw(tiny_run) as database:
                database.execute("DELETE FROM meta WHERE key = 'files'")
        lay(tiny_run / name, kind, outside)
        with watched():
            code, _, err = simval(
                "sweep", tiny_suite, "--out", tiny_run, "--resume", "--quiet"
            )
        assert content(outside) == before, kind
        assert (code, err[:7]) in ((0, ""), (2, "error: ")), (kind, code, err)
        if code == 0:
            code, _, err = simval("gate", tiny_run, "--no-baseline")
            assert (code, err) == (0, ""), kind


def test_a_part_that_is_a_link_is_not_written_through(
    tiny_run, tiny_suite, outside, simval
):
    """The one that was found first, every time."""
    (tiny_run / "timing.json.part").symlink_to(outside / "mine")
    words = ("sweep", tiny_suite, "--out", tiny_run, "--resume", "--quiet")
    assert simval(*words)[0] == 0
    assert (outside / "mine").read_text() == "mine"
    assert not (tiny_run / "timing.json").is_symlink()


@pytest.mark.ci
@pytest.mark.parametrize("key", ["machines", "times of x(a=1)@7"])
def test_what_a_store_says_of_machines_and_times_is_checked(
    key, tiny_run, tiny_suite, simval
):
    rng = np.random.default_rng(22)
    values = [json.dumps(value) for value in JSON_VALUES]
    values += [json.dumps({"{}": value}) for value in JSON_VALUES]
    values += [json.dumps({json.dumps(value): 1}) for value in JSON_VALUES]
    values += ["", "{", "[1", b"\xff\xfe", "\x00"]
    machine = {"system": "", "processor": "", "kernels": []}
    values += [
        json.dumps({json.dumps(machine | {name: value}): 1})
        for name in machine
        for value in JSON_VALUES
        if not (isinstance(value, str) and name != "kernels")
    ]
    before = (tiny_run / "timing.json").read_bytes()
    for at in rng.choice(len(values), 30, replace=False):
        with raw(tiny_run) as database:
            database.execute("DELETE FROM meta WHERE key = ?", (key,))
            database.execute("INSERT INTO meta VALUES (?, ?)", (key, values[at]))
        words = ("sweep", tiny_suite, "--out", tiny_run, "--resume", "--quiet")
        code, _, err = simval(*words)
        if key == "machines" and values[at] in ("", "{}"):
            assert code == 0  # of a version that did not keep it
            before = (tiny_run / "timing.json").read_bytes()
            continue
        assert code == 2, values[at]
        assert "is damaged: " in err
        assert (tiny_run / "timing.json").read_bytes() == before  # it has not begun


@pytest.mark.parametrize("name", ["meta", "cells"])
def test_a_trigger_with_the_name_of_a_table_is_seen(name, tiny_run, tiny_suite, simval):
    """It comes before the table in the schema if the table is made anew."""
    trigger = "BEFORE INSERT ON rows BEGIN UPDATE cells SET status = 'done'; END"
    with raw(tiny_run) as database:
        query = "SELECT sql FROM sqlite_schema WHERE name = ?"
        (sql,) = database.execute(query, (name,)).fetchone()
        database.execute("PRAGMA legacy_alter_table = 1")
        database.execute(f"CREATE TRIGGER {name} {trigger}")
        database.execute(f"ALTER TABLE {name} RENAME TO old")
        database.execute(sql)
        database.execute(f"INSERT INTO {name} SELECT * FROM old")
        database.execute("DROP TABLE old")
    words = ("sweep", tiny_suite, "--out", tiny_run, "--resume", "--quiet")
    for command in (words, ("gate", tiny_run, "--no-baseline")):
        code, _, err = simval(*command)
        assert (code, f"it has `{name}` twice" in err) == (2, True), err


@pytest.mark.parametrize("end", ["-shm", "-wal", "-journal"])
def test_what_sqlite_writes_beside_a_store_has_one_name(end, tiny_run, outside, simval):
    (outside / "mine").write_text("")
    os.link(outside / "mine", f"{tiny_run / 'run.sqlite'}{end}")
    code, _, err = simval("gate", tiny_run, "--no-baseline")
    assert code == 2
    assert "has another name elsewhere, too (a hard link)" in err


def test_a_linked_folder_of_artifacts_is_not_written_to(
    tiny_run, tiny_suite, outside, simval
):
    (tiny_run / "artifacts").symlink_to(outside / "folder")
    words = ("sweep", tiny_suite, "--out", tiny_run, "--resume", "--quiet")
    code, _, err = simval(*words)
    assert code == 2
    assert "artifacts is no folder of this run, so nothing is written there" in err


def test_a_device_or_a_pipe_is_not_replaced_by_a_table(tiny_run, tmp_path, simval):
    """As root `--out /dev/null` made a file of it."""
    pytest.importorskip("pyarrow", reason="the extra `parquet` is not installed")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    for name in ("pipe", "link"):
        with watched():
            code, _, err = simval("export", tiny_run, "--out", tmp_path / name)
        assert code == 2
        assert "it is no regular file" in err
    assert (tmp_path / "pipe").is_fifo()
    code, _, err = simval("export", tiny_run, "--out", tmp_path)
    assert (code, err[:7]) == (2, "error: ")


COUNTS = [
    (study, name)
    for study, own in STUDIES.items()
    for name, field in own.parameters.model_fields.items()
    if field.annotation is int
]


@pytest.mark.parametrize(("study", "name"), COUNTS)
def test_a_count_beyond_all_measure_is_refused_where_it_is_read(study, name, tmp_path):
    path = tmp_path / "suite.toml"
    required = {"estimator": "wahba", "calibrator": "squared", "filter": "mekf"}
    text = f"[{study}]\n"
    if study in required:
        text += f'algorithm = "simval:{required[study]}"\n'
    for number in (10**12 + 1, 2**53 - 1, 2**53, 2**63, 2**200, -1, -(2**63)):
        path.write_text(f"{text}{name} = {number}\n")
        if name == "geometry" and 0 <= number < 2**63:
            load_suite(str(path))  # it is a number of its own, and no count
            continue
        with pytest.raises(InputError, match=rf"{name}`: Input should be"):
            load_suite(str(path))
