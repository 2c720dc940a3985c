"""The store of a run: one SQLite file, one transaction for each batch of cells.

The driver of a sweep is the only writer. A cell is stored completely or not at all, so
a run that was killed at any moment can be resumed. The write-ahead log goes to the
operating system at each commit and to the disk now and then: a killed program loses
the batches in flight, a power cut the last ones stored at most; `--resume` computes
them again.

Each cell has a digest of all that is stored of it, written in the same transaction, and
so has the manifest: later damage to a store is detected (`simval.sweep.cells`).
"""

import json
import sqlite3
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

from simval.studies.study import Cell
from simval.sweep.connections import explained, fold, to_read, to_write
from simval.sweep.documents import (
    DamagedError,
    checked_call,
    checked_manifest,
    read_json,
)
from simval.sweep.entries import (
    CELL_FIELDS,
    NAMED,
    ROW_FIELDS,
    Done,
    Stored,
    cell_entry,
    digest_of,
    digest_of_entries,
)
from simval.sweep.machines import counted

SCHEMA_VERSION = 2
ROW_COLUMNS = ", ".join(f'"{name}"' for name in NAMED)

TIMES = "times of "
"""What the entry begins with that holds the times of a cell."""

FILES = "files"
"""Entry of the digests of the files beside the store."""

WORST = "worst"
"""Entry of the worst ending of the finished cells."""

MACHINES = "machines"
"""Entry of the number of finished cells by the machine that computed them."""

TABLES = f"""
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
    """Open the store of a run to read from it.

    Raises
    ------
    InputError
        If there is no such file, it is no store, it is of another schema, or it is
        damaged.
    """
    with explained(path), closing(to_read(path, TABLES, SCHEMA_VERSION)) as database:
        database.row_factory = sqlite3.Row
        database.execute("BEGIN")
        yield database


@contextmanager
def writing(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the store of a run to add to it."""
    with explained(path), closing(to_write(path, TABLES, SCHEMA_VERSION)) as database:
        yield database
        fold(database)  # one file again when all is done


def create(path: Path, cells: Iterable[Cell], manifest: str) -> None:
    """Make a new store with every cell pending."""
    entries = (
        ("schema", str(SCHEMA_VERSION)),
        ("manifest", manifest),
        ("manifest digest", digest_of(manifest)),
    )
    with explained(path), closing(sqlite3.connect(path)) as database, database:
        # at once, as nobody has the file open yet
        database.execute("PRAGMA journal_mode = WAL")
        database.executescript(TABLES)
        database.executemany("INSERT INTO meta VALUES (?, ?)", entries)
        marks = ", ".join("?" * (1 + len(CELL_FIELDS)))
        database.executemany(
            f"INSERT INTO cells VALUES ({marks})",
            (
                (*entry, digest_of_entries(entry, ()))
                for i, cell in enumerate(cells)
                for entry in (cell_entry(i, cell, "pending", "", 0.0),)
            ),
        )


def stored_cell(
    database: sqlite3.Connection, position: int
) -> tuple[sqlite3.Row, list[Stored]]:
    """Read the entry of a cell and its rows."""
    cursor = database.cursor()
    cursor.row_factory = sqlite3.Row
    query = "SELECT * FROM cells WHERE position = ?"
    cell = cursor.execute(query, (position,)).fetchone()
    cursor.row_factory = None
    query = f"SELECT {ROW_COLUMNS} FROM rows WHERE cell = ? ORDER BY ordinal"
    return cell, cursor.execute(query, (position,)).fetchall()


def digest_of_cell(cell: sqlite3.Row, rows: Iterable[Stored]) -> str:
    """Digest of all that is stored of a cell."""
    return digest_of_entries([cell[name] for name in CELL_FIELDS], rows)


def finish(database: sqlite3.Connection, batch: Sequence[Done], worst: str) -> None:
    """Store cells that have ended with their rows, in one transaction."""
    marks = ", ".join("?" * (2 + len(ROW_FIELDS)))
    with database:
        database.executemany(
            f"INSERT INTO rows VALUES ({marks})",
            chain.from_iterable(done.rows for done in batch),
        )
        database.executemany(
            "UPDATE cells SET status = ?, error = ?, seconds = ?, digest = ? "
            "WHERE position = ?",
            ((*done.cell[5:], done.digest, done.cell[0]) for done in batch),
        )
        for done in batch:
            times = json.dumps(dict(done.times)) if done.times else None
            _set(database, f"{TIMES}{done.cell[1]}", times)
        _set(database, WORST, worst)
        _set(database, MACHINES, counted(entry(database, MACHINES), batch))


