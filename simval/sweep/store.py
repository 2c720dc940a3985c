"""The store of a run: one SQLite file, one transaction for each finished cell.

The driver of a sweep is the only writer. A cell is in the store whole or not at all,
so a run that was killed at any moment can be resumed. The write-ahead log is handed to
the operating system at each commit and forced to the disk now and then: a killed
program loses nothing, a power cut at most the last cells, which are then computed
again.
"""

import json
import math
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

from simval.errors import InputError
from simval.plugins.errors import printable
from simval.results import Check, Row
from simval.studies import STUDIES
from simval.studies.files import portable_fields
from simval.studies.study import Cell, portable_values

SCHEMA_VERSION = 1
ROW_FIELDS = tuple(f.name for f in fields(Row))

# kind of each field, and what an entry that is missing means
_KINDS: Mapping[str, tuple[Callable[[Any], Any], Any]] = MappingProxyType(
    {
        "statistic": (str, ""),
        "value": (float, math.nan),
        "unit": (str, "1"),
        "standard_error": (float, math.nan),
        "n": (int, 0),
        "prediction": (float, None),
        "predictor": (str, ""),
        "remainder": (float, math.nan),
        "check": (str, "record"),
    }
)
CHECKS = get_args(Check)

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


@contextmanager
def opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the store of a run.

    Parameters
    ----------
    path : Path
        The store.

    Yields
    ------
    sqlite3.Connection
        Closed at the end of the context.

    Raises
    ------
    InputError
        If there is no such file, it is no store, it is of another schema, or it
        cannot be written to.
    """
    if not path.is_file():
        msg = f"{path} does not exist, so {path.parent} is no run folder"
        raise InputError(msg)
    with _explained(path), closing(sqlite3.connect(path)) as database:
        version = database.execute(
            "SELECT value FROM meta WHERE key = 'schema'"
        ).fetchone()
        if version is None or version[0] != str(SCHEMA_VERSION):
            found = "no schema" if version is None else f"schema {version[0]}"
            msg = (
                f"{path} has {found}; this program reads {SCHEMA_VERSION}; use the "
                "version of simval that wrote it"
            )
            raise InputError(msg)
        database.row_factory = sqlite3.Row
        yield database


@contextmanager
def writing(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the store of a run to add to it.

    Parameters
    ----------
    path : Path
        The store.

    Yields
    ------
    sqlite3.Connection
        One transaction costs a tenth of a millisecond, not a turn of the disk.

    Raises
    ------
    InputError
        As `opened`.
    """
    with opened(path) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = NORMAL")
        yield database
        # one file again when all is done
        database.execute("PRAGMA journal_mode = DELETE")


