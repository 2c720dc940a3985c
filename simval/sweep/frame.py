"""The tidy table as a data frame of pandas, which is optional."""

from collections.abc import Sequence
from typing import Any

from simval.sweep.cells import CellResult
from simval.sweep.tidy import HEAD, NUMBERS, lines, parameter_kinds

WHOLE = {"int64": "Int64", "bool_": "boolean"}
"""Types of pandas with a place for what a study does not have."""


def data_frame(cells: Sequence[CellResult]) -> Any:
    """Make a data frame of the finished cells."""
    try:
        import pandas as pd
    except ImportError:
        from simval.extras import refuse_without

        refuse_without("pandas", "a data frame")
    done = [cell for cell in cells if cell.status == "done"]
    kinds = parameter_kinds(done)
    rows = list(lines(done, kinds))
    columns = {}
    for name, kind in (HEAD | kinds | NUMBERS).items():
        values = [row[name] for row in rows]
        missing = any(value is None for value in values)
        columns[name] = pd.Series(values, dtype=_dtype(kind, missing))
    return pd.DataFrame(columns)


def _dtype(kind: str, missing: bool) -> str:
    if kind == "string":
        return "object"
    if missing and kind in WHOLE:
        return WHOLE[kind]
    return kind.removesuffix("_")
