"""The tidy table as Parquet, for those who work on many runs."""

from itertools import islice
from pathlib import Path

from simval.errors import InputError
from simval.sweep.cells import read_cells, read_heads
from simval.sweep.parts import completed
from simval.sweep.run import opened_run
from simval.sweep.tidy import HEAD, NUMBERS, lines, parameter_kinds

CHUNK = 100_000
"""Rows in memory at a time."""


def export_parquet(folder: Path, path: Path) -> int:
    """Write the table of a run as one Parquet file."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        from simval.extras import refuse_without

        refuse_without("parquet", "Parquet")
    if path.exists() and not path.is_file():
        # it would be replaced: a device or a pipe would be gone for all who use it
        msg = (
            f"cannot write {path}: it is no regular file, and Parquet is not written "
            "into a pipe; choose another file with --out"
        )
        raise InputError(msg)
    written = 0
    with opened_run(folder) as (database, _):
        kinds = parameter_kinds(read_heads(database))
        schema = pa.schema(
            [
                (name, getattr(pa, kind)())
                for name, kind in (HEAD | kinds | NUMBERS).items()
            ]
        )
        try:
            with (
                completed(path) as file,
                parquet.ParquetWriter(file, schema, compression="zstd") as writer,
            ):
                table = lines(read_cells(database), kinds)
                while chunk := list(islice(table, CHUNK)):
                    writer.write_table(pa.Table.from_pylist(chunk, schema))
                    written += len(chunk)
        except (OSError, OverflowError, pa.ArrowInvalid) as error:
            msg = f"cannot write {path}: {error}; choose another file with --out"
            raise InputError(msg) from None
    return written
