"""Connections to the store of a run: for one who reads, and for the one who writes.

A reader trusts nothing: the file must be a regular one, and its schema exactly that of
a store, so that no view, trigger or virtual table of another hand is ever run. It takes
no lock that a sweep waits for, and keeps no sweep from its end: the write-ahead log is
brought into the file only where nobody else has it open.
"""

import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from os import SEEK_END
from pathlib import Path
from struct import Struct

from simval.errors import InputError
from simval.sweep.documents import DamagedError
from simval.sweep.holders import holders
from simval.sweep.inside import MEBIBYTE, require_alone, require_plain

CHECKPOINT = 8_192
"""Pages of the write-ahead log, 32 MB, after which it is brought into the file: a
checkpoint waits for the disk."""

LONGEST = 64 * MEBIBYTE
"""Bytes of one value of a store; the list of 600 000 files takes as many."""

PATIENCE = 30.0
"""Seconds that a sweep waits for another program that writes to its store."""

READERS = 3.0
"""Seconds that a finished sweep waits for readers, to leave one file alone; a gate
reads a store of the suites in less than one."""

JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
"""What a journal that names another file ends with."""

JOURNAL_HEAD = Struct(">16xI4xI")
"""Head of a journal: pages of the store before it was changed, and bytes of a page."""

LARGEST_PAGE = 65_536
"""Bytes of a page at the most; SQLite takes a 0 in a journal for the store's own."""

BESIDE = ("-wal", "-shm", "-journal")
"""What SQLite may keep beside a store."""

LEFT = ("-wal", "-journal")
"""Without which a store is not what was written."""


def to_read(path: Path, tables: str, version: int) -> sqlite3.Connection:
    """Open a store that need not be one; nothing can be written through it.

    What a sweep has left beside it that was killed, SQLite brings into it first.

    Raises
    ------
    InputError
        If there is no such file, it or what SQLite keeps beside it is no regular file,
        or it is not exactly a store of this version.
    """
    if not path.exists():
        msg = f"{path} does not exist, so {path.parent} is no run folder"
        raise InputError(msg)
    for suffix in ("", *BESIDE):
        require_plain(Path(f"{path}{suffix}"))
    for suffix in BESIDE:
        require_alone(Path(f"{path}{suffix}"))
    if any(Path(f"{path}{suffix}").exists() for suffix in LEFT):
        require_alone(path)  # what is left is written to it, whatever it is
    _require_own_journal(path)
    database = _connected(path)
    try:
        for pragma in (
            "query_only = 1",
            "trusted_schema = 0",
            "cell_size_check = 1",
            "ignore_check_constraints = 1",  # each field is checked where it is read
        ):
            database.execute(f"PRAGMA {pragma}")
        _require_store(path, database, tables, version)
    except BaseException:
        database.close()
        raise
    return database


def to_write(path: Path, tables: str, version: int) -> sqlite3.Connection:
    """Open the store of a run to add to it, with a write-ahead log."""
    to_read(path, tables, version).close()  # it is one
    database = sqlite3.connect(path, timeout=PATIENCE)
    try:
        _patiently(database, "PRAGMA journal_mode = WAL", PATIENCE)
        database.execute("PRAGMA synchronous = NORMAL")
        database.execute(f"PRAGMA wal_autocheckpoint = {CHECKPOINT}")
    except BaseException:
        database.close()
        raise
    database.row_factory = sqlite3.Row
    return database


def fold(database: sqlite3.Connection) -> None:
    """Bring the write-ahead log into the file, unless somebody keeps it open.

    All is stored already. Where a reader stays, the log stays beside the file, and goes
    when the last of them closes it.
    """
    with suppress(sqlite3.OperationalError):
        _patiently(database, "PRAGMA journal_mode = DELETE", READERS)
        return
    with suppress(sqlite3.OperationalError):
        database.execute("PRAGMA wal_checkpoint(PASSIVE)")


def kept_open(path: Path) -> str:
    """Words on a log that has stayed beside a store, and for whom; empty if none."""
    if not Path(f"{path}-wal").exists():
        return ""
    return (
        f"{path} is open in {_named(path)}: the run is complete, but a part of its "
        f"store stays in {path.name}-wal until it is closed there; copy both files"
    )


def require_whole(database: sqlite3.Connection) -> None:
    """Refuse a store whose pages are damaged; one that leads in circles never ends."""
    found = str(database.execute("PRAGMA quick_check(1)").fetchone()[0])
    if found != "ok":
        msg = f"its pages do not fit together ({found:.200})"
        raise DamagedError(msg)


