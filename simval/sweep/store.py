"""The store of a run: one SQLite file, one transaction for each finished cell.

The driver of a sweep is the only writer. A cell is in the store whole or not at all,
so a run that was killed at any moment can be resumed.
"""

import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from simval.errors import InputError
from simval.results import Row
from simval.studies.study import Cell

SCHEMA_VERSION = 1
ROW_FIELDS = tuple(f.name for f in fields(Row))

_TABLES = f"""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE cells (
  position INTEGER PRIMARY KEY, cell TEXT UNIQUE NOT NULL, study TEXT NOT NULL,
  seed INTEGER NOT NULL, parameters TEXT NOT NULL,
  status TEXT NOT NULL CHECK (status IN ('pending', 'done', 'failed')),
  error TEXT NOT NULL DEFAULT '', seconds REAL NOT NULL DEFAULT 0);
CREATE TABLE rows (
  cell INTEGER NOT NULL REFERENCES cells (position), ordinal INTEGER NOT NULL,
  {", ".join(f'"{name}"' for name in ROW_FIELDS)},
  PRIMARY KEY (cell, ordinal));
"""


def create(path: Path, cells: Iterable[Cell], meta: dict[str, str]) -> None:
    """Make a new store with every cell pending.

    Parameters
    ----------
    path : Path
        File to create; must not exist.
    cells : iterable of Cell
        The cells of the suite, in order.
    meta : dict
        Text entries to keep: fingerprint, suite and so on.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with _opened(path) as database, database:
        database.executescript(_TABLES)
        entries = {"schema": str(SCHEMA_VERSION), **meta}
        database.executemany("INSERT INTO meta VALUES (?, ?)", entries.items())
        database.executemany(
            "INSERT INTO cells (position, cell, study, seed, parameters, status) "
            "VALUES (?, ?, ?, ?, ?, 'pending')",
            [
                (i, c.name, c.study, c.seed, c.parameters.model_dump_json())
                for i, c in enumerate(cells)
            ],
        )


def finish(path: Path, position: int, rows: Iterable[Row], seconds: float) -> None:
    """Keep the rows of a finished cell, in one transaction.

    Parameters
    ----------
    path : Path
        The store.
    position : int
        Place of the cell in the suite.
    rows : iterable of Row
        Its statistics.
    seconds : float
        CPU time that it took, s.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    marks = ", ".join("?" * (2 + len(ROW_FIELDS)))
    with _opened(path) as database, database:
        database.executemany(
            f"INSERT INTO rows VALUES ({marks})",
            [(position, i, *asdict(row).values()) for i, row in enumerate(rows)],
        )
        database.execute(
            "UPDATE cells SET status = 'done', error = '', seconds = ? "
            "WHERE position = ?",
            (seconds, position),
        )


def fail(path: Path, position: int, error: str, seconds: float) -> None:
    """Record that a cell failed, and why.

    Parameters
    ----------
    path : Path
        The store.
    position : int
        Place of the cell in the suite.
    error : str
        The traceback or message.
    seconds : float
        CPU time that it took, s.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with _opened(path) as database, database:
        database.execute(
            "UPDATE cells SET status = 'failed', error = ?, seconds = ? "
            "WHERE position = ?",
            (error, seconds, position),
        )


def read(path: Path) -> tuple[dict[str, str], list[dict[str, Any]], list[list[Row]]]:
    """Read a store: its meta entries, its cells, and the rows of each cell.

    Parameters
    ----------
    path : Path
        The store.

    Returns
    -------
    meta : dict
        Text entries.
    cells : list of dict
        position, cell, study, seed, parameters (dict), status, error, seconds.
    rows : list of list of Row
        Rows of each cell, in the order of the cells.

    Raises
    ------
    InputError
        If the file is no store of a run, or of a newer schema.
    """
    if not path.is_file():
        msg = f"{path} does not exist, so {path.parent} is no run folder"
        raise InputError(msg)
    try:
        with _opened(path) as database:
            meta = dict(database.execute("SELECT key, value FROM meta"))
            version = int(meta.get("schema", "-1"))
            if version != SCHEMA_VERSION:
                msg = (
                    f"{path} has schema {version}; this program reads "
                    f"{SCHEMA_VERSION}; use the version of simval that wrote it"
                )
                raise InputError(msg)
            database.row_factory = sqlite3.Row
            cells = [
                {**dict(c), "parameters": json.loads(c["parameters"])}
                for c in database.execute("SELECT * FROM cells ORDER BY position")
            ]
            rows: list[list[Row]] = [[] for _ in cells]
            names = ", ".join(f'"{name}"' for name in ROW_FIELDS)
            query = f"SELECT cell AS position, {names} FROM rows ORDER BY cell, ordinal"
            for entry in database.execute(query):
                rows[entry["position"]].append(
                    Row(**{name: entry[name] for name in ROW_FIELDS})
                )
    except (sqlite3.Error, ValueError, TypeError, IndexError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        msg = f"{path} is not the store of a run, or is damaged: {error}"
        raise InputError(msg) from None
    return meta, cells, rows


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    try:
        with closing(sqlite3.connect(path)) as database:
            yield database
    except sqlite3.OperationalError as error:
        msg = f"cannot use {path}: {error}; is the disk full or the folder read-only?"
        raise InputError(msg) from None
