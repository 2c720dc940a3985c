"""Attitude filters: errors over time beside the bound, and what they say of them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from markupsafe import Markup

from simval.compare.merits import algorithm_of
from simval.report.artifacts import arrays, shaped
from simval.report.attitudes import turning
from simval.report.curves import MAX_GROUPS, Curve, bar_width, grouped
from simval.report.filter_curves import (
    BAND,
    LINES,
    at,
    band,
    bound,
    lines,
    over_bound,
    points,
    predicted,
)
from simval.report.panels import COLOURS, Drawing, Panel, Series
from simval.report.ratio import ratio_panel
from simval.report.section import Context, Section, Shown, made
from simval.report.table import Column, Table
from simval.report.words import spelled
from simval.results import Row
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
from simval.studies.filter_rows import HEADING, INCLINATION
from simval.sweep.run import CellResult

SHOWN = Shown(
    "filter",
    (RMS, RMS_AT, BOUND_AT, NEES(), NEES_AT, DIVERGED, BUDGET_AT, NIS,
     SETTLING, RMS_OVER_BOUND),
)  # fmt: skip


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("filter")
    if not cells:
        return None
    groups = grouped(cells, "algorithm")
    labels = list(groups)
    shown = list(groups.items())[:MAX_GROUPS]
    left_out = labels[MAX_GROUPS:]
    drawings = [
        _errors(shown, left_out),
        _ratios(shown, left_out),
        _squares(shown, left_out),
    ]
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
                    *bound(cells[0]),
                    *predicted(cells),
                    *lines(cells, RMS_AT, np.degrees(1.0)),
                ],
                log_x=False,
            )
            for label, cells in groups
        ],
        columns=2,
        left_out=left_out,
    )


def _ratios(
    groups: Sequence[tuple[str, Sequence[CellResult]]], left_out: Sequence[str]
) -> Drawing:
    """The same over the bound, where a percent is seen."""
    found = [
        (label, cells, [c for cell in cells if (c := over_bound(cell)) is not None])
        for label, cells in groups
    ]
    z = bar_width(c for _, _, curves in found for c in curves)
    panels = [
        panel
        for label, cells, curves in found
        if (
            panel := ratio_panel(
                label or spelled("filter"),
                "time, s",
                curves,
                z,
                _predicted_over(cells, curves),
                log_x=False,
            )
        )
    ]
    return Drawing(
        name="filter-ratio",
        fold="The error over the bound, on a linear axis",
        caption=(
            "RMS error over the posterior Cramér-Rao bound. Bars: "
            f"{z:.2f} standard errors, 95 % for all points of the figure together; red "
            "and dotted, what theory says of the reference filter."
        ),
        alternative="RMS error of each filter over the bound, over time",
        panels=[replace(panel, y_label="RMS error / bound") for panel in panels],
        columns=2,
        left_out=left_out,
    )


def _predicted_over(
    cells: Sequence[CellResult], curves: Sequence[Curve]
) -> list[Series]:
    """What theory says of the reference filter, over the bound."""
    for series in predicted(cells) if curves else []:
        least = np.degrees(curves[0].prediction)
        if np.array_equal(series.x, curves[0].x):
            return [replace(series, y=series.y / least)]
    return []


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
                series=[*lines(cells, NEES_AT, 1.0), *band(cells)],
                log_x=False,
            )
            for label, cells in groups
            if any(at(cell, NEES_AT)[0].size for cell in cells)
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
        ends = band(cells)
        for cell in cells if ends else ():
            x, y, _ = at(cell, NEES_AT)
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
            for x, y, _ in [points([r for r in rows if r.statistic.entries[0] == part])]
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
