"""Convergence order: how fast each attitude formula becomes exact."""

from dataclasses import replace

import numpy as np

from simval.report.curves import first, grouped
from simval.report.findings import order_words
from simval.report.panels import Drawing, Panel
from simval.report.section import Context, Section, Shown, made
from simval.report.sections.attitude import CLAIMED, line
from simval.report.table import Column, Table
from simval.statistics import BIAS_ERROR, BIAS_ORDER, COVARIANCE_ERROR, COVARIANCE_ORDER
from simval.sweep.run import CellResult

PARTS = {
    "bias": (BIAS_ORDER, BIAS_ERROR),
    "covariance": (COVARIANCE_ORDER, COVARIANCE_ERROR),
}
"""Slope and distance of each moment."""
SHOWN = Shown(
    "attitude_order", (BIAS_ERROR, BIAS_ORDER, COVARIANCE_ERROR, COVARIANCE_ORDER)
)


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("attitude_order")
    if not cells:
        return None
    groups, left_out = first(grouped(cells, "geometry"))
    table = _table(cells)
    said = order_words(
        (row[2], slope, row[6]) for row in table.rows for slope in (row[4], row[5])
    )
    caption = (
        "Relative distance of each formula from the truth (the exact oracle, or "
        "cubature for noise that is not isotropic), a line for each geometry, "
        "computed without sampling. On this scale the second order has slope 2, "
        "the complete fourth order slope 4, one more order of σ² each; the "
        "source's fourth order falls like the second, because it leaves out terms "
        "of its own order. The table has the slopes of the distance itself."
    )
    covariance, bias = (
        Drawing(
            name=name,
            asked="How fast does each formula become exact?" if shown else "",
            finding=f"{said}." if shown else "",
            fold="" if shown else f"The same of the {part}",
            caption=caption,
            alternative=(
                f"Distance of the {part} by the second order, the source's fourth "
                "order and the complete fourth order from the truth, against the "
                "noise on logarithmic axes"
            ),
            panels=[_panel(part, label, own) for label, own in groups.items()],
            left_out=left_out,
        )
        for name, part, shown in (
            ("orders", "covariance", True),
            ("orders-bias", "bias", False),
        )
    )
    folded = replace(table, fold="Slopes of every formula, noise and moment")
    return made(
        "orders", "Order of the attitude formulas", [covariance, bias], [folded]
    )


def _points(cell: CellResult, part: str, predictor: str) -> tuple[np.ndarray, ...]:
    points = [
        (float(row.statistic.entries[0]), row.value)
        for row in cell.rows
        if row.predictor == predictor and row.statistic.family == PARTS[part][1]
    ]
    return tuple(np.array(sorted(points), dtype=float).reshape(-1, 2).T)


def _panel(part: str, label: str, cells: tuple[CellResult, ...]) -> Panel:
    series = []
    for predictor in CLAIMED:
        for i, cell in enumerate(cells):
            x, y = _points(cell, part, predictor)
            # both moments are of the size of the noise squared
            series.append(line(x, y / x**2, predictor, "" if i else predictor))
    return Panel(
        title=f"{part}{': ' if label else ''}{label}",
        x_label="noise of each unit vector, relative",
        y_label="distance / σ²",
        series=tuple(series),
    )


def _table(cells: tuple[CellResult, ...]) -> Table:
    groups = grouped(cells, "geometry")
    rows = []
    for label, members in groups.items():
        for part in PARTS:
            for predictor, claimed in CLAIMED.items():
                slopes = [
                    row.value
                    for cell in members
                    if (row := cell.row(PARTS[part][0](), predictor)) is not None
                ]
                if slopes:
                    ends = (len(slopes), min(slopes), max(slopes))
                    rows.append((label, part, predictor, *ends, claimed))
    return Table(
        name="orders",
        caption="Slope of what each formula leaves out, over all geometries",
        columns=(
            Column("noise"),
            Column("moment"),
            Column("formula"),
            Column("geometries", "number"),
            Column("least slope", "number", 5),
            Column("greatest slope", "number", 5),
            Column("stated order", "number"),
        ),
        rows=rows,
    )
