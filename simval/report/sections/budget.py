"""Error budget: what each source of error contributes, measured and predicted."""

from simval.report.curves import MAX_GROUPS, bars, grouped
from simval.report.panels import BarPanel, Drawing
from simval.report.section import Context, Section, Shown, made
from simval.report.words import spelled
from simval.statistics import BUDGET
from simval.sweep.run import CellResult

SHOWN = Shown("end_to_end", (BUDGET,))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = [
        cell
        for cell in context.run.cells
        if any(row.statistic.family == BUDGET for row in cell.rows)
    ]
    if not cells:
        return None
    groups = grouped(cells)
    labels = list(groups)
    members = [group[0] for group in groups.values()]
    shown = members[:MAX_GROUPS]
    drawing = Drawing(
        name="budget",
        caption=(
            "Bars: measured, with 95 % intervals that hold for all bars of a panel "
            "together. Diamonds: predicted, carried from the noise through the "
            "calibration to the attitude."
        ),
        alternative="Contribution of each source of error, measured and predicted",
        panels=[
            _panel(cell, label) for cell, label in zip(shown, labels, strict=False)
        ],
        columns=2,
        left_out=[cell.name for cell in cells if cell not in shown],
    )
    return made(
        "budget", "Error budget", [drawing], cells=len(members), shown=len(shown)
    )


def _panel(cell: CellResult, label: str) -> BarPanel:
    rows = [row for row in cell.rows if row.statistic.family == BUDGET]
    rows = list({row.statistic: row for row in rows}.values())
    return bars(
        rows,
        [row.statistic.entries[0] for row in rows],
        label or spelled(cell.study),
        f"contribution, {rows[0].unit}",
    )
