"""Figures of attitude filters: errors over time, their squares and their sources."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simval.judge.algorithms import algorithm_of
from simval.report.curves import Curve, Groups, bar_width
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
from simval.report.words import spelled
from simval.statistics import BUDGET_AT, NEES_AT, RMS_AT, RMS_OVER_BOUND
from simval.sweep.run import CellResult


def errors(groups: Groups, left_out: Sequence[str]) -> Drawing:
    """Errors over time beside the bound."""
    return Drawing(
        name="filter-errors",
        asked="How near to the bound is each filter?",
        caption=(
            "Attitude error over time, root mean square of the trials. Grey: the "
            "posterior Cramér-Rao bound, which no filter is below that knows of the "
            "sensors what they are; red and dotted, what theory says of the reference "
            "filter."
        ),
        alternative="RMS attitude error of each filter over time beside the bound",
        panels=[
            Panel(
                title=_title(label, cells),
                x_label="time, s",
                y_label="RMS error, degrees",
                series=[
                    *bound(cells[0]),
                    *predicted(cells),
                    *lines(cells, RMS_AT, np.degrees(1.0)),
                ],
                log_x=False,
            )
            for label, cells in groups.items()
        ],
        columns=2,
        left_out=left_out,
    )


def ratios(groups: Groups, left_out: Sequence[str]) -> Drawing:
    """The same over the bound, where a percent is seen."""
    found = [
        (label, cells, [c for cell in cells if (c := over_bound(cell)) is not None])
        for label, cells in groups.items()
    ]
    z = bar_width(c for _, _, curves in found for c in curves)
    panels = [
        panel
        for label, cells, curves in found
        if (
            panel := ratio_panel(
                _title(label, cells),
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


def squares(groups: Groups, left_out: Sequence[str]) -> Drawing:
    """Squared errors by what each filter states of them."""
    return Drawing(
        name="filter-nees",
        asked="Is what a filter states of its errors true?",
        caption=(
            "Normalised squared error of the attitude over time, mean over the trials: "
            "3 for an honest covariance. Grey lines: where one honest instant in a "
            "thousand is outside. Above, a filter is overconfident; below, its errors "
            "are smaller than it says."
        ),
        alternative="Normalised squared error of each filter over time with its band",
        panels=[
            Panel(
                title=_title(label, cells),
                x_label="time, s",
                y_label="NEES (3 is right)",
                series=[*lines(cells, NEES_AT, 1.0), *band(cells)],
                log_x=False,
            )
            for label, cells in groups.items()
            if any(at(cell, NEES_AT)[0].size for cell in cells)
        ],
        columns=2,
        left_out=left_out,
    )


def costs(groups: Groups) -> str:
    """Error over the bound of the best and the worst cell."""
    found = [
        (row.value, algorithm_of(cell), label)
        for label, cells in groups.items()
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


def honest(groups: Groups) -> str:
    """Share of the instants whose NEES is outside the band, of all cells together."""
    count = outside = 0
    for cell in (cell for cells in groups.values() for cell in cells):
        _, y, _ = at(cell, NEES_AT)
        if len(y):
            low, high = (end.y for end in band([cell]))
            count += len(y)
            outside += int(np.sum((y < low) | (y > high)))
    if not count:
        return ""
    expected = f"of an honest filter {1000.0 * BAND:g} in 1000 would be"
    return f"{outside:,} of {count:,} instants are outside the band; {expected}."


def budget(groups: Groups) -> Drawing:
    """What each source adds, a panel for each scenario."""
    return Drawing(
        name="filter-budget",
        asked="Where does the error come from?",
        fold="What each source adds to the predicted error of the reference filter",
        caption=(
            "What each source adds to the predicted attitude error of the reference "
            "filter over time. The squares of the parts add up to that of the whole."
        ),
        alternative="Predicted attitude error over time, by source",
        panels=[
            panel for label, own in groups.items() for panel in _budget(label, own)
        ],
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
                title=_title(label, cells),
                x_label="time, s",
                y_label="part of the RMS error, degrees",
                series=series,
                log_x=False,
            )
        ]
    return []


def _title(label: str, cells: Sequence[CellResult]) -> str:
    """What is different in these cells; where nothing is, their scenario."""
    return label or str(cells[0].parameters.get("scenario") or spelled("filter"))
