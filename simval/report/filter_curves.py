"""Attitude filters over time, as curves: errors, bounds, squares and their bands."""

from collections.abc import Sequence

import numpy as np
import scipy

from simval.arrays import Array
from simval.judge.algorithms import algorithm_of
from simval.report.curves import Curve
from simval.report.palette import BOUND, THEORY
from simval.report.panels import COLOURS, GREY, Series
from simval.results import Row
from simval.shapes import Float
from simval.statistics import BOUND_AT, BUDGET_AT, NEES_AT, RMS_AT, Family
from simval.studies.filter_rows import ATTITUDE
from simval.sweep.run import CellResult

LINES = ("-", "--", "-.", ":")
BAND = 1e-3  # of false alarms: how often an honest instant is outside, two-sided
DIMENSION = 3  # of the attitude


def bound(cell: CellResult) -> list[Series]:
    """The posterior Cramér-Rao bound over time, degrees."""
    x, y, _ = at(cell, BOUND_AT)
    least = np.degrees(y)
    return (
        [Series(label="bound", x=x, y=least, colour=BOUND, line="-")] if len(x) else []
    )


def predicted(cells: Sequence[CellResult]) -> list[Series]:
    """What theory says of the reference filter: the root of the parts' squares."""
    for cell in cells:
        x, y, _ = points([r for r in cell.rows if r.statistic.family == BUDGET_AT])
        if len(x):
            time, place = np.unique(x, return_inverse=True)
            total = np.sqrt(np.bincount(place, weights=y**2))
            return [
                Series(
                    label="predicted, reference filter",
                    x=time,
                    y=np.degrees(total),
                    colour=THEORY,
                    line=":",
                )
            ]
    return []


def band(cells: Sequence[CellResult]) -> list[Series]:
    """Where the mean over so many trials lies, by its chi-square law."""
    for cell in cells:
        x, _, n = at(cell, NEES_AT)
        if len(x):
            freedom = DIMENSION * n
            law = scipy.stats.chi2
            return [
                Series(label="", x=x, y=y, colour=GREY, line="--")
                for y in (
                    law.ppf(BAND / 2.0, freedom) / n,
                    law.isf(BAND / 2.0, freedom) / n,
                )
            ]
    return []


def lines(cells: Sequence[CellResult], family: Family, scale: float) -> list[Series]:
    """A line for each cell, an algorithm of its own."""
    series = []
    for k, cell in enumerate(cells):
        x, y, _ = at(cell, family)
        if len(x):
            series.append(
                Series(
                    label=algorithm_of(cell),
                    x=x,
                    y=scale * y,
                    colour=COLOURS[k % len(COLOURS)],
                    line=LINES[k // len(COLOURS) % len(LINES)],
                )
            )
    return series


def at(
    cell: CellResult, family: Family
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Time, value and trials of the rows of the attitude."""
    return points(
        [
            row
            for row in cell.rows
            if row.statistic.family == family
            and row.statistic.entries[:1] == (ATTITUDE,)
        ]
    )


def points(
    rows: Sequence[Row],
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Time, value and trials of rows whose last entry is a time."""
    found = [(number(r.statistic.entries[-1]), r.value, float(r.n)) for r in rows]
    x, y, n = np.array(sorted(p for p in found if np.isfinite(p[0]))).reshape(-1, 3).T
    return x, y, n


def number(text: str) -> float:
    """A time, or NaN for an entry that is none."""
    try:
        return float(text)
    except ValueError:
        return np.nan


def over_bound(cell: CellResult) -> Curve | None:
    """RMS error of an algorithm beside the bound at the same times, radians."""
    rows = [
        row
        for row in cell.rows
        if row.statistic.family == RMS_AT and row.statistic.entries[:1] == (ATTITUDE,)
    ]
    x, y, _ = points(rows)
    t, least, _ = at(cell, BOUND_AT)
    if not len(x) or not np.array_equal(x, t):
        return None
    errors = {number(r.statistic.entries[-1]): r.standard_error for r in rows}
    error = np.array([errors[time] for time in x])
    return Curve(label=algorithm_of(cell), x=x, value=y, error=error, prediction=least)
