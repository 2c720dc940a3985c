"""The folder of a run while it is written: created, resumed, locked, filled."""

import fcntl
import io
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from simval.errors import InputError
from simval.sweep import provenance, store
from simval.sweep.inside import require_folder
from simval.sweep.machines import environments
from simval.sweep.parts import completed
from simval.sweep.suite import Suite

# What must be equal for a run to be resumed. The commit may differ where only texts
# changed: the numbers depend on the source itself.
FIXED = ("suite", "grid", "versions", "source", "models", "files", "machine")
PART = "run.sqlite.part"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep a run folder for one driver."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        msg = f"another sweep is at work in {folder}; wait for it or stop it"
        raise InputError(msg) from None
    finally:
        os.close(handle)


def create(folder: Path, suite: Suite, known: Mapping[str, Any], resume: bool) -> None:
    """Make the folder of a new run, with every cell pending."""
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
        store.create(folder / PART, suite.cells, json.dumps(known))
        (folder / PART).rename(folder / "run.sqlite")
    except BaseException:  # a run that did not start must not block the next one
        shutil.rmtree(folder, ignore_errors=True)
        raise


def check_same(folder: Path, suite: Suite, known: Mapping[str, Any]) -> None:
    """Refuse to resume a run of another suite, version or source, or a damaged one."""
    require_folder(folder / "artifacts")
    with store.opened(folder / "run.sqlite") as database:
        store.times(database)
        environments(store.entry(database, store.MACHINES))
        earlier = store.manifest(database)
        same = _same(store.names(database), (cell.name for cell in suite.cells))
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


def _same(one: Iterable[str], other: Iterable[str]) -> bool:
    return all(a == b for a, b in zip_longest(one, other))


def keep(folder: Path, artifacts: Mapping[str, Any]) -> None:
    """Write the artifacts of a cell."""
    for name, content in artifacts.items():
        data = content
        if not isinstance(content, bytes):
            buffer = io.BytesIO()
            np.savez(buffer, **content)
            data = buffer.getvalue()
        write(folder / name, data)


def write(path: Path, content: str | bytes) -> None:
    """Write a file that appears only when it is complete."""
    data = content.encode() if isinstance(content, str) else content
    try:
        path.parent.mkdir(exist_ok=True)
        with completed(path) as file:
            file.write(data)
    except OSError as error:
        msg = f"cannot write {path}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None
