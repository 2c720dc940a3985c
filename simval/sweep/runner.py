"""The driver of a sweep: cells out to workers, results into the store.

Only the driver writes. A cell's numbers depend on its name and seed alone, so any
number of workers, in any order, leaves the same table.
"""

import json
import os
import platform
import sqlite3
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

from simval.arguments import file_path, instance, switch, whole_number
from simval.errors import InputError
from simval.results import CellName, Row
from simval.studies.study import Cell
from simval.sweep import provenance, store
from simval.sweep.cells import REFUSED, read_cells
from simval.sweep.executors import Compute, clustered, pooled, serial
from simval.sweep.folder import check_same, create, keep, locked, write
from simval.sweep.paths import require_plugins
from simval.sweep.run import Run, load_run, write_table
from simval.sweep.seal import seal, unseal
from simval.sweep.suite import Suite, load_suite
from simval.verdict import ALPHA, Answer, judge, overall

Ending = Answer | Literal["failed", "refused", "stored"]
"""How a cell ended: a verdict, a crash, a refusal, or stored with nothing to judge."""

ENDINGS: tuple[Ending, ...] = (
    "stored",
    "pass",
    "inconclusive",
    "refused",
    "fail",
    "failed",
)
"""From best to worst; ``failed`` is a crash, ``fail`` a verdict."""


@runtime_checkable
class Progress(Protocol):
    """Receives the progress of the driver."""

    def start(self, total: int, done: int, worst: Ending) -> None:
        """Begin."""

    def advance(self, name: str, ending: Ending) -> None:
        """Note that one more cell has ended."""


@runtime_checkable
class Watch(Progress, Protocol):
    """A progress that is told too which cells will be computed."""

    def expect(self, cells: Sequence[Cell], workers: int | None) -> None:
        """Note the cells to come in their order, and how many are computed at once."""


class Silence:
    """A progress without output."""

    def start(self, total: int, done: int, worst: Ending) -> None:
        """Do nothing."""

    def advance(self, name: str, ending: Ending) -> None:
        """Do nothing."""


def run_suite(
    suite: str | Path | Suite,
    out: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Run:
    """Run a suite into a folder and return what it left.

    Parameters
    ----------
    suite : str, Path or Suite
        Built-in name, path of a TOML file, or a loaded suite.
    out : str or Path
        Folder of the run; must not exist unless `resume`.
    workers : int, default 1
        Local processes; 1 works in this process.
    scheduler : str, optional
        Address of a dask.distributed scheduler that computes the cells instead.
    resume : bool, default False
        Resume an interrupted run in `out`: finished cells are kept, failed and missing
        ones are computed.
    progress : Progress, optional
        Called for each cell that ends.

    Returns
    -------
    Run
        Failed cells are in it with their traceback.

    Raises
    ------
    InputError
        If the folder exists, cannot be written, or holds the run of another suite
        or version.
    """
    if not isinstance(suite, Suite):
        suite = load_suite(str(file_path("suite", suite)))
    drive(
        suite,
        file_path("out", out),
        workers=workers,
        scheduler=None if scheduler is None else instance("scheduler", scheduler, str),
        resume=switch("resume", resume),
        progress=progress or Silence(),
    )
    return load_run(out)


def drive(
    suite: Suite,
    folder: Path,
    *,
    workers: int,
    scheduler: str | None,
    resume: bool,
    progress: Progress,
) -> None:
    """Run a suite into a folder; memory does not grow with the number of rows."""
    workers = whole_number("workers", workers, 1, 4096)
    require_plugins(suite.cells)
    known = provenance.manifest(suite)
    where = workers if scheduler is None else scheduler
    with _computing(workers, scheduler) as compute:
        # no folder is created before it is known that cells can be computed
        if resume and _is_file(folder / "run.sqlite"):
            check_same(folder, suite, known)
        else:
            create(folder, suite, known, resume)
        _fill(folder, suite, compute, progress, where)


def _fill(
    folder: Path, suite: Suite, compute: Compute, progress: Progress, where: int | str
) -> None:
    """Compute the missing cells of a run, and write its table."""
    started, wall = datetime.now(UTC), time.perf_counter()
    places = provenance.places(suite.grid)
    with locked(folder), store.writing(folder / "run.sqlite") as database:
        unseal(database)
        write(folder / "timing.json", json.dumps({"plugins": places}) + "\n")
        pending = store.unfinished(database)
        done = len(suite.cells) - len(pending)
        progress.start(len(suite.cells), done, _worst_stored(database, suite))
        if isinstance(progress, Watch):
            at_once = where if isinstance(where, int) else None
            progress.expect([suite.cells[place] for place in pending], at_once)
        for position, outcome, seconds in compute(suite.cells, pending):
            name = suite.cells[position].name
            if isinstance(outcome, str):
                store.fail(database, position, outcome, seconds)
                refused = outcome.startswith(REFUSED)
                progress.advance(name, "refused" if refused else "failed")
                continue
            keep(folder / "artifacts", outcome.artifacts)
            store.keep_times(database, name, outcome.times)
            store.finish(database, position, outcome.rows, seconds)
            progress.advance(name, _ending(suite.cells[position], outcome.rows, suite))
        left = len(store.unfinished(database)) - len(store.failures(database))
        if left:
            msg = f"{left} cells came back neither finished nor failed"
            raise RuntimeError(msg)
        spent = store.seconds(database)
        timing = {
            "started": started.isoformat(timespec="seconds"),
            "committed": provenance.commit_date(),
            "wall_seconds": round(time.perf_counter() - wall, 3),
            "workers": where,
            "host": platform.node(),
            "finished_before": done,
            "cpu_seconds": round(sum(spent.values()), 3),
            "processors": os.cpu_count(),
            "cells": {name: round(value, 4) for name, value in spent.items()},
            "calls": store.times(database),
            "plugins": places,
        }
        manifest = store.manifest(database)
        write_table(database, folder / "results.csv")
        write(folder / "manifest.json", json.dumps(manifest, indent=2) + "\n")
        write(folder / "timing.json", json.dumps(timing, indent=2) + "\n")
        seal(database, folder)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError as error:
        msg = f"cannot use {path}: {error}; choose another folder"
        raise InputError(msg) from None


def _ending(cell: Cell, rows: Sequence[Row], suite: Suite) -> Ending:
    """Verdict of one cell by itself, at its part of the false-alarm rate."""
    name = CellName(cell.study, cell.name)
    verdicts = judge(((name, row) for row in rows), ALPHA / len(suite.cells))
    return overall(verdicts) if verdicts else "stored"


def _worst_stored(database: sqlite3.Connection, suite: Suite) -> Ending:
    """Worst ending of the cells that an earlier session finished."""
    worst: Ending = "stored"
    for cell in read_cells(database):
        if cell.status == "done":
            worst = worse(worst, _ending(suite.cells[cell.position], cell.rows, suite))
    return worst


def worse(first: Ending, second: Ending) -> Ending:
    """Choose the worse of two endings."""
    return max(first, second, key=ENDINGS.index)


def _computing(workers: int, scheduler: str | None) -> AbstractContextManager[Compute]:
    if scheduler is not None:
        return clustered(scheduler)
    return nullcontext(serial if workers == 1 else partial(pooled, workers=workers))
