"""A table as data, for the page and for CSV."""

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal

from simval.report.formatting import slug
from simval.results import Row
from simval.spelling import measured
from simval.text import number

Kind = Literal[
    "text", "unit", "code", "command", "number", "measured", "quantity", "answer",
    "figure",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Column:
    """A column."""

    title: str  # heading, with the unit where all its values have the same
    # ``text``; ``unit``, which a ratio has none of on the page; ``code``, a name;
    # ``command``, shown on request; ``number``;
    # ``measured``, a pair of value and standard error; or of both the row that has
    # them; ``quantity``, a pair of its words and a number; ``answer``, a verdict;
    # ``figure``, the name of a figure on the page
    kind: Kind = "text"
    digits: int = 6  # significant digits of a number, and of one without an error
    choice: bool = False  # whether the page lets its rows be chosen by it
    # the heading on the page, and the factor of its numbers, where a person reads
    # another unit than a file has
    shown: str = ""
    factor: float = 1.0

    @property
    def heading(self) -> str:
        """Heading on the page."""
        return self.shown or self.title

    @property
    def numeric(self) -> bool:
        """True if its values are numbers."""
        return self.kind in ("number", "measured", "quantity")


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table: columns and rows."""

    name: str  # unique on the page; its file name; a slug
    caption: str  # what it holds
    columns: Sequence[Column]  # from left to right
    rows: Sequence[Sequence[Any]]  # values, one for each column; None is an empty cell
    # Rows that the page shows; the files hold all. None shows all.
    shown: int | None = None
    fold: str = ""  # words of the fold that it is behind; empty shows it at once

    def __post_init__(self) -> None:
        assert self.name == slug(self.name), self.name

    @property
    def filled(self) -> Sequence[int]:
        """Indices of the columns that have a value in some row."""
        if not self.rows:
            return range(len(self.columns))
        return [
            i
            for i in range(len(self.columns))
            if any(text(row[i], self.columns[i]) for row in self.rows)
        ]

    @property
    def visible(self) -> Sequence[Sequence[Any]]:
        """The rows that the page shows."""
        return self.rows[: self.shown]


def tabulated(
    items: Iterable[Any], fields: Mapping[Column, Callable[[Any], Any]], **words: Any
) -> Table:
    """Make a table with a row for each item and a column for each field."""
    rows = [tuple(of(item) for of in fields.values()) for item in items]
    return Table(columns=tuple(fields), rows=rows, **words)


NUMBERS = (
    Column("statistic"),
    Column("value", "measured"),
    Column("unit", "unit"),
    Column("n", "number", 12),
    Column("prediction", "number"),
    Column("by"),
)
"""Columns of a table of rows."""


def numbers_of(row: Row) -> tuple[Any, ...]:
    """Entries of a row for the columns `NUMBERS`."""
    words = (str(row.statistic), row, row.unit)
    return (*words, row.n, row.prediction, row.predictor)


def text(value: Any, column: Column) -> str:
    """Spell a cell for people."""
    if value is None:
        return ""
    value = _plain(value, column, shown=True)
    if column.kind == "measured":
        found, error = (column.factor * part for part in value)
        return measured(found, error) if error else number(found, column.digits)
    if column.kind == "quantity":
        return str(value[0])
    if column.kind == "number":
        return number(column.factor * value, column.digits)
    return "" if column.kind == "unit" and value == "1" else str(value)


def sort_key(value: Any, column: Column) -> str:
    """Number by which the page sorts a column; None sorts last."""
    if value is None or not column.numeric:
        return ""
    value = _plain(value, column)
    of_pair = {"measured": 0, "quantity": 1}
    key = float(value[of_pair[column.kind]] if column.kind in of_pair else value)
    return repr(key) if isfinite(key) else ""


def csv_text(table: Table) -> str:
    """Write all rows as CSV, with exact floats.

    Parameters
    ----------
    table : Table
        The table.

    Returns
    -------
    str
        A measured column becomes two: the value and its standard error.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(
        [
            title
            for column in table.columns
            for title in (
                (column.title, f"standard error of {column.title}")
                if column.kind == "measured"
                else (column.title,)
            )
        ]
    )
    for row in table.rows:
        writer.writerow(
            [
                field
                for value, column in zip(row, table.columns, strict=True)
                for field in _fields(value, column)
            ]
        )
    return buffer.getvalue()


def _plain(value: Any, column: Column, *, shown: bool = False) -> Any:
    """The number in a cell, with its error if it was measured, or another value."""
    if not isinstance(value, Row):
        return value
    found = value.shown if shown else value.value
    return (found, value.standard_error) if column.kind == "measured" else found


def _fields(value: Any, column: Column) -> tuple[Any, ...]:
    value = _plain(value, column)
    if column.kind == "measured":
        return ("", "") if value is None else tuple(repr(float(v)) for v in value)
    if isinstance(value, float):
        return (repr(value),)
    if column.kind in ("text", "code", "command") and str(value).startswith(
        ("=", "+", "-", "@")
    ):
        return (f"'{value}",)  # a spreadsheet must not take it for a formula
    return ("" if value is None else value,)
