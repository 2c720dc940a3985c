"""A run folder of an enemy: refused in words or judged right, never more than that.

Never a traceback, a hang, a link followed, memory without a bound, or a pass of what is
not whole. `hostile.py` has the attacks; two thousand of them run by night.
"""

import os
import resource
import shutil
import sqlite3
import zipfile
from io import BytesIO

import numpy as np
import pytest
from hostile import ENDLESS, arrays_of, attack, bomb, put, resealed
from stores import raw, rewritten
from test_safety import watched

from simval.cli import run as simval_command
from simval.judge import write_baseline
from simval.sweep import load_run, run_suite

SMALL = """
title = "Small"
seed = 7

[attitude]
noise_std = [0.01, 0.02]
samples = 65536
"""
PICTURE = (
    b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x00\x01\x00\x00\x00\x01"
    + b"\x08\x00\x00\x00\x00:~\x9bU\x00\x00\x00\nIDATx\x9cc`\x00\x00\x00\x02\x00\x01"
    + b"H\xaf\xa4q\x00\x00\x00\x00IEND\xaeB`\x82"
)
QUICK, CHUNKS, EACH, NIGHT = 10, 25, 8, 2500
MOST = 300 * 2**20
"""Bytes by which the process may grow: what a report loads takes 100 MB."""


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A small run, with artifacts of three kinds."""
    place = tmp_path_factory.mktemp("hostile")
    (place / "small.toml").write_text(SMALL)
    run_suite(str(place / "small.toml"), place / "run")
    artifacts = place / "run" / "artifacts"
    artifacts.mkdir(exist_ok=True)
    time = np.arange(40) / 10.0
    np.savez(artifacts / "scene-die-12.npz", directions=np.eye(3))
    (artifacts / "scene-die-12.png").write_bytes(PICTURE)
    np.savez(artifacts / "convergence-x.npz", lm=10.0 ** -np.arange(5.0))
    np.savez(
        artifacts / "static-gimbal-0.npz",
        time=time,
        signal=np.ones((40, 3)),
        intervals=[[0.5, 1.0]],
    )
    resealed(place / "run")
    return place / "run"


class Judge:
    """What each command makes of a folder, beside what it makes of a good one."""

    def __init__(self, run, place, capsys):
        self.good, self.place, self.capsys = run, place, capsys
        self.cells = [(cell.name, len(cell.rows)) for cell in load_run(run).cells]

    def commands(self, folder):
        series = self.place / "series"
        shutil.rmtree(series, ignore_errors=True)
        series.mkdir()
        for name, place in (("good", self.good), ("bad", folder)):
            (series / name).symlink_to(place, target_is_directory=True)
        out = self.place / "out"
        return (
            ("gate", folder, "--no-baseline", "--junit", f"{out}.xml"),
            ("compare", self.good, folder),
            ("export", folder, "--out", f"{out}.parquet"),
            ("trend", series),
            ("report", folder, "--out", f"{out}.html"),
        )

    def code(self, words):
        self.capsys.readouterr()
        with watched(), np.errstate(all="ignore"):
            code = simval_command([str(word) for word in words])
        printed = self.capsys.readouterr()
        assert code in (0, 1, 2, 3, 4), (words, printed)
        assert (code != 2) or printed.err.startswith("error: "), (words, printed)
        assert "\x1b" not in printed.out + printed.err, words
        return code

    def check(self, number, rng, every):
        """One attack; every command, or the gate alone."""
        folder = self.place / f"bad-{number}"
        shutil.copytree(self.good, folder)
        done = attack(folder, rng)
        try:
            if done.signed:
                resealed(folder)
        except (OSError, ValueError, sqlite3.Error):
            pass  # there is nothing left that could be signed
        commands = self.commands(folder)
        codes = {w[0]: self.code(w) for w in (commands if every else commands[:1])}
        if codes["gate"] == 0:
            assert not done.lost, (done, codes)
            now = [(cell.name, len(cell.rows)) for cell in load_run(folder).cells]
            assert now == self.cells, (done, codes)
        if (self.place / "out.html").exists():
            page = (self.place / "out.html").read_text(encoding="utf-8")
            assert "<script>alert" not in page, done
            assert "cm9vdDp4OjA6" not in page, done  # root:x:0: in base64
            assert "onload=" not in page, done
        shutil.rmtree(folder)
        return done, codes


def attacked(run, place, capsys, count, seed, share):
    rng, judge = np.random.default_rng(seed), Judge(run, place, capsys)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    handles = len(os.listdir("/proc/self/fd"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simval.report.environment.svg", lambda drawing: "<svg/>")
        found = [judge.check(n, rng, (n + 1) % share == 0) for n in range(count)]
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown * 1024 < MOST
    assert len(os.listdir("/proc/self/fd")) <= handles + 1  # none is left open
    return found


@pytest.mark.ci
@pytest.mark.parametrize(
    "seed",
    [
        *range(QUICK),
        *(pytest.param(seed, marks=pytest.mark.ci) for seed in range(QUICK, CHUNKS)),
    ],
)
def test_two_hundred_attacks_are_refused_or_judged(seed, small, tmp_path, capsys):
    share = EACH if seed % 6 == 0 else EACH + 1  # a report takes half a second
    attacked(small, tmp_path, capsys, EACH, [111, seed], share)


@pytest.mark.slow
def test_thousands_of_attacks_are_refused_or_judged(small, tmp_path, capsys):
    found = attacked(small, tmp_path, capsys, NIGHT, 111, 2)
    refused = sum(codes["gate"] == 2 for _, codes in found)
    assert 0.5 * NIGHT < refused < NIGHT  # some are no damage, or change no verdict


@pytest.fixture
def folder(small, tmp_path):
    place = tmp_path / "run"
    shutil.copytree(small, place)
    return place


@pytest.mark.ci
def test_the_small_run_is_good(folder, simval, undrawn):
    for command in ("gate", "report", "export"):
        words = ("--no-baseline",) if command == "gate" else ()
        assert simval(command, folder, *words)[0] == 0, command
    assert "data:image/png" in (folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        (
            "ALTER TABLE rows RENAME TO old; CREATE VIEW rows AS "
            + ENDLESS.format("cell, n AS ordinal FROM x"),
            "its view `rows` is other than what a sweep makes",
        ),
        (
            "DROP TABLE meta; CREATE VIEW meta AS "
            + ENDLESS.format("key, 2 AS value FROM x"),
            "its view `meta` is other than what a sweep makes",
        ),
        (
            "CREATE TRIGGER t AFTER INSERT ON meta BEGIN DELETE FROM rows; END",
            "its trigger `t` is not among what a sweep makes",
        ),
        (
            "DELETE FROM rows WHERE cell = 1; DELETE FROM cells WHERE position = 1; "
            "UPDATE meta SET value = json_remove(value, '$.cells') "
            "WHERE key = 'manifest'",
            "`cells` of the manifest is missing",
        ),
        (
            "DELETE FROM rows WHERE cell = 1; DELETE FROM cells WHERE position = 1; "
            "UPDATE meta SET value = json_set(value, '$.cells', 1) "
            "WHERE key = 'manifest'",
            "the manifest says 1 cells, and its grid has 2",
        ),
        (
            "UPDATE cells SET parameters = '{}' WHERE position = 1",
            "its parameters lack ",
        ),
        (
            "UPDATE cells SET seed = 8, cell = replace(cell, '@7', '@8') "
            "WHERE position = 1",
            "the suite asks for attitude with seed 7 at place 1",
        ),
        (
            "UPDATE cells SET parameters = replace(parameters, '0.02', '0.03'), "
            "cell = replace(cell, '0.02', '0.03') WHERE position = 1",
            "its parameter `noise_std` is 0.03; the suite asks for 0.02",
        ),
        ("UPDATE rows SET rowid = -rowid", "its rows are numbered from -"),
        (
            "UPDATE rows SET predictor = hex(zeroblob(100000)) WHERE rowid = 3",
            "`predictor` is ",
        ),
    ],
)
def test_who_knows_the_seal_is_refused_by_what_does_not_agree(
    sql, words, folder, simval
):
    with raw(folder) as database:
        database.executescript(sql)
    if "VIEW" not in sql:  # to sign would be to read it
        resealed(folder)
    with watched():
        code, _, err = simval("gate", folder, "--no-baseline")
    assert code == 2
    assert words in err


@pytest.mark.ci
def test_what_a_seal_cannot_show(folder, simval, tmp_path):
    """Rows left out of a cell, signed anew: the baseline and the cell itself know."""
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(folder), "good")
    assert simval("gate", folder, "--baseline", baseline)[0] == 0
    with rewritten(folder) as database:
        database.execute("DELETE FROM rows WHERE cell = 1 AND ordinal > 40")
    resealed(folder)
    assert simval("gate", folder, "--no-baseline")[0] == 0
    assert simval("gate", folder, "--baseline", baseline)[0] == 1
    assert simval("repro", load_run(folder).cells[1].name, "--run", folder)[0] == 1


PLACES = (
    *("run.sqlite", "run.sqlite-wal", "timing.json", "manifest.json", "results.csv"),
    *("artifacts/scene-die-12.npz", "artifacts/scene-die-12.png"),
)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        (name, kind)
        for name in PLACES
        for kind in ("pipe", "socket", "link", "dead", "folder", "huge")
        # SQLite knows where a store ends, and reads no further
        if (kind, name.partition("-")[0]) != ("huge", "run.sqlite")
    ],
)
def test_only_files_of_the_folder_itself_are_read(name, kind, folder, simval):
    put(folder / name, kind)
    with watched():
        code, _, err = simval("report", folder, "--out", folder / "page.html")
    assert code == 2
    assert err.startswith("error: ")
    assert not (folder / "page.html").exists()


def test_a_linked_folder_of_artifacts_is_not_read(folder, simval, tmp_path):
    outside = tmp_path / "outside"
    (folder / "artifacts").rename(outside)
    (folder / "artifacts").symlink_to(outside)
    code, _, err = simval("report", folder)
    assert code == 2
    assert "is a link, which is not followed out of a run folder" in err


@pytest.mark.parametrize("at", range(len(arrays_of())))
def test_an_array_is_what_its_header_says_or_refused(at, folder, simval, undrawn):
    (folder / "artifacts" / "scene-die-12.npz").write_bytes(arrays_of()[at])
    resealed(folder)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with watched(), np.errstate(all="ignore"):
        code, _, err = simval("report", folder, "--out", folder / "page.html")
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown * 1024 < MOST
    assert (code, "run the suite again" in err) in ((2, True), (0, False)), err


@pytest.mark.parametrize("columns", [0, 2, 4, 9, 300])
def test_readings_have_three_columns(columns, folder, simval, undrawn):
    """With more than there are colours it was a traceback."""
    signal = np.ones((40, columns))
    file = folder / "artifacts" / "static-gimbal-0.npz"
    np.savez(file, time=np.arange(40.0), signal=signal, intervals=[[0.5, 1.0]])
    resealed(folder)
    code, _, err = simval("report", folder)
    assert code == 2
    assert f"`signal` has shape (40, {columns}); it must have (40, 3)" in err


@pytest.mark.parametrize("kind", ["scene", "static", "convergence"])
@pytest.mark.parametrize("sealed", [True, False])
def test_a_name_that_is_no_text_is_refused(kind, sealed, folder, simval, undrawn):
    """Without a seal it was a traceback: a page is text."""
    artifacts = os.fsencode(folder / "artifacts")
    (old,) = (n for n in os.listdir(artifacts) if n.startswith(kind.encode() + b"-")
              and n.endswith(b".npz"))  # fmt: skip
    new = kind.encode() + b"-\xff-1.npz"
    os.rename(os.path.join(artifacts, old), os.path.join(artifacts, new))
    if sealed:
        resealed(folder)
    else:
        with raw(folder) as database:
            database.execute("DELETE FROM meta WHERE key = 'files'")
    code, _, err = simval("report", folder)
    assert code == 2
    assert "surrogates not allowed" in err if sealed else "whose name is no text" in err


def test_a_bomb_is_small_where_it_lies(tmp_path):
    """Else the test above would have shown nothing."""
    assert len(bomb()) < 2**20
    with zipfile.ZipFile(BytesIO(bomb())) as members:
        assert sum(part.file_size for part in members.filelist) > 64 * 2**20


def test_pages_that_lead_in_a_circle_end(folder, simval):
    """A tree whose inner page has itself for a child would be read for ever."""
    file = folder / "run.sqlite"
    with raw(folder) as database:
        query = "SELECT rootpage FROM sqlite_schema WHERE name = 'rows'"
        (root,) = database.execute(query).fetchone()
    data = bytearray(file.read_bytes())
    start = (root - 1) * 4096
    assert data[start] == 5  # an inner page of a table
    cells = int.from_bytes(data[start + 3 : start + 5])
    pointers = [
        int.from_bytes(data[start + 12 + 2 * i : start + 14 + 2 * i])
        for i in range(cells)
    ]
    first = data[start + pointers[0] : start + pointers[0] + 4]
    for pointer in pointers:
        data[start + pointer : start + pointer + 4] = first
    data[start + 8 : start + 12] = first
    file.write_bytes(data)
    with watched():
        code, _, err = simval("gate", folder, "--no-baseline")
    assert code == 2
    assert "its pages do not fit together" in err
