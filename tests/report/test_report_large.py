"""A run of nearly 100 000 rows: its report takes at most 500 MiB, 10 MiB of disk."""

import json
import os
import re
import subprocess
import sys
from itertools import product

import pytest
from stores import rewritten

from simval.studies import STUDIES
from simval.studies.study import Cell

ROWS = 100_000  # of a larger one a part is shown
STEPS = 45
MEBIBYTE = 1 << 20


def _name(study, parameters, seed):
    return Cell(study, STUDIES[study].parameters(**parameters), seed).name


AXES = {"calibration": "poses", "attitude": "geometry"}
"""What is varied, with the seed, to make a run large."""


def _listed(value):
    return value if isinstance(value, list) else [value]


def grown(folder, rows):
    """Repeat the cells of a run at other geometries and pose counts, to so many rows.

    Or to a little less, by a seed; and at 45 values of each at the least.
    """
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
        (text,) = database.execute(
            "SELECT value FROM meta WHERE key = 'manifest'"
        ).fetchone()
        manifest = json.loads(text)
        grid = manifest["grid"]
        for study, key in AXES.items():
            grid[study][key] = [grid[study][key] + step for step in range(STEPS)]
        once = STEPS * sum(map(len, content.values()))
        grid["seed"] = list(range(1, 1 + max(1, rows // once)))
        database.execute("DELETE FROM rows")
        database.execute("DELETE FROM cells")
        asked = [
            (seed, study, dict(zip(axes, values, strict=True)))
            for seed in grid["seed"]
            for study, axes in list(grid.items())[1:]
            for values in product(*map(_listed, axes.values()))
        ]
        like = {
            (study, json.loads(parameters)["noise_std"]): position
            for position, study, parameters in cells
        }
        marks = ", ".join("?" * (2 + len(columns)))
        for place, (seed, study, parameters) in enumerate(asked):
            name = _name(study, parameters, seed)
            database.execute(
                "INSERT INTO cells VALUES (?, ?, ?, ?, ?, 'done', '', 0.0, '', '')",
                (place, name, study, seed, json.dumps(parameters)),
            )
            own = content[like[study, parameters["noise_std"]]]
            database.executemany(
                f"INSERT INTO rows VALUES ({marks})",
                [(place, i, *row) for i, row in enumerate(own)],
            )
        database.execute(
            "UPDATE meta SET value = ? WHERE key = 'manifest'",
            (json.dumps(manifest | {"cells": len(asked)}),),
        )
        (count,) = database.execute("SELECT count(*) FROM rows").fetchone()
    return count


# in a process of its own, whose time and peak memory are its alone: `ru_maxrss` is not,
# as a process begins with that of the one that started it
PROBE = """
import sys, time
from pathlib import Path
from simval.cli import run
code = run(["report", sys.argv[1]])
status = Path("/proc/self/status").read_text().split()
print(code, time.process_time(), int(status[status.index("VmHWM:") + 1]) / 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads Linux's peak of memory")
def test_a_large_run_stays_within_time_memory_and_size(tiny_run):
    count = grown(tiny_run, ROWS)
    assert 0.75 * ROWS < count <= ROWS
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
    assert f"500 of {count:,} rows are shown" in text
    assert re.search(r"Not drawn here: \d+ poses", text)


@pytest.mark.ci
def test_a_run_of_some_thousand_rows_says_what_it_leaves_out(tiny_run, monkeypatch):
    from simval.report import render, tables
    from simval.sweep import load_run

    monkeypatch.setattr("simval.report.section.svg", lambda drawing: "<svg/>")
    count = grown(tiny_run, 4000)
    run = load_run(tiny_run)
    text = render(run)
    assert f"500 of {count:,} rows are shown" in text
    assert re.search(r"Not drawn here: \d+ poses", text)
    # the files leave nothing out
    assert len(next(t for t in tables(run) if t.name == "numbers").rows) == count
