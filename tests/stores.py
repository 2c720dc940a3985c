"""Stores of runs, changed on purpose: as another sweep would have left them, or not."""

import hashlib
import sqlite3
from contextlib import closing, contextmanager
from itertools import groupby
from operator import itemgetter

from simval.sweep import load_run, store
from simval.sweep.cells import CELL_FIELDS, digest_of_entries


def digest(folder):
    """Digest of the table of a run."""
    return hashlib.sha256((folder / "results.csv").read_bytes()).hexdigest()


@contextmanager
def raw(folder):
    """The store of a run as it lies on the disk: what is changed here is damage."""
    path = folder / "run.sqlite"
    with closing(sqlite3.connect(path)) as database, database:
        yield database


@contextmanager
def rewritten(folder):
    """The store of a run, signed anew: as a sweep with these results would leave it.

    Only a finished cell has rows, and they are numbered from 0. It is not complete, so
    any file may lie beside it.
    """
    with raw(folder) as database:
        yield database
        names = ", ".join(CELL_FIELDS)
        cells = database.execute(f"SELECT {names} FROM cells").fetchall()
        rows = database.execute("SELECT * FROM rows ORDER BY cell, ordinal").fetchall()
        own = {
            place: [(place, k, *row[2:]) for k, row in enumerate(each)]
            for place, each in groupby(rows, itemgetter(0))
        }
        database.execute("DELETE FROM rows")
        for cell in cells:
            left = own.get(cell[0], []) if cell[5] == "done" else []
            marks = ", ".join("?" * (2 + len(store.ROW_FIELDS)))
            database.executemany(f"INSERT INTO rows VALUES ({marks})", left)
            values = (digest_of_entries(cell, left), cell[0])
            database.execute("UPDATE cells SET digest = ? WHERE position = ?", values)
        store.keep(database, files=None, complete=None)


def edited(folder, *statements):
    """Change the store of a run to what another sweep would have left."""
    with rewritten(folder) as database:
        for sql in statements:
            database.execute(sql)


def edited_run(folder, *statements):
    """Change the store of a run and load it."""
    edited(folder, *statements)
    return load_run(folder)
