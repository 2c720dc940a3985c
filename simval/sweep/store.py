"""The store of a run: one SQLite file, one transaction for each finished cell.

The driver of a sweep is the only writer. A cell is stored completely or not at all, so
a run that was killed at any moment can be resumed. The write-ahead log goes to the
operating system at each commit and to the disk now and then: a killed program loses
nothing, a power cut at most the last cells, which are then computed again.

Each cell has a digest of all that is stored of it, written in the same transaction, and
so has the manifest: later damage to a store is detected (`simval.sweep.cells`).
"""

import hashlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

from simval.errors import InputError
from simval.results import Row
from simval.statistics import Statistic
from simval.studies.study import Cell
from simval.sweep.documents import DamagedError, checked_manifest, read_json
from simval.text import printable

SCHEMA_VERSION = 2
ROW_FIELDS = tuple(f.name for f in (*fields(Statistic), *fields(Row)[1:]))
"""Fields of a row's statistic, whose entries are a JSON list, and of the row."""
CELL_FIELDS = (
    "position",
    "cell",
    "study",
    "seed",
    "parameters",
    "status",
    "error",
    "seconds",
)
ROW_COLUMNS = ", ".join(("ordinal", *(f'"{name}"' for name in ROW_FIELDS)))

TIMES = "times of "
"""What the entry begins with that holds the times of a cell."""

_TABLES = f"""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE cells (
  position INTEGER PRIMARY KEY, cell TEXT UNIQUE NOT NULL, study TEXT NOT NULL,
  seed INTEGER NOT NULL, parameters TEXT NOT NULL,
  status TEXT NOT NULL CHECK (status IN ('pending', 'done', 'failed')),
  error TEXT NOT NULL DEFAULT '', seconds REAL NOT NULL DEFAULT 0,
  digest TEXT NOT NULL DEFAULT '');
CREATE TABLE rows (
  cell INTEGER NOT NULL REFERENCES cells (position), ordinal INTEGER NOT NULL,
  {", ".join(f'"{name}"' for name in ROW_FIELDS)},
  PRIMARY KEY (cell, ordinal));
"""


@contextmanager
def opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the store of a run.

    Raises
    ------
    InputError
        If there is no such file, it is no store, it is of another schema, it is
        damaged, or it cannot be written to.
    """
    with _connected(path) as database:
        database.execute("BEGIN")
        yield database


@contextmanager
def _connected(path: Path) -> Iterator[sqlite3.Connection]:
    if not path.is_file():
        msg = f"{path} does not exist, so {path.parent} is no run folder"
        raise InputError(msg)
    with _explained(path), closing(sqlite3.connect(path)) as database:
        version = entry(database, "schema")
        if version != str(SCHEMA_VERSION):
            given = "no schema" if version is None else f"schema {version}"
            msg = (
                f"{path} has {given}; this program reads {SCHEMA_VERSION}; use the "
                "version of simval that wrote it"
            )
            raise InputError(msg)
        database.row_factory = sqlite3.Row
        yield database


@contextmanager
def writing(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the store of a run to add to it."""
    with _connected(path) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = NORMAL")
        yield database
        # one file again when all is done
        database.execute("PRAGMA journal_mode = DELETE")


def create(path: Path, cells: Iterable[Cell], manifest: str) -> None:
    """Make a new store with every cell pending."""
    entries = (
        ("schema", str(SCHEMA_VERSION)),
        ("manifest", manifest),
        ("manifest digest", digest_of(manifest)),
    )
    with _explained(path), closing(sqlite3.connect(path)) as database, database:
        database.executescript(_TABLES)
        database.executemany("INSERT INTO meta VALUES (?, ?)", entries)
        database.executemany(
            "INSERT INTO cells (position, cell, study, seed, parameters, status) "
            "VALUES (?, ?, ?, ?, ?, 'pending')",
            (
                (i, c.name, c.study, c.seed, json.dumps(c.parameters.named()))
                for i, c in enumerate(cells)
            ),
        )
        for position in unfinished(database):
            sign(database, position)


def sign(database: sqlite3.Connection, position: int) -> None:
    """Write the digest of all that is stored of a cell, within a transaction."""
    digest = digest_of_cell(*stored_cell(database, position))
    query = "UPDATE cells SET digest = ? WHERE position = ?"
    database.execute(query, (digest, position))


def stored_cell(
    database: sqlite3.Connection, position: int
) -> tuple[sqlite3.Row, list[sqlite3.Row]]:
    """Read the entry of a cell and its rows."""
    cursor = database.cursor()
    cursor.row_factory = sqlite3.Row
    query = "SELECT * FROM cells WHERE position = ?"
    cell = cursor.execute(query, (position,)).fetchone()
    query = f"SELECT {ROW_COLUMNS} FROM rows WHERE cell = ? ORDER BY ordinal"
    return cell, cursor.execute(query, (position,)).fetchall()


