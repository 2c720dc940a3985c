"""The seal of a finished run: the SHA-256 of each file beside the store.

The driver writes it last and removes it first, so a run that was interrupted or is
being resumed has none. A missing file is not damage: a store alone can be judged.
"""

import hashlib
import json
import sqlite3
from pathlib import Path

from simval.errors import InputError
from simval.sweep import store

FOLDERS = ("artifacts", "results")
NAMES = ("results.csv", "manifest.json", "timing.json")


def seal(database: sqlite3.Connection, folder: Path) -> None:
    """Keep the digests of the files that the sweep has written."""
    files = [folder / name for name in NAMES]
    for place in FOLDERS:
        files += sorted((folder / place).rglob("*"))
    digests = {f.relative_to(folder).as_posix(): _digest(f) for f in files if _whole(f)}
    store.keep(database, store.FILES, json.dumps(digests))


def unseal(database: sqlite3.Connection) -> None:
    """Remove the digests of the files, before they are written again."""
    store.keep(database, store.FILES, None)


def check_files(database: sqlite3.Connection, folder: Path) -> None:
    """Refuse a run if one of its files is not what the sweep wrote."""
    for name, digest in store.sealed(database).items():
        file = folder / str(name)
        if file.is_file() and _digest(file) != digest:
            msg = (
                f"{file} is not what the sweep wrote (its SHA-256 differs); restore "
                "it from a copy, or write it again with `simval sweep ... --resume`"
            )
            raise InputError(msg)


def _whole(file: Path) -> bool:
    return file.is_file() and file.suffix != ".part"


def _digest(file: Path) -> str:
    try:
        with file.open("rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest()
    except OSError as error:
        msg = f"cannot read {file}: {error}; is it yours to read?"
        raise InputError(msg) from None
