"""The tidy table as Parquet, for those who work on many runs."""

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import Any

from simval.errors import InputError
from simval.results import COLUMNS, Row
from simval.studies.study import canonical
from simval.sweep.cells import read_cells, read_heads
from simval.sweep.run import opened_run

CHUNK = 100_000
"""Rows in memory at a time."""

_KINDS: dict[Any, str] = {float: "float64", float | None: "float64", int: "int64"}
_TYPES = {f.name: _KINDS.get(f.type, "string") for f in fields(Row)}


def export_parquet(folder: Path, path: Path) -> int:
    """Write the table of a run as one Parquet file."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        msg = "Parquet needs the extra `parquet`: pip install 'simval[parquet]'"
        raise InputError(msg) from None
    written = 0
    with opened_run(folder) as (database, _):
        cells = [cell.parameters for cell in read_heads(database)]
        keys = sorted({key for parameters in cells for key in parameters})
        kinds = {key: _kind([c.get(key) for c in cells]) for key in keys}
        schema = pa.schema(
            [("cell", pa.string()), ("study", pa.string()), ("seed", pa.int64())]
            + [(key, getattr(pa, kinds[key])()) for key in keys]
            + [(n, getattr(pa, _TYPES.get(n, "string"))()) for n in COLUMNS]
        )
        part = path.with_name(path.name + ".part")
        try:
            with parquet.ParquetWriter(part, schema, compression="zstd") as writer:
                lines = _lines(database, kinds)
                while chunk := list(islice(lines, CHUNK)):
                    writer.write_table(pa.Table.from_pylist(chunk, schema))
                    written += len(chunk)
            part.replace(path)
        except (OSError, OverflowError, pa.ArrowInvalid) as error:
            msg = f"cannot write {path}: {error}; choose another file with --out"
            raise InputError(msg) from None
        finally:
            part.unlink(missing_ok=True)  # no incomplete table is left
    return written


def _lines(
    database: sqlite3.Connection, kinds: Mapping[str, str]
) -> Iterator[dict[str, object]]:
    """Each row of the table, its parameters in the types of their columns."""
    for cell in read_cells(database):
        head = {"cell": cell.name, "study": cell.study, "seed": cell.seed}
        values = {
            key: _as(kind, cell.parameters.get(key)) for key, kind in kinds.items()
        }
        for row in cell.rows:
            yield head | values | row.tidy


def _kind(values: Sequence[object]) -> str:
    kinds = {type(v) for v in values if v is not None}
    if kinds == {bool}:
        return "bool_"
    if kinds == {int}:
        return "int64"
    return "float64" if kinds <= {int, float} else "string"


def _as(kind: str, value: object) -> object:
    """A parameter in the type of its column: text where studies differ in type."""
    if value is None or isinstance(value, str) or kind != "string":
        return value
    return canonical(value)
