"""Magnetometer: variance of the weighted fit and of the usual recipe over the bound."""

from simval.report.curves import MAX_GROUPS, bars, grouped
from simval.report.panels import BarPanel, Drawing
from simval.report.section import Context, Section, Shown, made
from simval.report.words import spelled
from simval.statistics import VARIANCE_OVER_BOUND
from simval.sweep.run import CellResult

SHOWN = Shown("magnetometer", (VARIANCE_OVER_BOUND,))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("magnetometer")
    if not cells:
        return None
    groups = grouped(cells)
    labels = list(groups)
    shown = [group[0] for group in groups.values()][:MAX_GROUPS]
    drawing = Drawing(
        name="magnetometer",
        caption=(
            "Variance over the Cramér-Rao bound, mean over the entries of a matrix or "
            "vector: the weighted fit of all 22 parameters, which reaches 1, and the "
            "usual recipe, an ellipsoid for each sensor and then the turn between "
            "them. Bars: measured, with 95 % intervals that hold for all bars of a "
            "panel together. Diamonds: predicted."
        ),
        alternative=(
            "Variance of the weighted fit and of the usual recipe over the bound, "
            "measured beside predicted, for matrix, hard iron and dip"
        ),
        panels=[
            _panel(cell, label) for cell, label in zip(shown, labels, strict=False)
        ],
        columns=2,
        left_out=labels[MAX_GROUPS:],
    )
    return made("magnetometer", "Magnetometer", [drawing])


def _panel(cell: CellResult, label: str) -> BarPanel:
    rows = [r for r in cell.rows if r.statistic.family == VARIANCE_OVER_BOUND]
    return bars(
        rows,
        [", ".join(row.statistic.entries) for row in rows],
        label or spelled(cell.study),
        "variance over the bound, 1",
    )
