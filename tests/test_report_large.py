"""A run of 100 000 rows: its report takes at most 500 MiB of memory, 10 MiB of disk."""

import json
import os
import re
import subprocess
import sys

import pytest
from stores import rewritten

from simval.studies import STUDIES
from simval.studies.study import Cell

ROWS = 100_000
MEBIBYTE = 1 << 20


def _name(study, parameters, seed):
    return Cell(study, STUDIES[study].parameters(**parameters), seed).name


def grown(folder, rows):
    """Repeat the cells of a run at other geometries, pose counts and noise."""
    with rewritten(folder) as database:
        cells = database.execute(
            "SELECT position, study, parameters FROM cells ORDER BY position"
        ).fetchall()
        columns = [
            f'"{line[1]}"' for line in database.execute("PRAGMA table_info(rows)")
        ][2:]
        content = {
            position: database.execute(
                f"SELECT {', '.join(columns)} FROM rows WHERE cell = ? "
                "ORDER BY ordinal",
                (position,),
            ).fetchall()
            for position, _, _ in cells
        }
        count, place, step = sum(map(len, content.values())), len(cells), 1
        marks = ", ".join("?" * (2 + len(columns)))
        while count < rows:
            step += 1
            for position, study, text in cells:
                parameters = json.loads(text)
                key = "geometry" if study == "attitude" else "poses"
                parameters[key] += step % 40
                parameters["noise_std"] *= 1.0 + 0.01 * (step // 40)
                name = _name(study, parameters, step)
                database.execute(
                    "INSERT INTO cells "
                    "(position, cell, study, seed, parameters, status) "
                    "VALUES (?, ?, ?, ?, ?, 'done')",
                    (place, name, study, step, json.dumps(parameters)),
                )
                database.executemany(
                    f"INSERT INTO rows VALUES ({marks})",
                    [(place, i, *row) for i, row in enumerate(content[position])],
                )
                count += len(content[position])
                place += 1
        manifest = json.loads(
            database.execute(
                "SELECT value FROM meta WHERE key = 'manifest'"
            ).fetchone()[0]
        )
        database.execute(
            "UPDATE meta SET value = ? WHERE key = 'manifest'",
            (json.dumps(manifest | {"cells": place}),),
        )
    return count


# in a process of its own, whose time and peak memory are its alone
PROBE = """
import resource, sys, time
from simval.cli import run
code = run(["report", sys.argv[1]])
used = resource.getrusage(resource.RUSAGE_SELF)
print(code, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
"""


@pytest.mark.slow
def test_a_large_run_stays_within_time_memory_and_size(tiny_run):
    assert grown(tiny_run, ROWS) >= ROWS
    done = subprocess.run(
        [sys.executable, "-c", PROBE, str(tiny_run)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    code, seconds, mebibytes = map(float, done.stdout.split()[-3:])
    sys.stderr.write(f"{seconds:.1f} s, {mebibytes:.0f} MiB\n")
    assert code == 0
    # the time is measured, not judged: it depends on the machine
    assert mebibytes <= 500
    page = tiny_run / "report.html"
    assert page.stat().st_size <= 10 * MEBIBYTE
    text = page.read_text(encoding="utf-8")
    # what is left out is said
    assert re.search(r"500 of 1\d\d,\d\d\d rows are shown", text)
    assert re.search(r"6 of \d+ groups of cells are drawn", text)


@pytest.mark.ci
def test_a_run_of_some_thousand_rows_says_what_it_leaves_out(tiny_run, monkeypatch):
    from simval.report import render, tables
    from simval.sweep import load_run

    monkeypatch.setattr("simval.report.environment.svg", lambda drawing: "<svg/>")
    count = grown(tiny_run, 4000)
    run = load_run(tiny_run)
    text = render(run)
    assert f"500 of {count:,} rows are shown" in text
    assert re.search(r"6 of \d+ groups of cells are drawn", text)
    # the files leave nothing out
    assert len(next(t for t in tables(run) if t.name == "numbers").rows) == count
