"""What one cell says of how great its errors are, in a person's units.

The error of a quaternion q of unit length is half of the small angle that it is wrong
by, so an angle is twice the length of the quaternion's error, to the order of the
angle's square over 48.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from simval.report.answers import angle, in_unit, percent, rounded
from simval.report.words import measured
from simval.results import Row
from simval.statistics import (
    APART,
    BUDGET,
    CARRIED,
    COVARIANCE_ORDER,
    COVERAGE,
    CRAMER_RAO,
    EXACT,
    FIRST_ORDER,
    IMPURE,
    INTERVALS,
    LEADING_ERROR_RATIO,
    LIMIT_RATIO,
    PRECISION,
    RECALL,
    REST_FORCE,
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    SCALE_BIAS,
    SD,
    SPREAD,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
)
from simval.sweep.run import CellResult
from simval.units import OF_A_CALIBRATION, PPM

MEAN = SQUARED_ERROR("mean")  # over the parameters of a gyroscope
BOUND = "\N{MULTIPLICATION SIGN} the bound"


class Reading(NamedTuple):
    """What a cell says, and how great its error is beside other cells of its study."""

    said: str
    size: float
    n: int


def _calibration(cell: CellResult) -> Reading | None:
    rows = [cell.row(RMS(name), CRAMER_RAO) for name in "TKB"]
    good = [row for row in rows if row is not None and _sound(row)]
    over = cell.row(RMS_OVER_BOUND(), FIRST_ORDER)
    if len(good) < len(rows) or over is None:
        return None
    sizes = ", ".join(
        f"{name} {in_unit(row.value, OF_A_CALIBRATION[name])}"
        for name, row in zip("TKB", good, strict=True)
    )
    ratio = measured(over.value, over.standard_error)
    return Reading(f"{sizes}; {ratio} {BOUND}", over.value, over.n)


def _attitude(cell: CellResult) -> Reading | None:
    row = cell.row(RMS(), EXACT)
    if row is None or not _sound(row):
        return None
    said = f"{angle(2.0 * row.value)} RMS; {_ratio(row)} \N{MULTIPLICATION SIGN} theory"
    return Reading(said, row.value, row.n)


def _filter(cell: CellResult) -> Reading | None:
    row = cell.row(RMS(), CRAMER_RAO)
    if row is None or not _sound(row):
        return None
    return Reading(f"{angle(row.value)} RMS; {_ratio(row)} {BOUND}", row.value, row.n)


def _magnetometer(cell: CellResult) -> Reading | None:
    whole, dip = (cell.row(s, FIRST_ORDER) for s in (SPREAD("M"), SD("dip")))
    over = cell.row(VARIANCE_OVER_BOUND("M"), CRAMER_RAO)
    if whole is None or dip is None or over is None or not over.value > 0.0:
        return None
    root = float(np.sqrt(over.value))
    ratio = measured(root, over.standard_error / 2.0 / root)
    said = f"M {percent(whole.value)}, dip {angle(dip.value)}; {ratio} {BOUND}"
    return Reading(said, whole.value, dip.n)


def _gyroscope(cell: CellResult) -> Reading | None:
    size, over = cell.row(SD("M", "bound")), cell.row(MEAN, CRAMER_RAO)
    if size is None or over is None or not over.value > 0.0:
        return None
    root = float(np.sqrt(over.value))
    ratio = measured(root, over.standard_error / 2.0 / root)
    said = f"M {in_unit(size.value * root, PPM)}; {ratio} {BOUND}"
    return Reading(said, size.value * root, over.n)


def _end_to_end(cell: CellResult) -> Reading | None:
    row = cell.row(BUDGET("total"), CARRIED)
    if row is None or not _sound(row):
        return None
    said = (
        f"attitude {angle(row.value)} RMS; {_ratio(row)} \N{MULTIPLICATION SIGN} theory"
    )
    return Reading(said, row.value, row.n)


def _detector(cell: CellResult) -> Reading | None:
    rows = [cell.row(family()) for family in (PRECISION, RECALL, IMPURE, INTERVALS)]
    precision, recall, impure, intervals = rows
    if precision is None or recall is None or impure is None or intervals is None:
        return None
    said = (
        f"{rounded(100.0 * precision.value, 3)} % of the rows found are still, "
        f"{rounded(100.0 * recall.value, 3)} % of the still ones found; "
        f"{rounded(impure.value)} of {rounded(intervals.value)} intervals impure"
    )
    return Reading(said, impure.value / max(intervals.value, 1.0), precision.n)


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


def _sound(row: Row) -> bool:
    """Whether a row is a size beside a prediction."""
    numbers = (row.value, row.standard_error, row.prediction or 0.0)
    return bool(np.isfinite(numbers).all()) and min(row.value, numbers[2]) > 0.0


READERS: Mapping[str, Callable[[CellResult], Reading | None]] = {
    "calibration": _calibration,
    "attitude": _attitude,
    "filter": _filter,
    "magnetometer": _magnetometer,
    "gyroscope": _gyroscope,
    "end_to_end": _end_to_end,
    "detector": _detector,
}
