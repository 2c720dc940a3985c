"""How the fields of a text log are written: separator and decimal mark."""

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SAMPLE = 64  # lines, spread over the file, by which the dialect is judged


@dataclass(frozen=True, slots=True)
class Dialect:
    """One way to write a row."""

    mark: str | None  # separator; None is white space
    comma: bool  # whether the decimal mark is a comma
    width: int = 0  # fields of a row

    def fields(self, line: str) -> list[str]:
        """Fields of a line, without quotes and blanks around them."""
        fields = line.split(self.mark)
        if '"' in line and self.mark is not None:
            try:
                fields = next(csv.reader([line], delimiter=self.mark), fields)
            except csv.Error:  # a field of more than 128 KiB: split as it stands
                return fields
        return [field.strip().strip("\"'").strip() for field in fields]

    def is_number(self, field: str) -> bool:
        """Return whether a field is a number, NaN and infinity among them."""
        if self.comma:
            if "." in field:
                return False
            field = field.replace(",", ".", 1)
        try:
            float(field)
        except ValueError:
            return False
        return "_" not in field

    def numbers(self, line: str) -> list[bool]:
        """Return which fields of a line are numbers."""
        return [self.is_number(field) for field in self.fields(line)]


# in this order where a file can be read in two ways: `1,2` is two numbers, not one
DIALECTS = (
    *(Dialect(mark, False) for mark in ("\t", ";", "|", ",", None)),
    *(Dialect(mark, True) for mark in ("\t", ";", "|", None)),
    Dialect(",", True),  # "1,5","2,3": each in quotes
)


def judged(lines: Sequence[str]) -> Dialect:
    """Return the dialect that reads the greatest share of the fields as numbers."""
    picked = np.unique(np.linspace(0, len(lines) - 1, SAMPLE).astype(int))
    sample = [lines[k] for k in picked]
    best = max(DIALECTS, key=lambda each: _share(each, sample))
    widths = Counter(len(best.fields(line)) for line in sample if _is_row(best, line))
    width = widths.most_common(1)[0][0] if widths else 0
    return Dialect(best.mark, best.comma, width)


def _share(dialect: Dialect, sample: Sequence[str]) -> float:
    return float(np.mean([np.mean(dialect.numbers(line)) for line in sample]))


def _is_row(dialect: Dialect, line: str) -> bool:
    return any(dialect.numbers(line))
