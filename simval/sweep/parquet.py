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

import numpy as np

from simval.columns import CHECKS, Columns
from simval.errors import InputError
from simval.results import CellName
from simval.statistics import Statistic
from simval.sweep.cells import CellResult, read_cells, read_heads
from simval.sweep.documents import DamagedError
from simval.sweep.inside import MEBIBYTE
from simval.sweep.parts import taken_away
from simval.sweep.plausible import MAX_SAMPLES, statistic_of
from simval.sweep.tidy import HEAD, NUMBERS, parameter_kinds, parameter_values
from simval.text import one_line

FOLDER = "results"

GROUP = 50_000
"""Rows at which a row group is full: 50 MB while it is written, 5 MB read."""

PART = 10_000_000
"""Rows at which a file is full: some 300 MB on the disk."""

MOST_ROWS = 20 * GROUP
"""Rows of a row group: it is full at `GROUP`, and the last cell is written whole."""
MOST_BYTES = 256 * MEBIBYTE
"""Bytes of a row group, unpacked."""

FIELDS = {"family": "string", "entries": "string", "controlled": "bool_"}
"""Columns that say what a row measures, beside its name."""

WORDS = ("cell", "family", "entries", "controlled", "unit", "predictor", "check")
NEEDED = ("value", "standard_error", "n", "prediction", "remainder")


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


def parquet_blocks(folder: Path, *, judged: bool, rows: int) -> Iterator[Columns]:
    """Read the table in blocks of whole cells; `judged` leaves out what is not.

    `rows` are as many as it must have.

    Raises
    ------
    InputError
        If it is damaged, or a part of it is larger than any that a sweep writes.
    """
    import pyarrow as pa

    # what pyarrow raises for a file that is damaged, and what its content may cause
    unreadable = (pa.ArrowException, OSError, ValueError, KeyError, TypeError)
    try:
        yield from _blocks(folder, judged, rows)
    except DamagedError as error:
        msg = f"{folder} is damaged: {error}; restore it from a copy"
        raise InputError(msg) from None
    except unreadable as error:
        msg = (
            f"{folder} cannot be read ({one_line(str(error))}); restore it from a copy"
        )
        raise InputError(msg) from None


def _blocks(folder: Path, judged: bool, rows: int) -> Iterator[Columns]:
    from pyarrow import compute

    parts = [_Part(file) for file in sorted(folder.rglob("*.parquet"), key=str)]
    found = sum(part.rows for part in parts)
    if found != rows:
        msg = f"it has {found:,} rows, and the store has {rows:,}"
        raise DamagedError(msg)
    for part in parts:
        for table in part.groups():
            kept = compute.not_equal(table["check"], "record") if judged else None
            yield _block(part.study, table if kept is None else table.filter(kept))


class _Part:
    """A file of the table, which need not be one.

    It is read by row groups: the dataset of pyarrow ends the process on some damage.
    """

    def __init__(self, file: Path) -> None:
        from pyarrow import parquet

        self.study = file.parent.name.partition("=")[2]
        self._file = parquet.ParquetFile(file, pre_buffer=False)
        self._require_types()

    @property
    def rows(self) -> int:
        """Number of its rows, as it says."""
        return int(self._file.metadata.num_rows)

    def groups(self) -> Iterator[Any]:
        """Tables of its row groups."""
        for place in range(self._file.metadata.num_row_groups):
            self._require_small(self._file.metadata.row_group(place))
            columns = [*WORDS, *NEEDED]
            table = self._file.read_row_group(place, columns, use_threads=False)
            for name in (*WORDS, "n"):
                if table[name].null_count:
                    msg = f"the column `{name}` has empty places"
                    raise DamagedError(msg)
            yield table

    def _require_types(self) -> None:
        import pyarrow as pa

        schema = self._file.schema_arrow
        for name in (*WORDS, *NEEDED):
            found = [
                str(schema.field(i).type) for i in schema.get_all_field_indices(name)
            ]
            kind = (HEAD | FIELDS | NUMBERS)[name]
            if found != [str(getattr(pa, kind)())]:
                msg = (
                    f"the column `{name}` is {' and '.join(found) or 'not there'}; it "
                    f"must be there once, {kind.rstrip('_')}"
                )
                raise DamagedError(msg)

    @staticmethod
    def _require_small(group: Any) -> None:
        if group.num_rows > MOST_ROWS or group.total_byte_size > MOST_BYTES:
            msg = (
                f"a row group has {group.num_rows:,} rows in {group.total_byte_size:,} "
                f"bytes; one of a sweep has at most {MOST_ROWS:,} in {MOST_BYTES:,}"
            )
            raise DamagedError(msg)


def _require_possible(block: Columns) -> None:
    """Refuse numbers that cannot be what they are: see `simval.sweep.plausible`."""
    families = [statistic.family for statistic in block.statistics]
    least = np.array([family.least for family in families])[block.statistic]
    most = np.array([family.most for family in families])[block.statistic]
    fields = {
        "value": (block.value < least) | (block.value > most),
        "prediction": (block.prediction < least) | (block.prediction > most),
        "standard_error": block.standard_error < 0.0,
        "remainder": block.remainder < 0.0,
        "n": (block.n < 0) | (block.n >= MAX_SAMPLES),
    }
    for name, wrong in fields.items():
        if wrong.any():
            i = int(np.argmax(wrong))
            given = getattr(block, name)[i]
            msg = f"cell {block.named(i).name!s:.300}: `{name}` is {given!r}"
            raise DamagedError(msg)


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
    if unknown := [word for word in checks if word not in CHECKS]:
        msg = f"`check` is {unknown[0]!r:.60}; it must be one of {', '.join(CHECKS)}"
        raise DamagedError(msg)
    places = np.array([CHECKS.index(word) for word in checks], dtype=np.int64)
    block = Columns(
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
    if len(block):
        _require_possible(block)
    return block


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
        found.append(statistic_of(family, entries, int(controlled), unit))
    return found, statistic.astype(np.int64)
