"""The store of a run: one SQLite file, one transaction for each batch.

The driver of a sweep is the only writer. A cell is stored completely or not at all, so
a run that was killed at any moment can be resumed: a killed program loses the batches
in flight, a power cut the last ones stored at most, and `--resume` computes them again.

Damage is found by SQLite's own check of its pages and by digests (SHA-256), each
written in the transaction of what it covers: one of each cell with its rows, one of the
entries that say what the run is, and, once the run is complete, one of all cells and
one of each other file of the run. What fails its digest is never passed on.

Numbers are stored as they are: a column without a type keeps every bit.
"""

import hashlib
import json
import sqlite3
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simval.errors import InputError
from simval.studies.study import Cell
from simval.sweep.cells import (
    CELL_FIELDS,
    ROW_FIELDS,
    CellResult,
    DamagedError,
    Done,
    cell_entry,
    cell_result,
    digest_of,
    digest_of_entries,
)
from simval.sweep.needs import Need

SCHEMA_VERSION = 4
PATIENCE = 30.0
"""Seconds that one waits for another program that writes to the store."""

TABLES = f"""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE cells (
  position INTEGER PRIMARY KEY, cell TEXT, study TEXT, seed INTEGER, parameters TEXT,
  status TEXT, error TEXT, seconds REAL, times TEXT, digest TEXT);
CREATE TABLE rows (
  cell INTEGER, ordinal INTEGER, {", ".join(f'"{name}"' for name in ROW_FIELDS)},
  PRIMARY KEY (cell, ordinal)) WITHOUT ROWID;
"""
BESIDE = ("results.csv", "manifest.json", "timing.json", "artifacts/*")
"""Files of a run beside its store."""


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn errors of SQLite, and damaged contents, into one sentence."""
    try:
        yield
    except sqlite3.OperationalError as error:
        if "no such table" in str(error) or "no such column" in str(error):
            msg = f"{path} is not the store of a run: {error}"
        else:
            msg = f"cannot use {path}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None
    except (sqlite3.Error, DamagedError, UnicodeDecodeError) as error:
        msg = (
            f"{path} is damaged or not the store of a run: {error}; restore it from a "
            "copy, or run the suite again in a new folder"
        )
        raise InputError(msg) from None


@contextmanager
def opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the store of a run to read, as one consistent snapshot.

    Raises
    ------
    InputError
        If there is no such file, it is no store, of another version, or damaged.
    """
    if not path.is_file():
        msg = (
            f"{path} does not exist, so {path.parent} is no run folder; give one that "
            "`simval sweep` made"
        )
        raise InputError(msg)
    with explained(path), closing(_connected(path)) as database:
        database.execute("PRAGMA query_only = 1")
        database.execute("BEGIN")
        given = entry(database, "schema")
        if given != str(SCHEMA_VERSION):
            msg = (
                f"{path} has schema {given!s:.20}; this program reads {SCHEMA_VERSION};"
                " use the version of simval that wrote it"
            )
            raise InputError(msg)
        found = database.execute("PRAGMA quick_check(1)").fetchone()[0]
        _require(found == "ok", f"its pages do not fit together ({found!s:.200})")
        same = entry(database, "digest") == _digest_of_entries(database)
        _require(same, "what it says of the run is not what the sweep stored (SHA-256)")
        yield database