def keep_manifest(database: sqlite3.Connection, content: Mapping[str, Any]) -> None:
    """Replace the manifest, in one transaction."""
    text = json.dumps(content)
    with database:
        _set(database, "manifest", text)
        _set(database, "manifest digest", digest_of(text))


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
        _set(database, key, value)


def _set(database: sqlite3.Connection, key: str, value: str | None) -> None:
    database.execute("DELETE FROM meta WHERE key = ?", (key,))
    if value is not None:
        database.execute("INSERT INTO meta VALUES (?, ?)", (key, value))


def size(database: sqlite3.Connection) -> int:
    """Number of rows that were stored, which is found at once."""
    least, most = (
        int(database.execute(f"SELECT {which}(rowid) FROM rows").fetchone()[0] or 0)
        for which in ("min", "max")
    )
    if least < 0:
        msg = f"its rows are numbered from {least}"
        raise DamagedError(msg)
    return most


def entries(database: sqlite3.Connection) -> dict[str, Any]:
    """All that the store says of the run itself, but for the digests of its files."""
    query = "SELECT key, value FROM meta WHERE key != ? ORDER BY key"
    return dict(database.execute(query, (FILES,)).fetchall())


def sealed(database: sqlite3.Connection) -> dict[str, str]:
    """The digests of the files beside the store, as the sweep left them."""
    text = entry(database, FILES)
    digests = {} if text is None else read_json("the list of files", text)
    if not isinstance(digests, dict):
        msg = f"the list of files is {digests!r:.60}, not an object"
        raise DamagedError(msg)
    return digests


def times(database: sqlite3.Connection) -> dict[str, Any]:
    """What was timed in each cell, by its name."""
    query = "SELECT key, value FROM meta WHERE substr(key, 1, ?) = ? ORDER BY key"
    found = database.execute(query, (len(TIMES), TIMES))
    return {
        key.removeprefix(TIMES): checked_call(
            f"entry {key!r:.60}", read_json(f"the entry {key!r:.60}", value)
        )
        for key, value in found
    }


def entry(database: sqlite3.Connection, key: str) -> Any:
    """Read an entry of the store."""
    query = "SELECT value FROM meta WHERE key = ?"
    value = database.execute(query, (key,)).fetchone()
    return value[0] if value else None


def unfinished(database: sqlite3.Connection) -> Sequence[int]:
    """List the cells that have no result."""
    query = "SELECT position FROM cells WHERE status != 'done' ORDER BY position"
    return array("q", (entry[0] for entry in database.execute(query)))


def finished(database: sqlite3.Connection) -> Sequence[int]:
    """List the finished cells by their names."""
    query = "SELECT position FROM cells WHERE status = 'done' ORDER BY cell"
    return array("q", (entry[0] for entry in database.execute(query)))


def count(
    database: sqlite3.Connection, status: str | None = None, error: str = ""
) -> int:
    """Number of cells, of a status and with an error that begins so, if given."""
    query = (
        "SELECT count(*) FROM cells WHERE (? IS NULL OR status = ?) "
        "AND substr(error, 1, ?) = ?"
    )
    values = (status, status, len(error), error)
    return int(database.execute(query, values).fetchone()[0])


def failures(database: sqlite3.Connection, most: int) -> list[tuple[str, str]]:
    """List the first cells that failed, each with its error."""
    query = (
        "SELECT cell, error FROM cells WHERE status = 'failed' ORDER BY position "
        "LIMIT ?"
    )
    return [(entry[0], entry[1]) for entry in database.execute(query, (most,))]


def seconds(database: sqlite3.Connection) -> Iterator[tuple[str, float]]:
    """Read the name and the CPU time of each cell."""
    query = "SELECT cell, seconds FROM cells ORDER BY position"
    return ((entry[0], entry[1]) for entry in database.execute(query))


def names(database: sqlite3.Connection) -> Iterator[str]:
    """Read the names of the cells."""
    query = "SELECT cell FROM cells ORDER BY position"
    return (entry[0] for entry in database.execute(query))
