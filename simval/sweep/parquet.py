"""The table of a large run: Parquet, a folder for each study, in the suite's order.

results/study=NAME/part-00000.parquet: a column for each parameter of the study and for
each of results.csv, which stays for people; beside them the fields of the statistic. A
row group has whole cells. Any reader of partitioned Parquet takes the folder as one
table, and reads only the columns and the row groups that it asks for.
"""

import json
import sqlite3
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from simval.errors import InputError
from simval.sweep.cells import CellResult, read_cells, read_heads
from simval.sweep.parts import taken_away
from simval.sweep.tidy import HEAD, NUMBERS, parameter_kinds, parameter_values

FOLDER = "results"

GROUP = 50_000
"""Rows at which a row group is full: 50 MB while it is written, 5 MB read."""

PART = 10_000_000
"""Rows at which a file is full: some 300 MB on the disk."""

FIELDS = {"family": "string", "entries": "string", "controlled": "bool_"}
"""Columns that say what a row measures, beside its name."""


def has_pyarrow() -> bool:
    """Whether Parquet can be read and written: pyarrow is installed."""
    try:
        import pyarrow.compute
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        return False
    return True


def write_parquet(database: sqlite3.Connection, folder: Path) -> None:
    """Write the table of the finished cells; it appears only when it is complete."""
    part = folder.with_name(folder.name + ".part")
    taken_away(part)
    tables: dict[str, _Study] = {}
    try:
        for cell in read_cells(database):
            if cell.status == "done":
                if cell.study not in tables:
                    kinds = parameter_kinds(_of(database, cell.study))
                    tables[cell.study] = _Study(part / f"study={cell.study}", kinds)
                tables[cell.study].add(cell)
        for table in tables.values():
            table.close()
        taken_away(folder)
        part.rename(folder)
    except OSError as error:
        msg = f"cannot write {folder}: {error}; is the disk full or read-only?"
        raise InputError(msg) from None


def _of(database: sqlite3.Connection, study: str) -> Iterator[CellResult]:
    return (c for c in read_heads(database) if c.study == study and c.status == "done")


class _Study:
    """The table of one study while it is written."""

    def __init__(self, folder: Path, kinds: Mapping[str, str]) -> None:
        import pyarrow as pa

        head = {name: kind for name, kind in HEAD.items() if name != "study"}
        columns = head | dict(kinds) | FIELDS | NUMBERS
        self._schema = pa.schema([(n, getattr(pa, k)()) for n, k in columns.items()])
        self._folder, self._kinds = folder, kinds
        self._columns: dict[str, list[object]] = {name: [] for name in columns}
        self._measured = [self._columns[name] for name in (*FIELDS, *NUMBERS)]
        self._writer: Any = None
        self._parts = self._written = 0
        folder.mkdir(parents=True)

    def add(self, cell: CellResult) -> None:
        """Add the rows of a cell."""
        fixed = parameter_values(cell, self._kinds)
        for name, value in {"cell": cell.name, "seed": cell.seed, **fixed}.items():
            self._columns[name] += [value] * len(cell.rows)
        for row in cell.rows:
            what = row.statistic
            values = (
                *(what.family.name, _spelled(what.entries), what.controlled),
                *(str(what), row.predictor, row.value, row.standard_error, row.n),
                *(row.prediction, row.remainder, what.unit, row.check),
            )
            for column, each in zip(self._measured, values, strict=True):
                column.append(each)
        if len(self._columns["cell"]) >= GROUP:
            self._flush()

    def close(self) -> None:
        """Write what is left."""
        self._flush()
        if self._writer is not None:
            self._writer.close()

    def _flush(self) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        count = len(self._columns["cell"])
        if not count:
            return
        if self._writer is None:
            file = self._folder / f"part-{self._parts:05}.parquet"
            self._writer = parquet.ParquetWriter(file, self._schema, compression="zstd")
        arrays = [
            pa.array(self._columns[field.name], field.type, from_pandas=True)
            for field in self._schema
        ]
        for column in self._columns.values():
            column.clear()
        table = pa.Table.from_arrays(arrays, schema=self._schema)
        self._writer.write_table(table, row_group_size=count)
        self._written += count
        if self._written >= PART:
            self._writer.close()
            self._writer, self._written, self._parts = None, 0, self._parts + 1


@lru_cache(maxsize=4096)
def _spelled(entries: tuple[str, ...]) -> str:
    return json.dumps(entries, separators=(",", ":"))