def digest_of_cell(cell: sqlite3.Row, rows: Sequence[sqlite3.Row]) -> str:
    """Digest of all that is stored of a cell."""
    names = ("ordinal", *ROW_FIELDS)
    return digest_of(
        [
            [cell[name] for name in CELL_FIELDS],
            *([row[name] for name in names] for row in rows),
        ]
    )


def digest_of(content: Any) -> str:
    """SHA-256 of numbers, words and lists of them, exact and by type."""
    return hashlib.sha256(repr(content).encode()).hexdigest()


def finish(
    database: sqlite3.Connection, position: int, rows: Iterable[Row], seconds: float
) -> None:
    """Store the rows of a finished cell, in one transaction."""
    marks = ", ".join("?" * (2 + len(ROW_FIELDS)))
    with database:
        database.executemany(
            f"INSERT INTO rows VALUES ({marks})",
            [(position, i, *_fields(row)) for i, row in enumerate(rows)],
        )
        database.execute(
            "UPDATE cells SET status = 'done', error = '', seconds = ? "
            "WHERE position = ?",
            (seconds, position),
        )
        sign(database, position)


def _fields(row: Row) -> tuple[Any, ...]:
    """What is stored of a row, in the order of `ROW_FIELDS`."""
    what = row.statistic
    named = (
        what.family.name,
        json.dumps(what.entries, separators=(",", ":")),
        what.controlled,
        what.unit,
    )
    return (*named, *(getattr(row, name) for name in ROW_FIELDS[len(named) :]))


def fail(
    database: sqlite3.Connection, position: int, error: str, seconds: float
) -> None:
    """Store that a cell failed, and why."""
    with database:
        database.execute(
            "UPDATE cells SET status = 'failed', error = ?, seconds = ? "
            "WHERE position = ?",
            (printable(error), seconds, position),
        )
        sign(database, position)


def manifest(database: sqlite3.Connection) -> dict[str, Any]:
    """Read the manifest: what the numbers of the run depend on."""
    text = entry(database, "manifest")
    content = checked_manifest(text)
    if entry(database, "manifest digest") != digest_of(text):
        msg = "the manifest is not what the sweep stored (its SHA-256 differs)"
        raise DamagedError(msg)
    return content


def keep(database: sqlite3.Connection, key: str, value: str | None) -> None:
    """Set an entry of the store, in one transaction."""
    with database:
        database.execute("DELETE FROM meta WHERE key = ?", (key,))
        if value is not None:
            database.execute("INSERT INTO meta VALUES (?, ?)", (key, value))


def keep_times(database: sqlite3.Connection, name: str, times: Any) -> None:
    """Keep what was timed in a cell, beside what is compared."""
    keep(database, f"{TIMES}{name}", json.dumps(dict(times)) if times else None)


def times(database: sqlite3.Connection) -> dict[str, Any]:
    """What was timed in each cell, by its name."""
    query = "SELECT key, value FROM meta WHERE substr(key, 1, ?) = ? ORDER BY key"
    found = database.execute(query, (len(TIMES), TIMES))
    return {
        key.removeprefix(TIMES): read_json(f"the entry {key!r:.60}", value)
        for key, value in found
    }


def entry(database: sqlite3.Connection, key: str) -> Any:
    """Read an entry of the store."""
    query = "SELECT value FROM meta WHERE key = ?"
    value = database.execute(query, (key,)).fetchone()
    return value[0] if value else None


def unfinished(database: sqlite3.Connection) -> list[int]:
    """List the cells that have no result."""
    query = "SELECT position FROM cells WHERE status != 'done' ORDER BY position"
    return [entry[0] for entry in database.execute(query)]


def failures(database: sqlite3.Connection) -> list[tuple[str, str]]:
    """List the cells that failed."""
    query = "SELECT cell, error FROM cells WHERE status = 'failed' ORDER BY position"
    return [(entry[0], entry[1]) for entry in database.execute(query)]


def seconds(database: sqlite3.Connection) -> dict[str, float]:
    """Read the CPU time of each cell."""
    query = "SELECT cell, seconds FROM cells ORDER BY position"
    return {entry[0]: entry[1] for entry in database.execute(query)}


def names(database: sqlite3.Connection) -> list[str]:
    """List the names of the cells."""
    query = "SELECT cell FROM cells ORDER BY position"
    return [entry[0] for entry in database.execute(query)]


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn errors of SQLite, and damaged content, into messages."""
    try:
        yield
    except DamagedError as error:
        msg = (
            f"{path} is damaged: {error}; restore it from a copy, or run the suite "
            "again in a new folder"
        )
        raise InputError(msg) from None
    except sqlite3.OperationalError as error:
        if "no such table" in str(error) or "no such column" in str(error):
            msg = f"{path} is not the store of a run: {error}"
        else:
            msg = f"cannot use {path}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None
    except sqlite3.Error as error:
        msg = f"{path} is not the store of a run, or is damaged: {error}"
        raise InputError(msg) from None
