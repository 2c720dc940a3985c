"""What each attitude estimator costs in accuracy, over many geometries."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simval.report.artifacts import arrays, is_left
from simval.report.findings import percent
from simval.report.panels import COLOURS, Drawing, Panel, Series
from simval.report.section import Context, Section, Shown, made
from simval.report.table import Column, Table
from simval.statistics import FIRST_ORDER, RMS_RATIO, SIMULATED_RMS_RATIO
from simval.sweep.run import CellResult

LINES = ("-", "--", ":", "-.")
SHOWN = Shown("attitude_efficiency", (RMS_RATIO, SIMULATED_RMS_RATIO))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("attitude_efficiency")
    if not cells:
        return None
    cell = cells[-1]  # its artifact was written last
    names = _names(cell)
    file = context.run.folder / "artifacts" / "attitude-efficiency.npz"
    drawings = []
    if is_left(file):
        simulated = np.atleast_2d(arrays(file).get("simulated", np.empty((0, 0))))
        if simulated.shape[1] == len(names) and simulated.size:
            others = [c.name for c in cells[:-1]]
            drawings = [replace(_drawing(names, simulated), left_out=others)]
    return made("estimators", "What an estimator costs", drawings, [_table(cells)])


def _drawing(names: list[str], ratios: np.ndarray) -> Drawing:
    share = (np.arange(len(ratios)) + 0.5) / len(ratios)
    series = tuple(
        Series(
            label=name,
            x=np.sort(column),
            y=share,
            colour=COLOURS[i % len(COLOURS)],
            line=LINES[i % len(LINES)],
        )
        for i, (name, column) in enumerate(zip(names, ratios.T, strict=True))
    )
    return Drawing(
        name="estimators",
        asked="What does an estimator cost that is not optimal?",
        finding=_costs(names, ratios),
        caption=(
            f"RMS error over that of the q-method on the same noise, in {len(ratios)} "
            "geometries: the share of geometries with at most the value on the axis. "
            "The q-method reaches the Cramér-Rao bound to first order."
        ),
        alternative=(
            "Distribution over geometries of each estimator's RMS error relative to "
            "the q-method"
        ),
        panels=[
            Panel(
                title="price of the closed form",
                x_label="RMS error / the q-method's",
                y_label="share of geometries",
                series=series,
                log_x=False,
                log_y=False,
            )
        ],
    )


def _costs(names: list[str], ratios: np.ndarray) -> str:
    """What each estimator costs in the median and at worst, in percent."""
    told = [
        f"{name} {percent(abs(float(np.median(column)) - 1.0))} "
        f"(at worst {percent(abs(float(column.max()) - 1.0))})"
        for name, column in zip(names, ratios.T, strict=True)
        if float(column.max()) > 1.0
    ]
    if not told:
        return ""
    return f"More error than the q-method's, in the median: {', '.join(told)}."


def _names(cell: CellResult) -> list[str]:
    return [
        row.statistic.entries[0]
        for row in cell.rows
        if row.statistic.family == SIMULATED_RMS_RATIO
        and row.statistic.entries[1] == "median"
    ]


def _table(cells: Sequence[CellResult]) -> Table:
    rows = []
    for cell, name in ((c, name) for c in cells for name in _names(c)):
        values = [
            None if (row := cell.row(statistic, predictor)) is None else row.value
            for statistic, predictor in (
                (RMS_RATIO(name, "median"), FIRST_ORDER),
                (SIMULATED_RMS_RATIO(name, "median"), ""),
                (RMS_RATIO(name, "worst"), FIRST_ORDER),
                (SIMULATED_RMS_RATIO(name, "worst"), ""),
            )
        ]
        rows.append((name, *values, cell.name))
    return Table(
        name="estimators",
        fold="Median and worst, by theory and simulated",
        caption="RMS error over the q-method's",
        columns=(
            Column("estimator"),
            Column("median, theory", "number"),
            Column("median, simulated", "number"),
            Column("worst, theory", "number"),
            Column("worst, simulated", "number"),
            Column("cell", "code"),
        ),
        rows=rows,
    )
