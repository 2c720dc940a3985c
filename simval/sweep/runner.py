"""The driver of a sweep: batches of cells out to workers, results into the store.

Only the driver writes. A cell's numbers depend on its name and seed alone, so any
number of workers, in any order, leaves the same table.
"""

import json
import os
import platform
import sqlite3
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol, cast, runtime_checkable

from simval.arguments import file_path, instance, switch, whole_number
from simval.arrays import nonnegative_number
from simval.errors import InputError
from simval.studies.study import Cell
from simval.sweep import provenance, store
from simval.sweep.batches import Queue, Work
from simval.sweep.cells import read_cells
from simval.sweep.cluster import WAIT
from simval.sweep.crew import Crew, gathered
from simval.sweep.endings import ENDINGS, Ending, ending_of, worse
from simval.sweep.folder import check_same, create, keep, locked, write
from simval.sweep.grid import Chosen
from simval.sweep.machines import environments
from simval.sweep.paths import require_plugins
from simval.sweep.run import Run, load_run, write_table
from simval.sweep.seal import seal, unseal
from simval.sweep.suite import Suite, load_suite
from simval.verdict import ALPHA


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
    wait: float = WAIT,
    mixed_kernels: bool = False,
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
    wait : float, default 60
        Seconds to wait for a worker of the scheduler while there is none.
    mixed_kernels : bool, default False
        Whether workers with other processor kernels, linear algebra or C library than
        this process may compute: the last bits then depend on which did.

    Returns
    -------
    Run
        Failed cells are in it with their traceback.

    Raises
    ------
    InputError
        If the folder exists, cannot be written, or holds the run of another suite
        or version, or every worker would compute other numbers.
    LostClusterError
        If the scheduler or all workers are lost.
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
        wait=wait,
        mixed_kernels=switch("mixed_kernels", mixed_kernels),
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
    work: Work | None = None,
    wait: float = WAIT,
    mixed_kernels: bool = False,
) -> None:
    """Run a suite into a folder; memory does not grow with the number of rows.

    `work` computes a cell in place of its study.
    """
    workers = whole_number("workers", workers, 1, 4096)
    wait = nonnegative_number("wait", wait, "s")
    require_plugins(suite.cells)
    known = provenance.manifest(suite)
    with gathered(workers, scheduler, wait, mixed_kernels, progress) as crew:
        # no folder is created before it is known that cells can be computed
        if resume and _is_file(folder / "run.sqlite"):
            check_same(folder, suite, known)
        else:
            create(folder, suite, known, resume)
        _fill(folder, suite, crew, progress, work)


def _fill(
    folder: Path, suite: Suite, crew: Crew, progress: Progress, work: Work | None
) -> None:
    """Compute the missing cells of a run, and write its table."""
    started, wall = datetime.now(UTC), time.perf_counter()
    places = provenance.places(suite.grid)
    with locked(folder), store.writing(folder / "run.sqlite") as database:
        unseal(database)
        write(folder / "timing.json", json.dumps({"plugins": places}) + "\n")
        done = _compute(database, folder, suite, crew, progress, work)
        spent = dict(store.seconds(database))
        timing = {
            "started": started.isoformat(timespec="seconds"),
            "committed": provenance.commit_date(),
            "wall_seconds": round(time.perf_counter() - wall, 3),
            "workers": crew.where,
            "told": crew.told,
            "host": platform.node(),
            "finished_before": done,
            "cpu_seconds": round(sum(spent.values()), 3),
            "processors": os.cpu_count(),
            "cells": {name: round(value, 4) for name, value in spent.items()},
            "calls": store.times(database),
            "plugins": places,
        }
        manifest = store.manifest(database)
        manifest["environments"] = environments(store.entry(database, store.MACHINES))
        store.keep_manifest(database, manifest)
        store.keep(database, store.WORST, None)
        write_table(database, folder / "results.csv")
        write(folder / "manifest.json", json.dumps(manifest, indent=2) + "\n")
        write(folder / "timing.json", json.dumps(timing, indent=2) + "\n")
        seal(database, folder)


def _compute(
    database: sqlite3.Connection,
    folder: Path,
    suite: Suite,
    crew: Crew,
    progress: Progress,
    work: Work | None,
) -> int:
    """Compute the missing cells; return how many were finished before."""
    cells, pending = suite.cells, store.unfinished(database)
    done = len(cells) - len(pending)
    worst = _worst_stored(database, suite) if done and pending else "stored"
    progress.start(len(cells), done, worst)
    if isinstance(progress, Watch):
        at_once = crew.where if isinstance(crew.where, int) else None
        progress.expect(Chosen(cells, pending), at_once)
    for batch in crew.compute(Queue(cells, pending, ALPHA, work, crew.stated)):
        for each in batch:
            keep(folder / "artifacts", each.artifacts)
            if each.ending not in ("failed", "refused"):
                worst = worse(worst, each.ending)
        store.finish(database, batch, worst)
        for each in batch:
            progress.advance(each.cell[1], each.ending)
    left = store.count(database, "pending")
    if left:
        msg = f"{left} cells came back neither finished nor failed"
        raise RuntimeError(msg)
    return done


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError as error:
        msg = f"cannot use {path}: {error}; choose another folder"
        raise InputError(msg) from None


def _worst_stored(database: sqlite3.Connection, suite: Suite) -> Ending:
    """Worst ending of the cells that an earlier session finished."""
    kept = store.entry(database, store.WORST)
    if kept in ENDINGS:
        return cast(Ending, kept)
    worst: Ending = "stored"  # by a version that did not keep it
    for cell in read_cells(database):
        if cell.status == "done":
            own = suite.cells[cell.position]
            worst = worse(worst, ending_of(own, cell.rows, ALPHA / len(suite.cells)))
    return worst
