"""The seal of a finished run: the SHA-256 of each file beside the store.

One more is of all that the store says of the run itself (`ENTRIES`), the list of files
included; each cell has its own. The driver writes the seal last and removes it first:
a run that was interrupted or is being resumed has none. A missing file is not damage: a
store alone can be judged.
"""

import hashlib
import json
import sqlite3
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from simval.errors import InputError
from simval.sweep import store
from simval.sweep.inside import MEBIBYTE, is_inside, opened_inside

FOLDERS = ("artifacts",)
NAMES = ("results.csv", "manifest.json", "timing.json")
READ = (".npz", ".png")
"""What a report reads of the artifacts."""

ENTRIES = "run.sqlite"
"""Name of what the store says of the run, and of the list of files, among the files."""

LINE = 64 * 1024
"""Bytes that a line of results.csv has at most; the suites' have 300."""
MOST_FILE = 256 * MEBIBYTE
"""Bytes of any other file; the times of a million cells take 100 MB."""


def seal(database: sqlite3.Connection, folder: Path) -> None:
    """Keep the digests of the files that the sweep has written."""
    files = [folder / name for name in NAMES]
    for place in FOLDERS:
        files += sorted((folder / place).rglob("*"))
    names = [f.relative_to(folder).as_posix() for f in files if _whole(f)]
    digests = {name: _digest(folder, name, sys.maxsize) for name in names}
    digests[ENTRIES] = _digest_of_entries(database, digests)
    store.keep(database, store.FILES, json.dumps(digests))


def unseal(database: sqlite3.Connection) -> None:
    """Remove the digests of the files, before they are written again."""
    store.keep(database, store.FILES, None)


def check_files(database: sqlite3.Connection, folder: Path) -> None:
    """Refuse a run if one of its files is not what the sweep wrote."""
    known = store.sealed(database)
    if not known:
        return
    if known.pop(ENTRIES, None) != _digest_of_entries(database, known):
        msg = (
            f"what {folder / ENTRIES} says of the run and of its files is not what the "
            "sweep wrote (its SHA-256 differs); restore it from a copy"
        )
        raise InputError(msg)
    limits = {"results.csv": LINE * (1 + store.size(database))}
    for name, digest in known.items():
        most = limits.get(name, MOST_FILE)
        if is_inside(folder, name) and _digest(folder, name, most) != digest:
            msg = (
                f"{folder / name} is not what the sweep wrote (its SHA-256 differs); "
                "restore it from a copy, or write it again with `simval sweep ... "
                "--resume`"
            )
            raise InputError(msg)
    for file in _stray(folder, known):
        msg = (
            f"{file} is not of this run: the sweep wrote no such file; move it out of "
            "the run folder"
        )
        raise InputError(msg)


def _digest_of_entries(database: sqlite3.Connection, files: Mapping[str, Any]) -> str:
    said = [store.entries(database), dict(files)]
    return hashlib.sha256(
        json.dumps(said, sort_keys=True, default=repr).encode()
    ).hexdigest()


def _stray(folder: Path, known: Mapping[str, str]) -> Iterator[Path]:
    """Artifacts, which a report would show, that the sweep did not write."""
    place = folder / "artifacts"
    if place.is_symlink() or not place.is_dir():
        return
    for file in sorted(place.iterdir()):
        if file.suffix in READ and f"artifacts/{file.name}" not in known:
            yield file


def _whole(file: Path) -> bool:
    return file.is_file() and file.suffix != ".part"


def _digest(folder: Path, name: str, most: int) -> str:
    try:
        with opened_inside(folder, name, most) as content:
            return hashlib.file_digest(content, "sha256").hexdigest()
    except FileNotFoundError:  # a link to nothing, or taken away meanwhile
        msg = f"cannot read {folder / name}: it is not there any more"
        raise InputError(msg) from None
