"""Numbers beside each other, rounded to the digits that their standard errors leave."""

import math
from collections.abc import Iterable, Iterator
from typing import Final

from simval.results import Row

PLAIN: Final = 6
"""Digits of a number that has no standard error."""
MOST: Final = 15
"""Digits beyond which a float has none."""
HEADS: Final = (
    "statistic",
    "measured",
    "standard error",
    "predicted",
    "apart",
    "theory",
)


def rounded(value: float, error: float) -> str:
    """Write a value as far as the second digit of its standard error."""
    if not (error > 0.0 and math.isfinite(error) and math.isfinite(value)):
        return f"{value:.{PLAIN}g}"
    last = math.floor(math.log10(error)) - 1  # power of ten of the last digit
    first = math.floor(math.log10(abs(value))) if value else last
    return f"{value:.{min(max(first - last, 0), MOST)}e}"


def apart(row: Row) -> str:
    """How far a row is from its prediction: in standard errors, where it has one."""
    if row.prediction is None or row.check == "limit":
        return ""
    difference = row.value - row.prediction
    if row.standard_error > 0.0:
        return f"{difference / row.standard_error:+.1f} s.e."
    return f"{difference:+.1g}" if difference else "0"


def beside_theory(rows: Iterable[Row]) -> Iterator[str]:
    """Lines of a table: what was measured beside what was predicted."""
    table = [HEADS, *(_entries(row) for row in rows)]
    widths = [max(len(line[place]) for line in table) for place in range(len(HEADS))]
    for line in table:
        cells = [f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)]
        cells[0], cells[-1] = f"{line[0]:<{widths[0]}}", line[-1]
        yield "  ".join(cells).rstrip()


def _entries(row: Row) -> tuple[str, ...]:
    error = row.standard_error
    predicted = "" if row.prediction is None else rounded(row.prediction, error)
    unit = "" if row.unit == "1" else f", {row.unit}"
    return (
        f"{row.statistic}{unit}",
        rounded(row.value, error),
        f"{error:.1e}" if error else "",
        f"at most {predicted}" if row.check == "limit" else predicted,
        apart(row),
        row.predictor,
    )
