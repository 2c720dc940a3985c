"""The driver of a sweep: cells out to workers, results into the store.

Only the driver writes. A cell's numbers depend on its name and seed alone, so any
number of workers, in any order, leaves the same table.
"""

import io
import json
import os
import platform
import time
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from simval.errors import InputError
from simval.sweep import provenance, store
from simval.sweep.executors import Done, clustered, pooled, serial
from simval.sweep.run import Run, load_run, write_table
from simval.sweep.suite import Suite, load_suite
from simval.verdict import Answer, judge, overall

# What must be equal for a run to be resumed; a dirty checkout may go on.
FIXED = ("suite", "grid", "versions", "models")
PART = "run.sqlite.part"
ALPHA = 1e-3

Ending = Answer | Literal["failed", "recorded"]
"""How a cell ended: its own verdict, a crash, or nothing in it to judge."""


class Progress(Protocol):
    """What the driver tells while it works."""

    def start(self, total: int, done: int) -> None:
        """Begin.

        Parameters
        ----------
        total : int
            Cells of the suite.
        done : int
            Those that were finished earlier.
        """

    def advance(self, name: str, ending: Ending) -> None:
        """Note that one more cell has ended.

        Parameters
        ----------
        name : str
            Of the cell.
        ending : str
            How it ended.
        """


class Silence:
    """A progress that says nothing."""

    def start(self, total: int, done: int) -> None:
        """Say nothing.

        Parameters
        ----------
        total : int
            Not used.
        done : int
            Not used.
        """

    def advance(self, name: str, ending: Ending) -> None:
        """Say nothing.

        Parameters
        ----------
        name : str
            Not used.
        ending : str
            Not used.
        """


def run_suite(
    suite: str | Suite,
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
    suite : str or Suite
        Built-in name, path of a TOML file, or a loaded suite.
    out : str or Path
        Folder of the run; must not exist unless `resume`.
    workers : int, default 1
        Local processes; 1 works in this process.
    scheduler : str, optional
        Address of a dask.distributed scheduler that computes the cells instead.
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
    drive(
        load_suite(suite) if isinstance(suite, str) else suite,
        Path(out),
        workers=workers,
        scheduler=scheduler,
        resume=resume,
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
    """Run a suite into a folder; memory does not grow with the number of rows.

    Parameters
    ----------
    suite : Suite
        What to run.
    folder : Path
        Folder of the run.
    workers : int
        Local processes.
    scheduler : str or None
        Address of a scheduler that computes the cells instead.
    resume : bool
        Go on with an interrupted run.
    progress : Progress
        Told of each cell that ends.

    Raises
    ------
    InputError
        As `run_suite`.
    """
    if not workers >= 1:
        msg = f"`workers` is {workers}; give 1 or more"
        raise InputError(msg)
    known = provenance.manifest(suite)
    file = folder / "run.sqlite"
    if resume and file.is_file():
        pending = _resumed(folder, known)
    else:
        _create(folder, suite, known, resume=resume)
        pending = list(range(len(suite.cells)))
    started, wall = datetime.now(UTC), time.perf_counter()
    progress.start(len(suite.cells), len(suite.cells) - len(pending))
    with store.writing(file) as database:
        for position, outcome, seconds in _results(suite, pending, workers, scheduler):
            name = suite.cells[position].name
            if isinstance(outcome, str):
                store.fail(database, position, outcome, seconds)
                progress.advance(name, "failed")
                continue
            _keep(folder / "artifacts", outcome.artifacts)
            store.finish(database, position, outcome.rows, seconds)
            verdicts = judge(
                ((name, row) for row in outcome.rows), ALPHA / len(suite.cells)
            )
            progress.advance(name, overall(verdicts) if verdicts else "recorded")
        spent = store.seconds(database)
        write_table(database, folder / "results.csv")
    timing = {
        "started": started.isoformat(timespec="seconds"),
        "wall_seconds": round(time.perf_counter() - wall, 3),
        "cpu_seconds": round(sum(spent.values()), 3),
        "workers": scheduler or workers,
        "host": platform.node(),
        "processors": os.cpu_count(),
        "cells": {name: round(value, 4) for name, value in spent.items()},
    }
    _write(folder / "manifest.json", json.dumps(known, indent=2) + "\n")
    _write(folder / "timing.json", json.dumps(timing, indent=2) + "\n")


def _results(
    suite: Suite, pending: list[int], workers: int, scheduler: str | None
) -> Iterator[Done]:
    if scheduler is not None:
        return clustered(suite.cells, pending, scheduler)
    if workers == 1:
        return serial(suite.cells, pending)
    return pooled(suite.cells, pending, workers)


def _create(
    folder: Path, suite: Suite, known: Mapping[str, Any], *, resume: bool
) -> None:
    # a run that was stopped before its store was whole left nothing but a part of it
    begun = resume and folder.is_dir() and {p.name for p in folder.iterdir()} <= {PART}
    if folder.exists() and not begun:
        msg = f"{folder} exists; choose another folder, or --resume to go on with it"
        raise InputError(msg)
    try:
        folder.mkdir(parents=True, exist_ok=begun)
        (folder / PART).unlink(missing_ok=True)
    except OSError as error:
        msg = f"cannot make {folder}: {error}; choose a folder that can be written"
        raise InputError(msg) from None
    # The store appears under its name only when it is whole.
    store.create(folder / PART, suite.cells, json.dumps(known))
    (folder / PART).rename(folder / "run.sqlite")


def _resumed(folder: Path, known: Mapping[str, Any]) -> list[int]:
    with store.opened(folder / "run.sqlite") as database:
        earlier = store.manifest(database)
        pending = store.unfinished(database)
    changed = provenance.differences(
        {key: earlier.get(key) for key in FIXED},
        # through JSON, as the earlier one went
        json.loads(json.dumps({key: known[key] for key in FIXED})),
    )
    if changed:
        msg = (
            f"{folder} was begun with another suite or version and cannot go on: "
            f"{'; '.join(changed)}; use a new folder"
        )
        raise InputError(msg)
    return pending


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
