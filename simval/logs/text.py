"""Rows of numbers in a text file, with the line that each came from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import InputError
from simval.logs.dialect import Dialect, judged
from simval.logs.header import Line, header_names, header_of, is_names
from simval.shapes import Bool, Float

COMMENTS = ("#", "%", "//")
MOST_LINE = 2**20
"""Characters of a row: thirty thousand columns of 32. A file without rows has more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TextTable:
    """Rows of a text file."""

    path: str  # the file
    names: tuple[str, ...] | None  # its header
    dialect: Dialect  # how its fields are written
    lines: list[Line]  # line number, from 1, and text of each row

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.dialect.width

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.lines)

    def numbers(self, places: list[int]) -> Float[Array, "n columns"]:
        """Return the columns at these places.

        Raises
        ------
        InputError
            If a field there is not a number, with its line and column.
        """
        rows = (line for _, line in self.lines)
        if self.dialect.comma:
            rows = (line.replace(",", ".") for line in rows)
        quoted = any('"' in line or "'" in line for _, line in self.lines)
        try:
            if quoted:
                fields = [self.dialect.fields(line) for _, line in self.lines]
                return np.array(
                    [[self._number(row[k]) for k in places] for row in fields]
                )
            mark = self.dialect.mark
            return np.loadtxt(
                rows, delimiter=mark, ndmin=2, comments=None, usecols=places
            )
        except ValueError:
            raise InputError(self._first_bad_field(places)) from None

    def _number(self, field: str) -> float:
        return float(field.replace(",", ".") if self.dialect.comma else field)

    def _first_bad_field(self, places: list[int]) -> str:
        for number, line in self.lines:
            fields = self.dialect.fields(line)
            for place in places:
                if not self.dialect.is_number(fields[place]):
                    return (
                        f"{self.path}, line {number}, column {place + 1}: "
                        f"{fields[place][:40]!r} is not a number; remove the line, or "
                        "leave that column out (--columns, with - for it)"
                    )
        return f"{self.path} cannot be read as rows of numbers; export it again"

    def texts(self, place: int) -> list[str]:
        """Return one column as it is written."""
        return [self.dialect.fields(line)[place] for _, line in self.lines]

    def where(self, row: int) -> str:
        """Say where a row stands in the file."""
        return f"{self.path}, line {self.lines[row][0]}"

    def is_text(self, place: int) -> bool:
        """Return whether the first row has no number there."""
        return not self.dialect.numbers(self.lines[0][1])[place]


def text_table(path: str, text: str) -> TextTable:
    """Find the rows of a text, and the header above them.

    Raises
    ------
    InputError
        If there are none, or one differs in width.
    """
    every = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line and not line.isspace()
    ]
    lines = [entry for entry in every if not entry[1].lstrip().startswith(COMMENTS)]
    if not lines:
        msg = f"{path} is empty: it has no row of numbers; record or export it again"
        raise InputError(msg)
    _require_short(path, every)
    dialect = judged([line for _, line in lines])
    first = _first_row(dialect, lines)
    if first is None:
        msg = _no_row(path, lines)
        raise InputError(msg)
    above = [entry for entry in every if entry[0] < lines[first][0]]
    names, rest = header_of(path, dialect, above, COMMENTS)
    rows = lines[first:]
    _require_preamble(path, dialect, rest, rows)
    _require_width(path, dialect, rows)
    return TextTable(path=path, names=names, dialect=dialect, lines=rows)


def _require_short(path: str, lines: list[Line]) -> None:
    number, line = max(lines, key=lambda entry: len(entry[1]))
    if len(line) > MOST_LINE:
        msg = (
            f"{path}, line {number}: {len(line):,} characters; a row of a log has at "
            f"most {MOST_LINE:,}, so export it as rows"
        )
        raise InputError(msg)


def _first_row(dialect: Dialect, lines: list[Line]) -> int | None:
    # the first line of the usual width with numbers where most of the last lines have
    usual = _usual_numbers(dialect, lines)
    for k, (_, line) in enumerate(lines):
        numbers = np.array(dialect.numbers(line))
        if len(numbers) == dialect.width and 2 * np.sum(numbers & usual) > usual.sum():
            return k
    return None


def _usual_numbers(
    dialect: Dialect, lines: list[Line]
) -> Bool[NDArray[np.bool_], " n"]:
    # columns that hold numbers in most of the last lines
    rows = [dialect.numbers(line) for _, line in lines[-64:]]
    rows = [row for row in rows if len(row) == dialect.width]
    if not rows:
        return np.zeros(dialect.width, dtype=bool)
    return np.mean(rows, axis=0) > 0.5


def _no_row(path: str, lines: list[Line]) -> str:
    if any(is_names(header_names(line)) for _, line in lines):
        return f"{path} has a header but no row of numbers; record or export it again"
    return (
        f"{path} has no row of numbers: line {lines[0][0]} is {lines[0][1][:40]!r}; a "
        "log is rows of numbers with tabs, semicolons, commas or blanks between them, "
        "so export it as text"
    )


def _require_preamble(
    path: str, dialect: Dialect, above: list[Line], rows: list[Line]
) -> None:
    # what stands above header and rows is words; a row of numbers there is a broken one
    for number, line in above:
        numbers = dialect.numbers(line)
        if all(numbers) or (len(numbers) == dialect.width and numbers[0]):
            msg = (
                f"{path}, line {number}: {len(numbers)} columns, but the rows from "
                f"line {rows[0][0]} on have {dialect.width}; every row must have the "
                "same columns, so repair that line, or mark it as a remark (#)"
            )
            raise InputError(msg)


def _require_width(path: str, dialect: Dialect, rows: list[Line]) -> None:
    for number, line in rows:
        count = _count(dialect, line)
        if count != dialect.width:
            msg = (
                f"{path}, line {number}: {count} columns, but the first row has "
                f"{dialect.width}; every row must have the same columns, so repair or "
                "remove that line"
            )
            raise InputError(msg)


def _count(dialect: Dialect, line: str) -> int:
    if '"' in line:
        return len(dialect.fields(line))
    return len(line.split()) if dialect.mark is None else line.count(dialect.mark) + 1