def create(path: Path, cells: Iterable[Cell], manifest: str) -> None:
    """Make a new store with every cell pending.

    Parameters
    ----------
    path : Path
        File to create; must not exist.
    cells : iterable of Cell
        The cells of the suite, in order.
    manifest : str
        What the numbers depend on, as JSON.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    entries = (("schema", str(SCHEMA_VERSION)), ("manifest", manifest))
    with (
        _explained(path),
        closing(sqlite3.connect(path)) as database,
        database,
    ):
        database.executescript(_TABLES)
        database.executemany("INSERT INTO meta VALUES (?, ?)", entries)
        database.executemany(
            "INSERT INTO cells (position, cell, study, seed, parameters, status) "
            "VALUES (?, ?, ?, ?, ?, 'pending')",
            (
                (i, c.name, c.study, c.seed, json.dumps(portable_values(c.parameters)))
                for i, c in enumerate(cells)
            ),
        )


def finish(
    database: sqlite3.Connection, position: int, rows: Iterable[Row], seconds: float
) -> None:
    """Keep the rows of a finished cell, in one transaction.

    Parameters
    ----------
    database : sqlite3.Connection
        The store.
    position : int
        Place of the cell in the suite.
    rows : iterable of Row
        Its statistics.
    seconds : float
        CPU time that it took, s.
    """
    marks = ", ".join("?" * (2 + len(ROW_FIELDS)))
    with database:
        database.executemany(
            f"INSERT INTO rows VALUES ({marks})",
            [
                (position, i, *(getattr(row, name) for name in ROW_FIELDS))
                for i, row in enumerate(rows)
            ],
        )
        database.execute(
            "UPDATE cells SET status = 'done', error = '', seconds = ? "
            "WHERE position = ?",
            (seconds, position),
        )


def fail(
    database: sqlite3.Connection, position: int, error: str, seconds: float
) -> None:
    """Record that a cell failed, and why.

    Parameters
    ----------
    database : sqlite3.Connection
        The store.
    position : int
        Place of the cell in the suite.
    error : str
        The traceback or message; kept as `simval.plugins.errors.printable`.
    seconds : float
        CPU time that it took, s.
    """
    with database:
        database.execute(
            "UPDATE cells SET status = 'failed', error = ?, seconds = ? "
            "WHERE position = ?",
            (printable(error), seconds, position),
        )


MANIFEST_KEYS = ("suite", "title", "grid", "versions", "git", "models", "machine")


def manifest(database: sqlite3.Connection) -> dict[str, Any]:
    """Read what the numbers of the run depend on.

    Parameters
    ----------
    database : sqlite3.Connection
        The store.

    Returns
    -------
    dict
        The manifest.
    """
    query = "SELECT value FROM meta WHERE key = 'manifest'"
    entry = database.execute(query).fetchone()
    content = _json(entry[0] if entry else None)
    missing = [key for key in MANIFEST_KEYS if key not in content]
    if missing:
        msg = f"the store's manifest lacks `{missing[0]}`; run the suite again"
        raise InputError(msg)
    return content


def unfinished(database: sqlite3.Connection) -> list[int]:
    """List the cells that have no result.

    Parameters
    ----------
    database : sqlite3.Connection
        The store.

    Returns
    -------
    list of int
        Their places, in order.
    """
    query = "SELECT position FROM cells WHERE status != 'done' ORDER BY position"
    return [entry[0] for entry in database.execute(query)]


def failures(database: sqlite3.Connection) -> list[tuple[str, str]]:
    """List the cells that failed.

    Parameters
    ----------
    database : sqlite3.Connection
        The store.

    Returns
    -------
    list of (str, str)
        Name and traceback, in the order of the suite.
    """
    query = "SELECT cell, error FROM cells WHERE status = 'failed' ORDER BY position"
    return [(entry[0], entry[1]) for entry in database.execute(query)]


def seconds(database: sqlite3.Connection) -> dict[str, float]:
    """Read the CPU time of each cell.

    Parameters
    ----------
    database : sqlite3.Connection
        The store.

    Returns
    -------
    dict
        Name of the cell to seconds.
    """
    query = "SELECT cell, seconds FROM cells ORDER BY position"
    return {entry[0]: entry[1] for entry in database.execute(query)}


def cells(database: sqlite3.Connection) -> list[dict[str, Any]]:
    """Read the cells.

    Parameters
    ----------
    database : sqlite3.Connection
        The store.

    Returns
    -------
    list of dict
        position, cell, study, seed, parameters (dict, files by their names alone),
        status, error, seconds.
    """
    found = [
        {**dict(entry), "parameters": _parameters(entry)}
        for entry in database.execute("SELECT * FROM cells ORDER BY position")
    ]
    if [cell["position"] for cell in found] != list(range(len(found))):
        msg = "the store's cells are not numbered from 0 without a gap; it is damaged"
        raise InputError(msg)
    return found


def rows(
    database: sqlite3.Connection, position: int | None = None
) -> Iterator[tuple[int, Row]]:
    """Read rows.

    Parameters
    ----------
    database : sqlite3.Connection
        The store.
    position : int, optional
        Place of one cell; default, all of them.

    Yields
    ------
    position : int
        Place of the cell.
    row : Row
        One of its rows; in the order of cells, and of the study within one.
    """
    names = ", ".join(f'"{name}"' for name in ROW_FIELDS)
    query = f"SELECT cell, {names} FROM rows "
    chosen: tuple[int, ...] = ()
    if position is not None:
        query, chosen = query + "WHERE cell = ? ", (position,)
    for entry in database.execute(query + "ORDER BY cell, ordinal", chosen):
        yield entry[0], _row(entry)


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn whatever SQLite, or content that is not ours, does into words."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if "no such table" in str(error) or "no such column" in str(error):
            msg = f"{path} is not the store of a run: {error}"
        else:
            msg = f"cannot use {path}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None
    except sqlite3.Error as error:
        msg = f"{path} is not the store of a run, or is damaged: {error}"
        raise InputError(msg) from None


def _row(entry: sqlite3.Row) -> Row:
    """Row of an entry; SQLite keeps what is not a number as NULL."""
    try:
        values = {
            name: kind(entry[name]) if entry[name] is not None else missing
            for name, (kind, missing) in _KINDS.items()
        }
        if values["check"] not in CHECKS or values["standard_error"] < 0.0:
            raise ValueError(values["check"], values["standard_error"])
        return Row(**values)
    except (ValueError, TypeError, OverflowError) as error:
        msg = f"the store holds a row that is damaged ({error}); run the suite again"
        raise InputError(msg) from None


def _parameters(entry: sqlite3.Row) -> dict[str, Any]:
    values, study = _json(entry["parameters"]), STUDIES.get(entry["study"])
    # a store of an earlier version holds paths
    return values if study is None else portable_fields(study.parameters, values)


def _json(text: Any) -> dict[str, Any]:
    try:
        content = json.loads(text)
        if not isinstance(content, dict):
            msg = f"not an object but {content!r}"
            raise TypeError(msg)
        return content
    except (ValueError, TypeError, RecursionError) as error:
        msg = f"the store holds an entry that is damaged ({error}); run it again"
        raise InputError(msg) from None
