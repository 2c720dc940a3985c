"""The table of a large run, read: a table that need not be one.

It is read by row groups: the dataset of pyarrow ends the process on some damage. Text
is read as it is kept, each different one once, so a long text that stands in every row
takes no more room than in the file.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from simval.columns import CHECKS, Columns
from simval.errors import InputError
from simval.results import CellName
from simval.statistics import Statistic
from simval.sweep.documents import DamagedError
from simval.sweep.inside import MEBIBYTE
from simval.sweep.parquet import FIELDS, GROUP
from simval.sweep.plausible import MAX_SAMPLES, statistic_of
from simval.sweep.tidy import HEAD, NUMBERS
from simval.text import one_line

MOST_ROWS = 20 * GROUP
"""Rows of a row group: it is full at `GROUP`, and the last cell is written whole."""
MOST_BYTES = 256 * MEBIBYTE
"""Bytes of a row group, unpacked."""

TEXTS = ("cell", "family", "entries", "unit", "predictor", "check")
MEASURED = ("value", "standard_error", "prediction", "remainder")
NEEDED = (*TEXTS, "controlled", "n", *MEASURED)
FULL = (*TEXTS, "controlled", "n")
"""Columns without an empty place."""


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
    from pyarrow import compute, parquet

    files = sorted(folder.rglob("*.parquet"), key=str)
    found = sum(parquet.read_metadata(file).num_rows for file in files)
    if found != rows:
        msg = f"it has {found:,} rows, and the store has {rows:,}"
        raise DamagedError(msg)
    for file in files:
        study = file.parent.name.partition("=")[2]
        for table in _groups(file):
            kept = compute.not_equal(table["check"], "record") if judged else None
            yield _block(study, table if kept is None else table.filter(kept))


def _groups(file: Path) -> Iterator[Any]:
    """Tables of the row groups of a file."""
    from pyarrow import parquet

    texts = list(TEXTS)
    with parquet.ParquetFile(file, pre_buffer=False, read_dictionary=texts) as part:
        _require_types(part.schema_arrow)
        for place in range(part.metadata.num_row_groups):
            _require_small(part.metadata.row_group(place))
            table = part.read_row_group(place, list(NEEDED), use_threads=False)
            table.validate(full=True)  # places in a dictionary are not checked before
            for name in FULL:
                if table[name].null_count:
                    msg = f"the column `{name}` has empty places"
                    raise DamagedError(msg)
            yield table


def _require_types(schema: Any) -> None:
    import pyarrow as pa

    for name in NEEDED:
        found = [str(schema.field(i).type) for i in schema.get_all_field_indices(name)]
        kind = getattr(pa, (HEAD | FIELDS | NUMBERS)[name])()
        wanted = str(pa.dictionary(pa.int32(), kind) if name in TEXTS else kind)
        if found != [wanted]:
            msg = (
                f"the column `{name}` is {' and '.join(found) or 'not there'}; it must "
                f"be there once, {kind}"
            )
            raise DamagedError(msg)


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
        for name in MEASURED
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
    """The different values of a column as they come, and the place of each."""
    if not hasattr(column.type, "value_type"):
        column = column.dictionary_encode()
    whole = column.unify_dictionaries().combine_chunks()
    if hasattr(whole, "chunks"):
        whole = whole.combine_chunks()
    values = whole.dictionary.to_pylist()
    places = whole.indices.to_numpy(zero_copy_only=False)
    used, first, codes = np.unique(places, return_index=True, return_inverse=True)
    order = np.argsort(first)  # those that a filter has left, in the order of the rows
    rank = np.argsort(order)
    return [values[place] for place in used[order]], rank[codes].astype(np.int64)


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
