"""The table of a large run: Parquet, a folder for each study, in the suite's order.

results/study=NAME/part-00000.parquet: a column for each parameter of the study and for
each of results.csv, which stays for people; beside them the fields of the statistic. A
row group has whole cells. Any reader of partitioned Parquet takes the folder as one
table, and reads only the columns and the row groups that it asks for.
"""

import json
import shutil
import sqlite3
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from simval.columns import CHECKS, Columns
from simval.errors import InputError
from simval.results import CellName
from simval.statistics import FAMILIES, Statistic
from simval.sweep.cells import CellResult, read_cells, read_heads
from simval.sweep.tidy import HEAD, NUMBERS, parameter_kinds, parameter_values

FOLDER = "results"

GROUP = 50_000
"""Rows at which a row group is full: 50 MB while it is written, 5 MB read."""

PART = 10_000_000
"""Rows at which a file is full: some 300 MB on the disk."""

FIELDS = {"family": "string", "entries": "string", "controlled": "bool_"}
"""Columns that say what a row measures, beside its name."""

NEEDED = ("value", "standard_error", "n", "prediction", "remainder")


def has_pyarrow() -> bool:
    """Whether Parquet can be read and written: pyarrow is installed."""
    try:
        import pyarrow.dataset
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        return False
    return True


def write_parquet(database: sqlite3.Connection, folder: Path) -> None:
    """Write the table of the finished cells; it appears only when it is complete."""
    part = folder.with_name(folder.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
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
        shutil.rmtree(folder, ignore_errors=True)
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


def parquet_blocks(folder: Path, *, judged: bool) -> Iterator[Columns]:
    """Read the table in blocks of whole cells; `judged` leaves out what is not."""
    from pyarrow import dataset

    table = dataset.dataset(folder, partitioning="hive", format="parquet")
    kept = (dataset.field("check") != "record") if judged else None
    words = ("cell", "family", "entries", "controlled", "unit", "predictor", "check")
    for file in sorted(table.get_fragments(), key=lambda part: str(part.path)):
        study = Path(file.path).parent.name.partition("=")[2]
        for group in file.split_by_row_group(kept, schema=table.schema):
            columns = group.to_table(
                table.schema,
                columns=[*words, *NEEDED],
                filter=kept,
                use_threads=False,
                batch_size=2 * GROUP,
            )
            yield _block(study, columns)


def _block(study: str, table: Any) -> Columns:
    names, cell = _coded(table["cell"])
    predictors, predictor = _coded(table["predictor"])
    checks, check = _coded(table["check"])
    statistics, statistic = _statistics(table)
    numbers = {
        name: table[name].to_numpy(zero_copy_only=False).astype(float)
        for name in NEEDED
        if name != "n"
    }
    places = np.array([CHECKS.index(word) for word in checks], dtype=np.int64)
    return Columns(
        cells=[CellName(study, name) for name in names],
        statistics=statistics,
        predictors=predictors,
        cell=cell,
        statistic=statistic,
        predictor=predictor,
        check=places[check],
        n=table["n"].to_numpy(zero_copy_only=False).astype(np.int64),
        **numbers,
    )


def _coded(column: Any) -> tuple[list[Any], np.ndarray[Any, np.dtype[np.int64]]]:
    """The different values of a column, and the place of each among them."""
    encoded = column.combine_chunks().dictionary_encode()
    if hasattr(encoded, "combine_chunks"):
        encoded = encoded.combine_chunks()
    codes = encoded.indices.to_numpy(zero_copy_only=False).astype(np.int64)
    return encoded.dictionary.to_pylist(), codes


def _statistics(
    table: Any,
) -> tuple[list[Statistic], np.ndarray[Any, np.dtype[np.int64]]]:
    fields = [
        _coded(table[name]) for name in ("family", "entries", "controlled", "unit")
    ]
    code = np.zeros(len(table), dtype=np.int64)
    for words, places in fields:
        code = code * max(len(words), 1) + places
    _, first, statistic = np.unique(code, return_index=True, return_inverse=True)
    found = []
    for i in first.tolist():
        family, entries, controlled, unit = (words[at[i]] for words, at in fields)
        found.append(
            Statistic(FAMILIES[family], tuple(json.loads(entries)), controlled, unit)
        )
    return found, statistic.astype(np.int64)
