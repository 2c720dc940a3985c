"""Attitude filters: errors over time beside the bound, and what they say of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
from markupsafe import Markup

from simval.arrays import Array
from simval.compare.merits import algorithm_of
from simval.report.artifacts import arrays, shaped
from simval.report.attitudes import turning
from simval.report.curves import MAX_GROUPS, grouped
from simval.report.palette import BOUND, THEORY
from simval.report.panels import COLOURS, GREY, Drawing, Panel, Series
from simval.report.section import Context, Section, Shown, made
from simval.report.table import Column, Table
from simval.report.words import spelled
from simval.results import Row
from simval.shapes import Float
from simval.statistics import (
    BOUND_AT,
    BUDGET_AT,
    DIVERGED,
    NEES,
    NEES_AT,
    NIS,
    RMS,
    RMS_AT,
    RMS_OVER_BOUND,
    SETTLING,
    Family,
)
from simval.studies.filter import artifact_of
from simval.studies.filter_rows import ATTITUDE, HEADING, INCLINATION
from simval.sweep.run import CellResult

SHOWN = Shown(
    "filter",
    (RMS, RMS_AT, BOUND_AT, NEES(), NEES_AT, DIVERGED, BUDGET_AT, NIS,
     SETTLING, RMS_OVER_BOUND),
)  # fmt: skip
LINES = ("-", "--", "-.", ":")
BAND = 1e-3  # of false alarms: how often an honest instant is outside, two-sided
DIMENSION = 3  # of the attitude


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("filter")
    if not cells:
        return None
    groups = grouped(cells, "algorithm")
    labels = list(groups)
    shown = list(groups.items())[:MAX_GROUPS]
    left_out = labels[MAX_GROUPS:]
    drawings = [_errors(shown, left_out), _squares(shown, left_out)]
    budgets = [panel for label, own in shown for panel in _budget(label, own)]
    if budgets:
        drawings.append(_drawn_budget(budgets))
    drawn = [drawing for drawing in drawings if drawing.panels]
    pictures = _turning(context, cells)
    return made(
        "filters", "Attitude filters", drawn, [_table(cells)],
        turning=pictures[:MAX_GROUPS], hidden=max(len(pictures) - MAX_GROUPS, 0),
    )  # fmt: skip


def _turning(context: Context, cells: Sequence[CellResult]) -> list[tuple[str, Markup]]:
    """A moving picture of each cell that left attitudes, the worst first."""
    found = []
    for cell in cells:
        file = context.run.folder / "artifacts" / artifact_of(cell.parameters)
        if not file.is_file():
            continue
        content = arrays(file)
        time = shaped(file, content, "time", None)
        count = len(time)
        truth, estimate = (
            shaped(file, content, name, count, 4) for name in ("truth", "estimate")
        )
        if count < 2 or not (np.diff(time) > 0.0).all():
            continue
        words = f"{algorithm_of(cell)}, {cell.parameters.get('scenario', '')}"
        worst = float(np.abs(np.vecdot(truth, estimate)).min())
        found.append((worst, words, turning(words, time, truth, estimate)))
    return [(words, picture) for _, words, picture in sorted(found, key=_worst)]


def _worst(found: tuple[float, str, Markup]) -> float:
    return found[0]


def _table(cells: Sequence[CellResult]) -> Table:
    """A row for each cell: what was measured, and what theory said beforehand."""
    return Table(
        name="filter-scenarios",
        caption=(
            "Each filter in each scenario: its error, then the squares of errors (of "
            "3) and of innovations by what it states of them, each beside what "
            "theory predicts of the reference filter, and when it settles"
        ),
        columns=(
            Column("algorithm", "code"),
            Column("scenario"),
            Column("RMS error, degrees", "measured"),
            Column("over the bound", "measured"),
            Column("heading, degrees", "measured"),
            Column("inclination, degrees", "measured"),
            Column("NEES", "measured"),
            Column("predicted", "number"),
            Column("NIS", "measured"),
            Column("predicted", "number"),
            Column("settles after, s", "number", 3),
            Column("diverged", "number", 3),
        ),
        rows=[_line(cell) for cell in cells],
    )


def _line(cell: CellResult) -> tuple[Any, ...]:
    def of(family: Family, *entries: str) -> list[Row]:
        return [
            row
            for row in cell.rows
            if row.statistic.family == family and row.statistic.entries == entries
        ]

    def measured(rows: Sequence[Row], scale: float = 1.0) -> tuple[float, float] | None:
        if not rows:
            return None
        return scale * rows[0].value, scale * rows[0].standard_error

    def predicted(rows: Sequence[Row]) -> float | None:
        return rows[-1].prediction if rows else None

    degrees = float(np.degrees(1.0))
    rms, nees, nis = of(RMS), of(NEES), of(NIS)
    settled, lost = of(SETTLING), of(DIVERGED)
    return (
        algorithm_of(cell),
        cell.parameters.get("scenario", ""),
        measured(rms, degrees),
        measured(of(RMS_OVER_BOUND)),
        measured(of(RMS, HEADING), degrees),
        measured(of(RMS, INCLINATION), degrees),
        measured(nees),
        predicted(nees),
        measured(nis),
        predicted(nis),
        settled[0].value if settled else None,
        lost[0].value if lost else None,
    )


def _errors(
    groups: Sequence[tuple[str, Sequence[CellResult]]], left_out: Sequence[str]
) -> Drawing:
    return Drawing(
        name="filter-errors",
        asked="How near to the bound is each filter?",
        finding=_costs(groups),
        caption=(
            "Attitude error over time, root mean square of the trials. Grey: the "
            "posterior Cramér-Rao bound, which no filter is below that knows of the "
            "sensors what they are; red and dotted, what theory says of the reference "
            "filter."
        ),
        alternative="RMS attitude error of each filter over time beside the bound",
        panels=[
            Panel(
                title=label or spelled("filter"),
                x_label="time, s",
                y_label="RMS error, degrees",
                series=[
                    *_bound(cells[0]),
                    *_predicted(cells),
                    *_curves(cells, RMS_AT, np.degrees(1.0)),
                ],
                log_x=False,
            )
            for label, cells in groups
        ],
        columns=2,
        left_out=left_out,
    )


def _squares(
    groups: Sequence[tuple[str, Sequence[CellResult]]], left_out: Sequence[str]
) -> Drawing:
    return Drawing(
        name="filter-nees",
        asked="Is what a filter states of its errors true?",
        finding=_honest(groups),
        caption=(
            "Normalised squared error of the attitude over time, mean over the trials: "
            "3 for an honest covariance. Grey lines: where one honest instant in a "
            "thousand is outside. Above, a filter is overconfident; below, its errors "
            "are smaller than it says."
        ),
        alternative="Normalised squared error of each filter over time with its band",
        panels=[
            Panel(
                title=label or spelled("filter"),
                x_label="time, s",
                y_label="NEES (3 is right)",
                series=[*_curves(cells, NEES_AT, 1.0), *_band(cells)],
                log_x=False,
            )
            for label, cells in groups
            if any(_at(cell, NEES_AT)[0].size for cell in cells)
        ],
        columns=2,
        left_out=left_out,
    )


def _costs(groups: Sequence[tuple[str, Sequence[CellResult]]]) -> str:
    """Error over the bound of the best and the worst cell."""
    found = [
        (row.value, algorithm_of(cell), label)
        for label, cells in groups
        for cell in cells
        for row in cell.rows
        if row.statistic.family == RMS_OVER_BOUND and not row.statistic.entries
    ]
    if not found:
        return ""
    told = [
        f"{value:.3g} times the bound ({name}{', ' if label else ''}{label})"
        for value, name, label in dict.fromkeys((min(found), max(found)))
    ]
    return f"The RMS error is {' to '.join(told)}."


def _honest(groups: Sequence[tuple[str, Sequence[CellResult]]]) -> str:
    """Share of the instants whose NEES is outside the band, of all cells together."""
    count = outside = 0
    for _, cells in groups:
        ends = _band(cells)
        for cell in cells if ends else ():
            x, y, _ = _at(cell, NEES_AT)
            low, high = (np.interp(x, end.x, end.y) for end in ends)
            count += len(y)
            outside += int(np.sum((y < low) | (y > high)))
    if not count:
        return ""
    expected = f"{1000.0 * BAND:g} in 1000 of an honest filter"
    return f"{outside:,} of {count:,} instants are outside the band, {expected} are."


def _drawn_budget(panels: Sequence[Panel]) -> Drawing:
    return Drawing(
        name="filter-budget",
        asked="Where does the error come from?",
        fold="What each source adds to the predicted error of the reference filter",
        caption=(
            "What each source adds to the predicted attitude error of the reference "
            "filter over time. The squares of the parts add up to that of the whole."
        ),
        alternative="Predicted attitude error over time, by source",
        panels=panels,
        columns=2,
    )


def _budget(label: str, cells: Sequence[CellResult]) -> list[Panel]:
    for cell in cells:
        rows = [r for r in cell.rows if r.statistic.family == BUDGET_AT]
        parts = list(dict.fromkeys(row.statistic.entries[0] for row in rows))
        if not parts:
            continue
        series = [
            Series(
                label=part,
                x=x,
                y=np.degrees(y),
                colour=COLOURS[k % len(COLOURS)],
                line=LINES[k // len(COLOURS)],
            )
            for k, part in enumerate(parts)
            for x, y, _ in [
                _points([r for r in rows if r.statistic.entries[0] == part])
            ]
        ]
        return [
            Panel(
                title=label or spelled("filter"),
                x_label="time, s",
                y_label="part of the RMS error, degrees",
                series=series,
                log_x=False,
            )
        ]
    return []


def _bound(cell: CellResult) -> list[Series]:
    x, y, _ = _at(cell, BOUND_AT)
    least = np.degrees(y)
    return (
        [Series(label="bound", x=x, y=least, colour=BOUND, line="-")] if len(x) else []
    )


def _predicted(cells: Sequence[CellResult]) -> list[Series]:
    """What theory says of the reference filter: the root of the parts' squares."""
    for cell in cells:
        x, y, _ = _points([r for r in cell.rows if r.statistic.family == BUDGET_AT])
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


def _band(cells: Sequence[CellResult]) -> list[Series]:
    """Where the mean over so many trials lies, by its chi-square law."""
    for cell in cells:
        x, _, n = _at(cell, NEES_AT)
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


def _curves(cells: Sequence[CellResult], family: Family, scale: float) -> list[Series]:
    series = []
    for k, cell in enumerate(cells):
        x, y, _ = _at(cell, family)
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


def _at(
    cell: CellResult, family: Family
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Time, value and trials of the rows of the attitude."""
    return _points(
        [
            row
            for row in cell.rows
            if row.statistic.family == family
            and row.statistic.entries[:1] == (ATTITUDE,)
        ]
    )


def _points(
    rows: Sequence[Row],
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    found = [(_number(r.statistic.entries[-1]), r.value, float(r.n)) for r in rows]
    x, y, n = np.array(sorted(p for p in found if np.isfinite(p[0]))).reshape(-1, 3).T
    return x, y, n


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan
