"""The tidy table as Parquet, for those who work on many runs."""

from pathlib import Path

from simval.errors import InputError
from simval.sweep import store
from simval.sweep.run import ROW_COLUMNS

CHUNK = 100_000
"""Rows in memory at a time."""

_TYPES = {"value": "float64", "standard_error": "float64", "prediction": "float64"}
_TYPES |= {"remainder": "float64", "n": "int64"}


def export_parquet(folder: Path, path: Path) -> int:
    """Write the table of a run as one Parquet file.

    Parameters
    ----------
    folder : Path
        The run folder.
    path : Path
        File to write.

    Returns
    -------
    int
        Rows written.

    Raises
    ------
    InputError
        If the extra `parquet` is not installed, the folder is no run, or the file
        cannot be written.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        msg = "Parquet needs the extra `parquet`: pip install 'simval[parquet]'"
        raise InputError(msg) from None
    written = 0
    with store.opened(folder / "run.sqlite") as database:
        cells = {c["position"]: c for c in store.cells(database)}
        keys = sorted({key for cell in cells.values() for key in cell["parameters"]})
        kinds = {
            key: _kind(cell["parameters"].get(key) for cell in cells.values())
            for key in keys
        }
        schema = pa.schema(
            [("cell", pa.string()), ("study", pa.string()), ("seed", pa.int64())]
            + [(key, getattr(pa, kinds[key])()) for key in keys]
            + [(n, getattr(pa, _TYPES.get(n, "string"))()) for n in ROW_COLUMNS]
        )
        try:
            with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
                chunk: list[dict[str, object]] = []
                for position, row in store.rows(database):
                    cell = cells[position]
                    head = {
                        "cell": cell["cell"],
                        "study": cell["study"],
                        "seed": cell["seed"],
                    }
                    values = {key: cell["parameters"].get(key) for key in keys}
                    chunk.append(
                        head | values | {n: getattr(row, n) for n in ROW_COLUMNS}
                    )
                    if len(chunk) == CHUNK:
                        writer.write_table(pa.Table.from_pylist(chunk, schema))
                        written, chunk = written + len(chunk), []
                if chunk:
                    writer.write_table(pa.Table.from_pylist(chunk, schema))
        except (OSError, OverflowError, pa.ArrowInvalid) as error:
            msg = f"cannot write {path}: {error}; choose another file with --out"
            raise InputError(msg) from None
    return written + len(chunk)


def _kind(values: object) -> str:
    kinds = {type(v) for v in values if v is not None}  # type: ignore[attr-defined]
    if kinds == {bool}:
        return "bool_"
    if kinds == {int}:
        return "int64"
    return "float64" if kinds <= {int, float} else "string"
