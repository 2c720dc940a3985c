"""The driver of a sweep: cells out to workers, results into the store.

Only the driver writes. A cell's numbers depend on its name and seed alone, so any
number of workers, in any order, leaves the same table.
"""

import io
import json
import os
import platform
import time
import traceback
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from datetime import UTC, datetime
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from simval.errors import InputError
from simval.results import Outcome
from simval.studies import find_study
from simval.studies.study import Cell
from simval.sweep import provenance, store
from simval.sweep.run import Run, load_run, table
from simval.sweep.suite import Suite, load_suite

# What must be equal for a run to be resumed; a dirty checkout may go on.
FIXED = ("suite", "grid", "versions", "models")

Done = tuple[int, Outcome | str, float]
"""Place of the cell, its outcome or the traceback of its failure, CPU seconds."""


class Progress(Protocol):
    """What the driver tells while it works."""

    def start(self, total: int, done: int) -> None:
        """Begin: `total` cells, `done` of them finished earlier."""

    def advance(self, name: str, failed: bool) -> None:
        """Note that one more cell has ended."""


class Silence:
    """A progress that says nothing."""

    def start(self, total: int, done: int) -> None:
        """Say nothing."""

    def advance(self, name: str, failed: bool) -> None:
        """Say nothing."""


def run_suite(
    suite: str | Suite,
    out: str | Path,
    *,
    workers: int = 1,
    resume: bool = False,
    progress: Progress | None = None,
) -> Run:
    """Run a suite into a folder and return what it left.

    Parameters
    ----------
    suite : str or Suite
        Built-in name, path of a TOML file, or a loaded suite.
    out : str or Path
        Folder of the run; must not exist unless `resume`.
    workers : int, default 1
        Processes; 1 works in this process.
    resume : bool, default False
        Go on with an interrupted run in `out`: finished cells are kept, failed and
        missing ones are computed.
    progress : Progress, optional
        Told of each cell that ends.

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
    suite = load_suite(suite) if isinstance(suite, str) else suite
    progress = progress or Silence()
    folder = Path(out)
    known = provenance.manifest(suite)
    if not workers >= 1:
        msg = f"`workers` is {workers}; give 1 or more"
        raise InputError(msg)
    file = folder / "run.sqlite"
    if resume and file.is_file():
        pending = _resumed(folder, known)
    else:
        _create(folder, suite, known)
        pending = list(range(len(suite.cells)))
    started, wall = datetime.now(UTC), time.perf_counter()
    progress.start(len(suite.cells), len(suite.cells) - len(pending))
    for position, outcome, seconds in _results(suite.cells, pending, workers):
        if isinstance(outcome, str):
            store.fail(file, position, outcome, seconds)
        else:
            _keep(folder / "artifacts", outcome.artifacts)
            store.finish(file, position, outcome.rows, seconds)
        progress.advance(suite.cells[position].name, isinstance(outcome, str))
    run = load_run(folder)
    timing = {
        "started": started.isoformat(timespec="seconds"),
        "wall_seconds": round(time.perf_counter() - wall, 3),
        "cpu_seconds": round(sum(cell.seconds for cell in run.cells), 3),
        "workers": workers,
        "host": platform.node(),
        "processors": os.cpu_count(),
        "cells": {cell.name: round(cell.seconds, 4) for cell in run.cells},
    }
    _write(folder / "results.csv", table(run.cells))
    _write(folder / "manifest.json", json.dumps(known, indent=2) + "\n")
    _write(folder / "timing.json", json.dumps(timing, indent=2) + "\n")
    return load_run(folder)


def execute(cell: Cell) -> Outcome:
    """Compute one cell.

    Parameters
    ----------
    cell : Cell
        Study, parameters and seed.

    Returns
    -------
    Outcome
        Its rows and artifacts.
    """
    return find_study(cell.study).run(cell.parameters, cell.streams)


def _attempt(position: int, cell: Cell) -> Done:
    start = time.process_time()
    try:
        outcome: Outcome | str = execute(cell)
    except Exception:  # whatever a study does, the other cells go on
        outcome = traceback.format_exc()
    return position, outcome, time.process_time() - start


def _results(
    cells: tuple[Cell, ...], pending: list[int], workers: int
) -> Iterator[Done]:
    if workers == 1:
        for position in pending:
            yield _attempt(position, cells[position])
        return
    left = set(pending)
    try:
        for done in _pooled(cells, pending, workers):
            left.discard(done[0])
            yield done
    except BrokenProcessPool:
        pass  # a worker died: its cells, in `left`, run again, each on its own
    for position in sorted(left):
        try:
            yield from _pooled(cells, [position], 1)
        except BrokenProcessPool:
            message = "the worker process died while it computed this cell"
            yield position, message, 0.0


def _pooled(
    cells: tuple[Cell, ...], positions: Iterable[int], workers: int
) -> Iterator[Done]:
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures: list[Future[Done]] = [
            pool.submit(_attempt, position, cells[position]) for position in positions
        ]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _create(folder: Path, suite: Suite, known: Mapping[str, Any]) -> None:
    if folder.exists():
        msg = f"{folder} exists; choose another folder, or --resume to go on with it"
        raise InputError(msg)
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        msg = f"cannot make {folder}: {error}; choose a folder that can be written"
        raise InputError(msg) from None
    # The store appears under its name only when it is whole.
    part = folder / "run.sqlite.part"
    store.create(part, suite.cells, {"manifest": json.dumps(known)})
    part.rename(folder / "run.sqlite")


def _resumed(folder: Path, known: Mapping[str, Any]) -> list[int]:
    earlier = load_run(folder)
    changed = provenance.differences(
        {key: earlier.manifest.get(key) for key in FIXED},
        # through JSON, as the earlier one went
        json.loads(json.dumps({key: known[key] for key in FIXED})),
    )
    if changed:
        msg = (
            f"{folder} was begun with another suite or version and cannot go on: "
            f"{'; '.join(changed)}; use a new folder"
        )
        raise InputError(msg)
    return [i for i, cell in enumerate(earlier.cells) if cell.status != "done"]


def _keep(folder: Path, artifacts: Mapping[str, Any]) -> None:
    for name, content in artifacts.items():
        if isinstance(content, bytes):
            data = content
        else:
            buffer = io.BytesIO()
            np.savez(buffer, **content)
            data = buffer.getvalue()
        folder.mkdir(exist_ok=True)
        _write(folder / name, data)


def _write(path: Path, content: str | bytes) -> None:
    data = content.encode() if isinstance(content, str) else content
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        msg = f"cannot write {path}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None
