"""The cells of a run that is too large for memory, read from its folder as needed.

They are a sequence like any other. To go through all of them holds one at a time; to go
through their rows as columns (`blocks_of`) holds some thousand rows.
"""

import sqlite3
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import overload
from weakref import finalize

from simval.columns import Columns, columns_of
from simval.results import CellName, Row
from simval.sweep import store
from simval.sweep.cells import (
    CellResult,
    read_cell,
    read_cells,
    read_heads,
    read_heads_by_study,
)
from simval.sweep.connections import explained
from simval.sweep.parquet import FOLDER, has_pyarrow
from simval.sweep.parquet_read import parquet_blocks

KEPT = 100_000
"""Rows that are held in memory: 100 MB. Chosen: the accuracy suite has 6 000."""

BLOCK = 20_000
"""Rows at which a block made of cells is full."""


class StoredCells(Sequence[CellResult]):
    """The cells of a run folder, in the order of the suite."""

    def __init__(self, folder: Path, database: sqlite3.Connection) -> None:
        self._folder, self._database = folder, database
        self._table = sealed_table(database, folder)
        self._count = store.count(database)
        self.rows = store.size(database)
        finalize(self, database.close)

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, place: int) -> CellResult: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[CellResult]: ...
    def __getitem__(self, place: int | slice) -> CellResult | Sequence[CellResult]:
        places = range(self._count)[place]
        with explained(self._folder / "run.sqlite"):
            if isinstance(places, int):
                return read_cell(self._database, places)
            return tuple(read_cell(self._database, each) for each in places)

    def __iter__(self) -> Iterator[CellResult]:
        with explained(self._folder / "run.sqlite"):
            yield from read_cells(self._database)

    def heads(self) -> Iterator[CellResult]:
        """The cells without their rows."""
        with explained(self._folder / "run.sqlite"):
            yield from read_heads(self._database)

    def heads_by_block(self) -> Iterator[CellResult]:
        """The cells without their rows, in the order in which `blocks` has them."""
        if self._table is None:
            yield from self.heads()
            return
        with explained(self._folder / "run.sqlite"):
            yield from read_heads_by_study(self._database)

    def blocks(self, *, judged: bool) -> Iterator[Columns]:
        """The rows of the finished cells; from the table where there is one."""
        if self._table is not None:
            return parquet_blocks(self._table, judged=judged, rows=self.rows)
        return _blocks(self, judged=judged)


def heads_of(cells: Sequence[CellResult]) -> Iterator[CellResult]:
    """The cells of a run, without their rows if those would have to be read."""
    return cells.heads() if isinstance(cells, StoredCells) else iter(cells)


def heads_by_block(cells: Sequence[CellResult]) -> Iterator[CellResult]:
    """The cells of a run in the order in which `blocks_of` has them."""
    return cells.heads_by_block() if isinstance(cells, StoredCells) else iter(cells)


def blocks_of(cells: Sequence[CellResult], *, judged: bool) -> Iterator[Columns]:
    """The rows of the finished cells as columns, a cell's rows in one block.

    `judged` leaves out those that are not.
    """
    if isinstance(cells, StoredCells):
        return cells.blocks(judged=judged)
    return iter([columns_of(chain.from_iterable(_pairs(cells, judged)))])


def _pairs(
    cells: Iterator[CellResult] | Sequence[CellResult], judged: bool
) -> Iterator[list[tuple[CellName, Row]]]:
    for cell in cells:
        if cell.status == "done":
            named = cell.named
            yield [(named, r) for r in cell.rows if not judged or r.check != "record"]


def _blocks(cells: Sequence[CellResult], *, judged: bool) -> Iterator[Columns]:
    block: list[tuple[CellName, Row]] = []
    for pairs in _pairs(cells, judged):
        block += pairs
        if len(block) >= BLOCK:
            yield columns_of(block)
            block = []
    yield columns_of(block)


def sealed_table(database: sqlite3.Connection, folder: Path) -> Path | None:
    """The folder of the Parquet table, if it is there and whole."""
    place = folder / FOLDER
    if place.is_symlink():
        return None
    files = sorted(file for file in place.rglob("*") if not file.is_dir())
    known = store.sealed(database)
    names = [file.relative_to(folder).as_posix() for file in files]
    whole = sorted(name for name in known if name.startswith(f"{FOLDER}/"))
    if not files or names != whole or not has_pyarrow():
        return None  # the store has the same rows
    return place