@contextmanager
def explained(path: Path) -> Iterator[None]:
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
        elif _is_locked(error):
            msg = (
                f"{path} is locked by {_named(path)}; what was stored is kept: close "
                "it there, and continue with `simval sweep ... --resume`"
            )
        else:
            msg = f"cannot use {path}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None
    except (sqlite3.Error, UnicodeDecodeError) as error:  # what it says may be no text
        msg = f"{path} is not the store of a run, or is damaged: {error}"
        raise InputError(msg) from None


def _connected(path: Path) -> sqlite3.Connection:
    """A connection, on a medium that cannot be written, too."""
    database = sqlite3.connect(path)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
    try:
        database.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    except sqlite3.OperationalError as error:
        database.close()
        asked = any(words in str(error) for words in ("unable to open", "readonly"))
        left = any(Path(f"{path}{suffix}").exists() for suffix in LEFT)
        if not asked or left:
            raise
        # it asks for a log of which there is none, and none can be made
        database = sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
    except BaseException:
        database.close()
        raise
    return database


def _require_own_journal(path: Path) -> None:
    """Refuse a journal that would do more than bring the store back.

    SQLite plays back what a sweep leaves that is killed in a change of mode. It also
    makes the store as long as the journal says, and removes a file that it names.
    """
    journal = Path(f"{path}-journal")
    try:
        content = journal.open("rb")
    except FileNotFoundError:
        return  # as always, or its writer has just ended
    except OSError as error:
        msg = f"cannot read {journal}: {error.strerror}; is it yours to read?"
        raise InputError(msg) from None
    with content:
        length = path.stat().st_size
        head = content.read(JOURNAL_HEAD.size)
        content.seek(max(content.seek(0, SEEK_END) - len(JOURNAL_MAGIC), 0))
        names_a_file = content.read() == JOURNAL_MAGIC
    longer = False
    if len(head) == JOURNAL_HEAD.size:
        pages, page = JOURNAL_HEAD.unpack(head)
        longer = pages * (page or LARGEST_PAGE) > length
    if names_a_file or longer:
        does = "names another file" if names_a_file else "makes the store longer"
        msg = (
            f"{journal} is of no sweep: it {does}; restore the folder from a copy, or "
            "run the suite in a new one"
        )
        raise InputError(msg)


def _require_store(
    path: Path, database: sqlite3.Connection, tables: str, version: int
) -> None:
    """Refuse a schema that is not exactly that of a store."""
    expected, found = _schema(tables), _entries(database)
    _require_as_made("meta", expected, found)
    query = "SELECT value FROM meta WHERE key = 'schema'"
    value = database.execute(query).fetchone()
    if value is None or value[0] != str(version):
        given = "no schema" if value is None else f"schema {value[0]!s:.20}"
        msg = (
            f"{path} has {given}; this program reads {version}; use the version of "
            "simval that wrote it"
        )
        raise InputError(msg)
    for name in {**expected, **found}:
        _require_as_made(name, expected, found)


Schema = dict[str, tuple[str, str, str]]


def _require_as_made(name: str, expected: Schema, found: Schema) -> None:
    if name not in found:
        msg = f"no such table: {name}"
        raise sqlite3.OperationalError(msg)
    if found[name] != expected.get(name):
        other = "other than" if name in expected else "not among"
        msg = f"its {found[name][0]} `{name:.60}` is {other} what a sweep makes"
        raise DamagedError(msg)


@lru_cache
def _schema(tables: str) -> Schema:
    database = sqlite3.connect(":memory:")
    try:
        database.executescript(tables)
        return _entries(database)
    finally:
        database.close()


def _entries(database: sqlite3.Connection) -> Schema:
    query = "SELECT name, type, tbl_name, sql FROM sqlite_schema LIMIT 100"
    entries: Schema = {}
    for name, kind, table, sql in database.execute(query):
        if str(name) in entries:  # a trigger may have the name of a table
            msg = f"it has `{name:.60}` twice, once as a {kind}"
            raise DamagedError(msg)
        entries[str(name)] = (str(kind), str(table), " ".join(str(sql).split()))
    return entries


def _patiently(database: sqlite3.Connection, pragma: str, seconds: float) -> None:
    """Do what nobody else may have the file open for, as soon as nobody has."""
    end = time.monotonic() + seconds
    while True:
        try:
            database.execute(pragma)
            return
        except sqlite3.OperationalError as error:
            if not _is_locked(error) or time.monotonic() >= end:
                raise
        time.sleep(0.05)


def _is_locked(error: sqlite3.Error) -> bool:
    return "locked" in str(error) or "busy" in str(error)


def _named(path: Path) -> str:
    return ", ".join(holders(path)) or "another program, or another machine"
