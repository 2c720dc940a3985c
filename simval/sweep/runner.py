"""Drive a sweep: send batches of cells to workers, and store the results.

Only the driver writes. A cell's numbers depend on its name and seed alone, so any
number of workers, in any order, leaves the same table.
"""

import fcntl
import io
import json
import os
import platform
import shutil
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from simval.arguments import file_path, instance, switch, whole_number
from simval.arrays import nonnegative_number
from simval.errors import InputError
from simval.studies.study import Cell
from simval.sweep import provenance, store
from simval.sweep.cluster import WAIT, clustered
from simval.sweep.executors import Compute, Queue, Work, pooled, serial
from simval.sweep.identity import Stated, environments, here
from simval.sweep.run import Run, completed, load_run, write_table
from simval.sweep.suite import Suite, load_suite, require_plugins

FIXED = ("suite", "grid", "versions", "source", "models", "files", "machine")
"""What must be equal for a run to be resumed. The commit may differ where only texts
changed: the numbers depend on the source itself."""

PART = "run.sqlite.part"


class Progress:
    """Base of what shows the progress of a sweep; it shows nothing itself."""

    def start(self, total: int, done: int) -> None:
        """Note the number of cells, and how many are done."""

    def expect(self, cells: Sequence[Cell], workers: int | None) -> None:
        """Note the cells to come, and how many run at once."""

    def advance(self, name: str) -> None:
        """Note that one more cell has ended."""

    def tell(self, words: str) -> None:
        """Note a message about the workers of a cluster."""


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
    """Run a suite into a folder and return the run.

    Parameters
    ----------
    suite : str, Path or Suite
        Built-in name, path of a TOML file, or a loaded suite.
    out : str or Path
        Folder of the run; must not exist unless `resume`.
    workers : int, default 1
        Number of local processes; 1 computes in this process.
    scheduler : str, optional
        Address of a dask.distributed scheduler whose workers compute the cells instead.
    resume : bool, default False
        Resume an interrupted run in `out`: finished cells are kept, failed and missing
        ones are computed.
    progress : Progress, optional
        Pass a subclass; it is called for each cell that ends.
    wait : float, default 60
        Seconds to wait for a worker while the scheduler has none.
    mixed_kernels : bool, default False
        Whether to accept workers whose processor kernels, linear algebra or C library
        differ from those of this process. The last bits of a number then depend on the
        worker that computed it.

    Returns
    -------
    Run
        The finished run; a failed cell is in it with its traceback.

    Raises
    ------
    InputError
        If the folder exists, cannot be written, or holds the run of another suite
        or version, or if every worker would compute different numbers.
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
        progress=progress or Progress(),
        wait=wait,
        mixed_kernels=switch("mixed_kernels", mixed_kernels),
    )
    return load_run(out)


def drive(
    suite: Suite,
    folder: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    progress: Progress,
    work: Work | None = None,
    wait: float = WAIT,
    mixed_kernels: bool = False,
) -> None:
    """Run a suite into a folder, in memory that does not grow with the rows.

    `work` computes a cell in place of its study.
    """
    workers = whole_number("workers", workers, 1, 4096)
    wait = nonnegative_number("wait", wait, "s")
    require_plugins(suite.cells)
    known = provenance.manifest(suite)
    told: list[str] = []

    def tell(words: str) -> None:
        told.append(words)
        progress.tell(words)

    stated = Stated(driver=here(), mixed=mixed_kernels)
    with _computing(workers, scheduler, stated, wait, tell) as compute:
        # no folder is created before it is known that cells can be computed
        if resume and _is_file(folder / "run.sqlite"):
            _check_same(folder, suite, known)
        else:
            _create(folder, suite, known, resume)
        started, wall = datetime.now(UTC), time.perf_counter()
        places = provenance.places(suite.grid)
        with locked(folder), store.writing(folder / "run.sqlite") as database:
            store.reopen(database)
            _write(folder / "timing.json", json.dumps({"plugins": places}) + "\n")
            pending = store.unfinished(database)
            done = len(suite.cells) - len(pending)
            progress.start(len(suite.cells), done)
            at_once = workers if scheduler is None else None
            progress.expect([suite.cells[k] for k in pending], at_once)
            queue = Queue(suite.cells, pending, work, stated)
            _compute(database, folder, compute, queue, progress)
            manifest = store.manifest(database)
            manifest["environments"] = environments(store.entry(database, "machines"))
            manifest |= provenance.asked(suite)  # no number depends on it
            store.keep_manifest(database, manifest)
            spent = store.times(database)
            timing = {
                "started": started.isoformat(timespec="seconds"),
                "committed": provenance.commit_date(),
                "wall_seconds": round(time.perf_counter() - wall, 3),
                "workers": workers if scheduler is None else scheduler,
                "told": told,
                "host": platform.node(),
                "finished_before": done,
                "cpu_seconds": round(sum(seconds for _, seconds, _ in spent), 3),
                "processors": os.cpu_count(),
                "cells": {name: round(seconds, 4) for name, seconds, _ in spent},
                "calls": {name: timed for name, _, timed in spent if timed},
                "plugins": places,
            }
            write_table(database, folder / "results.csv")
            _write(folder / "manifest.json", json.dumps(manifest, indent=2) + "\n")
            _write(folder / "timing.json", json.dumps(timing, indent=2) + "\n")
            store.complete(database, folder)


@contextmanager
def _computing(
    workers: int, scheduler: str | None, stated: Stated, wait: float, tell: Any
) -> Iterator[Compute]:
    """Choose where to compute: here, in a pool, or on a cluster."""
    if scheduler is not None:
        with clustered(scheduler, stated, wait, tell) as compute:
            yield compute
    else:
        yield serial if workers == 1 else partial(pooled, workers=workers)


def _compute(
    database: sqlite3.Connection,
    folder: Path,
    compute: Compute,
    queue: Queue,
    progress: Progress,
) -> None:
    """Compute the missing cells, and store each batch as it ends."""
    for batch in compute(queue):
        for each in batch:
            for name, content in each.artifacts.items():
                _write(folder / "artifacts" / name, content)
        store.finish(database, batch)
        for each in batch:
            progress.advance(each.cell[1])
    left = store.count(database, "pending")
    if left:
        msg = f"{left} cells came back neither finished nor failed"
        raise RuntimeError(msg)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a run folder for one driver."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        msg = f"another sweep is running in {folder}; wait for it, or stop it"
        raise InputError(msg) from None
    finally:
        os.close(handle)


def _create(folder: Path, suite: Suite, known: Mapping[str, Any], resume: bool) -> None:
    """Make the folder of a new run with all cells pending."""
    try:
        # a run that was stopped before its store was complete left only a part of it
        begun = (
            resume
            and folder.is_dir()
            and all(p.name.startswith(PART) for p in folder.iterdir())
        )
        if folder.exists() and not begun:
            msg = f"{folder} exists; choose another folder, or --resume to continue it"
            raise InputError(msg)
        folder.mkdir(parents=True, exist_ok=begun)
        for left in folder.iterdir():
            left.unlink()
    except OSError as error:
        msg = f"cannot make {folder}: {error}; choose a folder that can be written"
        raise InputError(msg) from None
    # The store appears under its name only when it is complete.
    try:
        store.create(folder / PART, suite.cells, known)
        (folder / PART).rename(folder / "run.sqlite")
    except BaseException:  # a run that did not start must not block the next one
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _check_same(folder: Path, suite: Suite, known: Mapping[str, Any]) -> None:
    """Refuse to resume a run that is damaged, or of another suite or source."""
    with store.opened(folder / "run.sqlite") as database:
        earlier = store.manifest(database)
        names = zip_longest(store.names(database), (c.name for c in suite.cells))
        same = all(a == b for a, b in names)
    changed = provenance.differences(
        {key: earlier.get(key) for key in FIXED},
        # through JSON, as the earlier one went
        json.loads(json.dumps({key: known[key] for key in FIXED})),
    )
    if not changed and not same:
        changed = ["the cells differ"]
    if changed:
        msg = (
            f"{folder} was started with another suite or version and cannot be "
            f"resumed: {'; '.join(changed)}; use a new folder"
        )
        raise InputError(msg)


def _write(path: Path, content: str | bytes | Mapping[str, Any]) -> None:
    """Write a file that appears only once it is complete."""
    path.parent.mkdir(exist_ok=True)
    with completed(path) as file:
        if isinstance(content, Mapping):
            buffer = io.BytesIO()  # a zip file is not written from front to back
            np.savez(buffer, **content)
            file.write(buffer.getvalue())
        else:
            file.write(content.encode() if isinstance(content, str) else content)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError as error:
        msg = f"cannot use {path}: {error}; choose another folder"
        raise InputError(msg) from None
