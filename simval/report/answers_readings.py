"""What one cell says of how great its errors are, in a person's units."""

from functools import partial
from typing import NamedTuple

import numpy as np

from simval.figures import Headline, Quote
from simval.report.answers import angle, in_unit, rounded
from simval.report.words import measured
from simval.results import Row
from simval.statistics import (
    APART,
    COVARIANCE_ORDER,
    COVERAGE,
    LEADING_ERROR_RATIO,
    LIMIT_RATIO,
    REST_FORCE,
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    SCALE_BIAS,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
)
from simval.sweep.run import CellResult


class Reading(NamedTuple):
    """What a cell says, and how great its error is beside other cells of its study."""

    said: str
    size: float
    n: int


def of_headline(headline: Headline, cell: CellResult) -> Reading | None:
    """What a cell says by the headline of its study; None without all of its rows."""
    rows = {name: cell.row(q.of, q.by) for name, q in headline.quotes.items()}
    found = {name: row for name, row in rows.items() if row is not None}
    said = {name: _quoted(q, rows[name]) for name, q in headline.quotes.items()}
    if "" in said.values():
        return None
    first = found[next(iter(headline.quotes))]
    return Reading(headline.says.format(**said), first.value, first.n)


def _quoted(quote: Quote, row: Row | None) -> str:
    """The number in words; empty without one."""
    numbers = () if row is None else (row.value, row.standard_error)
    if row is None or not np.isfinite(numbers).all():
        return ""
    if quote.angle:
        return angle(quote.times * row.value)
    if quote.unit is not None:
        return in_unit(row.value, quote.unit, quote.digits)
    if quote.over and row.prediction is not None and row.prediction > 0.0:
        return _ratio(row)
    if not row.value > 0.0 or quote.over:
        return ""
    root = float(np.sqrt(row.value))
    if quote.root:
        return measured(root, row.standard_error / 2.0 / root)
    return measured(*numbers)


ANY = (
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    COVERAGE,
    SCALE_BIAS,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
    LIMIT_RATIO,
    COVARIANCE_ORDER,
    LEADING_ERROR_RATIO,
    REST_FORCE,
    APART,
)
"""What a study without words of its own is told by: the first that it has."""


def any_reading(cell: CellResult) -> Reading | None:
    """What a study without words of its own is told by."""
    row = headline_row(cell)
    return None if row is None else Reading(_told(row), _distance(row), row.n)


def headline_row(cell: CellResult) -> Row | None:
    """The statistic that says most, its entry farthest from what was predicted."""
    finite = [row for row in cell.rows if np.isfinite(row.value)]
    for family in (*ANY, *dict.fromkeys(row.statistic.family for row in finite)):
        rows = [row for row in finite if row.statistic.family == family]
        judged = [row for row in rows if row.check != "record"]
        if rows:
            return max(judged or rows, key=_distance)
    return None


def _told(row: Row) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    who = f" ({', '.join(row.statistic.entries)})" if row.statistic.entries else ""
    said = f"{row.statistic.family.words} {_value(row)}{unit}{who}"
    if row.check == "limit" or row.prediction is None:
        return said
    return f"{said}; {rounded(row.prediction, 3)} predicted"


def _value(row: Row) -> str:
    sampled = row.standard_error > 0.0
    exact = partial(rounded, digits=3)
    return measured(row.value, row.standard_error) if sampled else exact(row.value)


def _distance(row: Row) -> float:
    """How far a value is from its prediction, or from nothing."""
    if row.prediction is None or not np.isfinite(row.prediction):
        return abs(row.value)
    return abs(row.value - row.prediction) / (abs(row.prediction) or 1.0)


def _ratio(row: Row) -> str:
    by = row.prediction or 1.0
    return measured(row.value / by, row.standard_error / by)
