"""Attitude error against noise: bias and covariance beside every prediction."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from simval.report.curves import curve, first, grouped
from simval.report.measures import left_out, moment
from simval.report.noise import SLOPES, slope_cells
from simval.report.panels import COLOURS, GREY, Drawing, Panel, Series
from simval.report.section import Context, Section, made
from simval.report.slope import order, simultaneous
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
"""Power of the noise with which what is left out should fall, as each name claims."""

NOISE = "noise of each unit vector, 1"
PARTS = (BIAS, COVARIANCE)


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("attitude")
    if not cells:
        return None
    groups = grouped(cells, "noise_std")
    shown, left_out = first(groups)
    names = slugs("attitude", shown)
    drawings = [
        _drawing(name, label, members)
        for name, (label, members) in zip(names, shown.items(), strict=True)
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
        found = curve("", cells, "noise_std", left_out(part, predictor))
        if found is None or not np.any(found.value > 0.0):
            continue
        if not series:
            series.append(_line(found.x, found.prediction, EXACT, f"the {part.words}"))
        series.append(_line(found.x, found.value, predictor, f"left out, {predictor}"))
    sampled = curve("", cells, "noise_std", moment(part, EXACT))
    if sampled is not None:
        series.append(
            Series(
                label="standard error",
                x=sampled.x,
                y=sampled.error,
                colour=GREY,
                line=":",
            )
        )
    return Panel(
        title=f"{part.words}: what is left out",
        x_label=NOISE,
        y_label="Frobenius norm, 1",
        series=tuple(series),
    )


def _line(x: np.ndarray, y: np.ndarray, predictor: str, label: str) -> Series:
    colour, style = STYLES[predictor]
    return Series(label=label, x=x, y=y, colour=colour, line=style)


def _drawing(name: str, label: str, cells: Sequence[CellResult]) -> Drawing:
    found = {part: curve("", cells, "noise_std", moment(part, EXACT)) for part in PARTS}
    z = simultaneous(sum(len(c.x) for c in found.values() if c is not None))
    panels = [_measured(part, cells, z) for part in PARTS]
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
            "standard error cannot be told from the exact answer by these samples."
        ),
        alternative=(
            f"{label + ': ' if label else ''}bias and covariance of the attitude error "
            "against the noise on logarithmic axes, simulated points beside predicted "
            "lines; and the distance of each truncated prediction from the exact one"
        ),
        panels=panels,
        columns=2,
    )


def _measured(part: Family, cells: Sequence[CellResult], z: float) -> Panel:
    series: list[Series] = []
    points = curve("simulated", cells, "noise_std", moment(part, EXACT))
    if points is not None:
        series.append(points.points(z))
    for predictor in STYLES:
        found = curve("", cells, "noise_std", moment(part, predictor))
        if found is not None:
            series.append(_line(found.x, found.prediction, predictor, predictor))
    return Panel(
        title=part.words,
        x_label=NOISE,
        y_label="Frobenius norm, 1",
        series=tuple(series),
    )


def _orders(groups: Mapping[str, Sequence[CellResult]]) -> Table:
    rows = []
    for label, cells in groups.items():
        for part in PARTS:
            for predictor, claimed in CLAIMED.items():
                found = curve("", cells, "noise_std", left_out(part, predictor))
                if found is None:
                    continue
                slope = order(found.x, found.value)
                at = (
                    ""
                    if len(found.x) < 2
                    else f"{found.x[0]:g} to {_second(found.x):g}"
                )
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
            Column("its name claims", "number"),
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
            found = curve(label, cells, "noise_std", moment(part, EXACT))
            if found is not None:
                rows.append((label, part.words, *slope_cells(found), 2.0))
    return Table(
        name="attitude-slopes",
        caption="Slopes of the simulated moments in the noise, with 95 % intervals",
        columns=(Column("cells"), Column("moment"), *SLOPES),
        rows=rows,
        shown=120,
    )
