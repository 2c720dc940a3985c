"""Error budget: what each source of error contributes, measured and predicted."""

import re

import numpy as np

from simval.report.curves import MAX_GROUPS, grouped
from simval.report.panels import BarPanel, Drawing
from simval.report.section import Context, Section, made
from simval.report.slope import simultaneous
from simval.sweep.run import CellResult

PART = re.compile(r"budget\[(.+)\]")


def section(context: Context) -> Section | None:
    """Make the section.

    Parameters
    ----------
    context : Context
        The run and its verdicts.

    Returns
    -------
    Section or None
        None where no study has rows ``budget[part]``.
    """
    cells = [
        cell
        for cell in context.run.cells
        if any(PART.fullmatch(row.statistic) for row in cell.rows)
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
    rows = [row for row in cell.rows if PART.fullmatch(row.statistic)]
    rows = list({row.statistic: row for row in rows}.values())
    z = simultaneous(len(rows))
    return BarPanel(
        title=label or cell.study.replace("_", " "),
        x_label=f"contribution, {rows[0].unit}",
        names=[PART.fullmatch(row.statistic)[1] for row in rows],  # type: ignore[index]
        measured=np.array([row.value for row in rows]),
        band=np.array([z * row.standard_error for row in rows]),
        predicted=np.array(
            [np.nan if row.prediction is None else row.prediction for row in rows]
        ),
    )
