"""Attitude error against noise: bias and covariance beside every prediction."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from simval.report.curves import Measure, bar_width, curve, first, grouped
from simval.report.measures import left_out, moment
from simval.report.noise import SLOPES, slope_cells
from simval.report.panels import COLOURS, GREY, Drawing, Panel, Series
from simval.report.section import Context, Section, Shown, made
from simval.report.slope import order
from simval.report.table import Column, Table
from simval.report.words import slugs
from simval.statistics import (
    BIAS,
    COVARIANCE,
    EXACT,
    ORDER_2,
    ORDER_4,
    ORDER_4_SOURCE,
    UNIT_LENGTH,
    Family,
)
from simval.sweep.run import CellResult

STYLES = {
    ORDER_2: (COLOURS[4], "--"),
    ORDER_4_SOURCE: (COLOURS[3], "-."),
    ORDER_4: (COLOURS[2], "-"),
    EXACT: (COLOURS[0], ":"),
}
CLAIMED = {ORDER_2: 4.0, ORDER_4_SOURCE: 6.0, ORDER_4: 6.0}
"""Order of what each formula leaves out, by its stated order."""

NOISE = "noise of each unit vector, 1"
PARTS = (BIAS, COVARIANCE)
SHOWN = Shown("attitude", (BIAS, COVARIANCE, UNIT_LENGTH))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("attitude")
    if not cells:
        return None
    groups = grouped(cells, "noise_std")
    shown, left_out = first(groups)
    drawings = [
        _drawing(name, label, shown[label])
        for name, label in zip(slugs("attitude", shown), shown, strict=True)
    ]
    drawings[-1] = replace(drawings[-1], left_out=left_out)
    return made(
        "attitude",
        "Attitude error against noise",
        drawings,
        [_orders(groups), _slopes(groups), _unit_lengths(cells)],
        groups=len(groups),
        shown=len(shown),
    )


def remainders(cells: Sequence[CellResult], part: Family) -> Panel:
    """What each truncated formula leaves out, beside the moment itself."""
    series: list[Series] = []
    for predictor in CLAIMED:
        c = curve("", cells, "noise_std", left_out(part, predictor))
        if c is None or not np.any(c.value > 0.0):
            continue
        if not series:
            series.append(line(c.x, c.prediction, EXACT, f"the {part.words}"))
        series.append(line(c.x, c.value, predictor, f"left out, {predictor}"))
    sampled = curve("", cells, "noise_std", moment(part, EXACT))
    if sampled is not None:
        dotted = Series(
            label="standard error", x=sampled.x, y=sampled.error, colour=GREY, line=":"
        )
        series.append(dotted)
    return _panel(f"{part.words}: what is left out", series)


def beside_predictions(
    cells: Sequence[CellResult],
    measure_against: Callable[[str], Measure],
    z: float | None = None,
) -> list[Series]:
    """Simulated points over the noise, and a line for each prediction."""
    series = []
    points = curve("simulated", cells, "noise_std", measure_against(EXACT))
    if points is not None:
        series.append(points.points(bar_width([points]) if z is None else z))
    for predictor in STYLES:
        c = curve("", cells, "noise_std", measure_against(predictor))
        if c is not None:
            series.append(line(c.x, c.prediction, predictor, predictor))
    return series


def line(x: np.ndarray, y: np.ndarray, predictor: str, label: str) -> Series:
    """A line in the style of its prediction."""
    colour, style = STYLES[predictor]
    return Series(label=label, x=x, y=y, colour=colour, line=style)


def _panel(title: str, series: Sequence[Series]) -> Panel:
    return Panel(
        title=title, x_label=NOISE, y_label="Frobenius norm, 1", series=tuple(series)
    )


def _drawing(name: str, label: str, cells: Sequence[CellResult]) -> Drawing:
    z = bar_width(curve("", cells, "noise_std", moment(part, EXACT)) for part in PARTS)
    panels = [
        _panel(part.words, beside_predictions(cells, partial(moment, part), z))
        for part in PARTS
    ]
    panels += [remainders(cells, part) for part in PARTS]
    return Drawing(
        name=name,
        caption=(
            f"{label + ': ' if label else ''}above, bias and covariance of the "
            f"simulated error (bars: {z:.2f} standard errors, 95 % for all points of "
            "the figure together) beside theory. Below, how far each truncated "
            "formula is from the exact answer, computed without sampling: the moment "
            "itself has slope 2, what the second order leaves out slope 4, what the "
            "complete fourth order leaves out slope 6. What lies below the dotted "
            "standard error cannot be told from the exact answer with these samples."
        ),
        alternative=(
            f"{label + ': ' if label else ''}bias and covariance of the attitude error "
            "against the noise on logarithmic axes, simulated points beside predicted "
            "lines; and the distance of each truncated prediction from the exact one"
        ),
        panels=panels,
        columns=2,
    )


def _orders(groups: Mapping[str, Sequence[CellResult]]) -> Table:
    rows = []
    for label, cells in groups.items():
        for part in PARTS:
            for predictor, claimed in CLAIMED.items():
                c = curve("", cells, "noise_std", left_out(part, predictor))
                if c is None:
                    continue
                at = f"{c.x[0]:g} to {_second(c.x):g}" if len(c.x) > 1 else ""
                slope = order(c.x, c.value)
                rows.append((label, part.words, predictor, at, slope, claimed))
    return Table(
        name="attitude-orders",
        caption=(
            "Order of each formula: slope of what it leaves out at the two smallest "
            "noise levels, without sampling"
        ),
        columns=(
            Column("cells"),
            Column("moment"),
            Column("formula"),
            Column("noise"),
            Column("slope", "number", 5),
            Column("stated order", "number"),
        ),
        rows=rows,
        shown=120,
    )


def _unit_lengths(cells: Sequence[CellResult]) -> Table:
    kinds = ("simulated", EXACT, ORDER_4, ORDER_2, ORDER_4_SOURCE)
    rows = []
    for cell in cells:
        found = {
            row.statistic.entries[0]: row.value
            for row in cell.rows
            if row.statistic.family == UNIT_LENGTH
        }
        if not found:
            continue
        geometry, noise = cell.parameters["geometry"], cell.parameters["noise_std"]
        values = (found.get(kind) for kind in kinds)
        rows.append((geometry, float(noise), *values))
    return Table(
        name="unit-length",
        caption=(
            "Unit length: truth and estimate have length 1, so tr C + |m|² = 2 q'm "
            "for the bias m and covariance C of truth less estimate. Relative defect: "
            "rounding for samples and the exact answer, what it leaves out for a "
            "truncated formula"
        ),
        columns=(
            Column("geometry", "number", 19),
            Column("noise", "number"),
            *(Column(kind, "number", 3) for kind in kinds),
        ),
        rows=rows,
        shown=120,
    )


def _second(x: np.ndarray) -> float:
    distinct = np.unique(x)
    return float(distinct[min(1, len(distinct) - 1)])


def _slopes(groups: Mapping[str, Sequence[CellResult]]) -> Table:
    rows = []
    for label, cells in groups.items():
        for part in PARTS:
            c = curve(label, cells, "noise_std", moment(part, EXACT))
            if c is not None:
                rows.append((label, part.words, *slope_cells(c), 2.0))
    return Table(
        name="attitude-slopes",
        caption="Slopes of the simulated moments in the noise, with 95 % intervals",
        columns=(Column("cells"), Column("moment"), *SLOPES),
        rows=rows,
        shown=120,
    )
