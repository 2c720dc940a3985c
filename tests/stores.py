"""Stores of runs, changed on purpose: as another sweep would have left them, or not."""

import sqlite3
from contextlib import closing, contextmanager

from simval.sweep import load_run, store


@contextmanager
def raw(folder):
    """The store of a run as it lies on the disk: what is changed here is damage."""
    path = folder / "run.sqlite"
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("PRAGMA ignore_check_constraints = 1")
        yield database


@contextmanager
def rewritten(folder):
    """The store of a run, signed anew: as a sweep with these results would leave it."""
    with raw(folder) as database:
        yield database
        _as_swept(database)
        _sign(database)


def _as_swept(database):
    """Only a finished cell has rows, and they are numbered from 0."""
    database.execute(
        "DELETE FROM rows WHERE cell IN "
        "(SELECT position FROM cells WHERE status != 'done')"
    )
    rows = database.execute("SELECT rowid, cell FROM rows ORDER BY cell, ordinal")
    places, last = [], (None, -1)
    for rowid, cell in rows.fetchall():
        last = (cell, last[1] + 1 if cell == last[0] else 0)
        places.append((last[1], rowid))
    # by way of negative ones, so that no two are alike in between
    database.executemany("UPDATE rows SET ordinal = -1 - ? WHERE rowid = ?", places)
    database.execute("UPDATE rows SET ordinal = -1 - ordinal")


def edited(folder, *statements):
    """Change the store of a run to what another sweep would have left."""
    with rewritten(folder) as database:
        for sql in statements:
            database.execute(sql)


def edited_run(folder, *statements):
    """Change the store of a run and load it."""
    edited(folder, *statements)
    return load_run(folder)


def signed_anew(folder):
    """Give a damaged store the digests of what it holds now, and none of its files."""
    with raw(folder) as database:
        _sign(database)


def _sign(database):
    (text,) = database.execute(
        "SELECT value FROM meta WHERE key = 'manifest'"
    ).fetchone()
    database.execute("DELETE FROM meta WHERE key IN ('manifest digest', 'files')")
    database.execute(
        "INSERT INTO meta VALUES ('manifest digest', ?)", (store.digest_of(text),)
    )
    for (position,) in database.execute("SELECT position FROM cells").fetchall():
        digest = store.digest_of_cell(*store.stored_cell(database, position))
        query = "UPDATE cells SET digest = ? WHERE position = ?"
        database.execute(query, (digest, position))