@contextmanager
def writing(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the store of a run to add results."""
    with opened(path):
        pass  # it is one
    with explained(path), closing(_connected(path)) as database:
        database.execute("PRAGMA journal_mode = WAL")  # readers do not wait
        database.execute("PRAGMA synchronous = NORMAL")
        yield database
        with suppress(sqlite3.OperationalError):  # somebody reads: the log stays
            database.execute("PRAGMA journal_mode = DELETE")  # one file again


def _connected(path: Path) -> sqlite3.Connection:
    where = f"{path.absolute().as_uri()}?mode=rw"
    return sqlite3.connect(where, uri=True, timeout=PATIENCE)


def create(path: Path, cells: Iterable[Cell], manifest: Mapping[str, Any]) -> None:
    """Make a new store with every cell pending."""
    pending = (cell_entry(i, cell, "pending") for i, cell in enumerate(cells))
    with explained(path), closing(sqlite3.connect(path)) as database, database:
        database.executescript(TABLES)
        keep(database, schema=str(SCHEMA_VERSION), manifest=json.dumps(manifest))
        marks = ", ".join("?" * (1 + len(CELL_FIELDS)))
        database.executemany(
            f"INSERT INTO cells VALUES ({marks})",
            ((*each, digest_of_entries(each, ())) for each in pending),
        )


def finish(database: sqlite3.Connection, batch: Sequence[Done]) -> None:
    """Store finished cells with their rows, in one transaction."""
    machines = Counter(
        done.machine for done in batch if done.machine and not done.failed
    )
    marks = ", ".join("?" * (2 + len(ROW_FIELDS)))
    with database:
        database.executemany(
            f"INSERT INTO rows VALUES ({marks})",
            chain.from_iterable(done.rows for done in batch),
        )
        database.executemany(
            "UPDATE cells SET status = ?, error = ?, seconds = ?, times = ?, "
            "digest = ? WHERE position = ?",
            ((*done.cell[5:], done.digest, done.cell[0]) for done in batch),
        )
        machines.update(json.loads(entry(database, "machines") or "{}"))
        keep(database, machines=json.dumps(machines))


def keep_manifest(database: sqlite3.Connection, content: Mapping[str, Any]) -> None:
    """Replace the manifest, in one transaction."""
    with database:
        keep(database, manifest=json.dumps(content))


def complete(database: sqlite3.Connection, folder: Path) -> None:
    """Mark the run as complete, with digests of its files and cells."""
    with database:
        files = json.dumps(_digests_of_files(folder))
        keep(database, files=files, complete=_digest_of_cells(database))


def reopen(database: sqlite3.Connection) -> None:
    """Remove the mark of completion, before files are written again."""
    with database:
        keep(database, files=None, complete=None)


def keep(database: sqlite3.Connection, **entries: str | None) -> None:
    """Set or remove entries of the store, and renew its digest."""
    for key, value in entries.items():
        database.execute("DELETE FROM meta WHERE key = ?", (key,))
        if value is not None:
            database.execute("INSERT INTO meta VALUES (?, ?)", (key, value))
    values = ("digest", _digest_of_entries(database))
    database.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", values)


def _digest_of_entries(database: sqlite3.Connection) -> str:
    query = "SELECT key, value FROM meta WHERE key != 'digest' ORDER BY key"
    return digest_of(database.execute(query).fetchall())


def _digest_of_cells(database: sqlite3.Connection) -> str:
    query = "SELECT digest FROM cells ORDER BY position"
    return digest_of(database.execute(query).fetchall())


def _digests_of_files(folder: Path) -> dict[str, str]:
    files = sorted(chain.from_iterable(map(folder.glob, BESIDE)))
    return {
        file.relative_to(folder).as_posix(): _digest_of_file(file)
        for file in files
        if file.suffix != ".part"
    }


def _digest_of_file(file: Path) -> str:
    try:
        with file.open("rb") as content:
            return hashlib.file_digest(content, "sha256").hexdigest()
    except OSError as error:
        msg = f"cannot read {file}: {error.strerror}; is it a file, and yours to read?"
        raise InputError(msg) from None


def read_cells(
    database: sqlite3.Connection, order: Literal["position", "cell"] = "position"
) -> Iterator[CellResult]:
    """Read the cells one by one, each checked by its digest.

    In the order of the suite (``position``), or by their names (``cell``).

    Raises
    ------
    DamagedError
        With the cell that is not what the sweep stored.
    """
    query = f"SELECT {', '.join(CELL_FIELDS)}, digest FROM cells ORDER BY {order}"
    columns = ", ".join(f'"{name}"' for name in ("cell", "ordinal", *ROW_FIELDS))
    of_cell = f"SELECT {columns} FROM rows WHERE cell = ? ORDER BY ordinal"
    size = 0
    for *cell, digest in database.execute(query):
        rows = database.execute(of_cell, (cell[0],)).fetchall()
        size += len(rows)
        same = digest == digest_of_entries(cell, rows)
        _require(same, f"cell {cell[1]!s:.300} is not what the sweep stored (SHA-256)")
        yield cell_result(cell, rows)
    found = database.execute("SELECT count(*) FROM rows").fetchone()[0]
    _require(size == found, f"it has {found - size} rows of no cell")


def check_complete(database: sqlite3.Connection, folder: Path) -> None:
    """Refuse a complete run of which a part is not as it was written.

    A missing file is no damage: a store alone can be judged.
    """
    stated = entry(database, "complete")
    if stated is None:
        return
    same = stated == _digest_of_cells(database)
    _require(same, "its cells are not those that the sweep stored (SHA-256)")
    known = json.loads(entry(database, "files"))
    for name, digest in _digests_of_files(folder).items():
        if known.get(name) != digest:
            msg = (
                f"{folder / name} has changed since the sweep wrote it (its SHA-256 "
                "differs); restore it from a copy, remove it, or write it again "
                "with `simval sweep ... --resume`"
            )
            raise InputError(msg)


def entry(database: sqlite3.Connection, key: str) -> Any:
    """Read an entry of the store."""
    value = database.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
    return value[0] if value else None


class _Grid(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow")
    seed: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1)]
    __pydantic_extra__: dict[str, dict[str, Any]]


class _Manifest(BaseModel):
    """Fields that every manifest has; there may be more."""

    model_config = ConfigDict(strict=True, extra="allow")
    suite: str
    title: str
    grid: _Grid
    cells: Annotated[int, Field(ge=0)]
    versions: dict[str, str]
    git: dict[str, str | bool | None]
    models: dict[str, str]
    machine: dict[str, Any]
    source: str
    files: dict[str, str]
    environments: list[dict[str, Any]] = Field(default_factory=list)  # at the end
    question: str = ""
    need: list[Need] = Field(default_factory=list)


def manifest(database: sqlite3.Connection) -> dict[str, Any]:
    """Read the manifest, which says what the numbers depend on."""
    try:
        content = json.loads(entry(database, "manifest"))
        _Manifest.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        msg = f"`{key}` of its manifest is {first['input']!r:.60}: {first['msg']}"
        raise DamagedError(msg) from None
    except (ValueError, TypeError) as error:
        msg = f"its manifest cannot be read ({error})"
        raise DamagedError(msg) from None
    return content


def parameters(database: sqlite3.Connection) -> list[str]:
    """Names of the parameters of the finished cells, sorted."""
    query = "SELECT DISTINCT parameters FROM cells WHERE status = 'done'"
    found = (json.loads(each[0]) for each in database.execute(query))
    return sorted(set(chain.from_iterable(found)))


def unfinished(database: sqlite3.Connection) -> list[int]:
    """List the cells without a result."""
    query = "SELECT position FROM cells WHERE status != 'done' ORDER BY position"
    return [each[0] for each in database.execute(query)]


def count(
    database: sqlite3.Connection, status: str | None = None, error: str = ""
) -> int:
    """Number of cells, with a status and the start of an error if given."""
    query = (
        "SELECT count(*) FROM cells WHERE (? IS NULL OR status = ?) "
        "AND substr(error, 1, ?) = ?"
    )
    values = (status, status, len(error), error)
    return int(database.execute(query, values).fetchone()[0])


def failures(database: sqlite3.Connection, most: int) -> list[tuple[str, str]]:
    """List the first few cells that failed, with their errors."""
    query = (
        "SELECT cell, error FROM cells WHERE status = 'failed' ORDER BY position "
        "LIMIT ?"
    )
    return database.execute(query, (most,)).fetchall()


def times(database: sqlite3.Connection) -> list[tuple[str, float, dict[str, Any]]]:
    """Name, CPU time and timed call of each cell."""
    query = "SELECT cell, seconds, times FROM cells ORDER BY position"
    return [
        (name, seconds, json.loads(timed or "{}"))
        for name, seconds, timed in database.execute(query)
    ]


def names(database: sqlite3.Connection) -> Iterator[str]:
    """Read the names of the cells."""
    query = "SELECT cell FROM cells ORDER BY position"
    return (each[0] for each in database.execute(query))


def _require(sound: bool, words: str) -> None:
    if not sound:
        raise DamagedError(words)
