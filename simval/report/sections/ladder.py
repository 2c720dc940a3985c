"""The bias ladder: what each residual of a calibration costs in bias."""

import numpy as np

from simval.report.curves import MAX_GROUPS, curve, grouped, statistic
from simval.report.measures import part
from simval.report.noise import curves, panel, slope_cells
from simval.report.panels import BarPanel, Drawing
from simval.report.section import Context, Section, made
from simval.report.slope import simultaneous
from simval.report.table import Column, Table
from simval.sweep.run import CellResult

NOISE = "noise of a pose mean, m/s²"
THEORY = "second order"


def section(context: Context) -> Section | None:
    """Make the section.

    Parameters
    ----------
    context : Context
        The run and its verdicts.

    Returns
    -------
    Section or None
        None where the run has no such study.
    """
    cells = [c for c in context.cells("ladder") if c.row("scale_bias", THEORY)]
    if not cells:
        return None
    groups = dict(list(grouped(cells, "noise_std").items())[:MAX_GROUPS])
    return made("ladder", "Bias ladder", [_drawing(groups)], [_table(groups)])


def _drawing(groups: dict[str, tuple[CellResult, ...]]) -> Drawing:
    found = curves(groups, part("bias", "K", THEORY))
    return Drawing(
        name="ladder",
        caption=(
            "Left: bias of the scale in units of σ²/g², at the smallest noise of each "
            "residual (bars with 95 % intervals for all together) and theory "
            "(diamonds); it does not fall with more poses. Right: bias of K, RMS over "
            "the axes, against the noise; expected slope 2. Hollow triangles: upper "
            "limits."
        ),
        alternative=(
            "Bias of the scale for each residual of the calibration beside theory, and "
            "bias against noise on logarithmic axes"
        ),
        panels=[_bars(groups), panel("bias of scale K", NOISE, "bias, 1", found)],
        columns=2,
    )


def _bars(groups: dict[str, tuple[CellResult, ...]]) -> BarPanel:
    rows = []
    for label, cells in groups.items():
        first = min(cells, key=lambda c: float(c.parameters["noise_std"]))
        row = first.row("scale_bias", THEORY)
        assert row is not None  # the section leaves out cells without it
        rows.append((label or first.parameters["residual"], row))
    z = simultaneous(len(rows))
    return BarPanel(
        title="the ladder",
        x_label="relative bias of the scale, σ²/g²",
        names=[name for name, _ in rows],
        measured=np.array([row.value for _, row in rows]),
        band=np.array([z * row.standard_error for _, row in rows]),
        predicted=np.array([row.prediction for _, row in rows], dtype=float),
    )


def _table(groups: dict[str, tuple[CellResult, ...]]) -> Table:
    rows = []
    for label, cells in groups.items():
        rungs = curve(label, cells, "noise_std", statistic("scale_bias", THEORY))
        many = curve(label, cells, "noise_std", statistic("scale_bias", "many poses"))
        slope = curve(label, cells, "noise_std", part("bias", "K", THEORY))
        assert rungs is not None  # the section leaves out cells without it
        slopes: tuple[str, float | None] = ("no bias at this order", None)
        if slope is not None:
            slopes = slope_cells(slope)
        rows.append(
            (
                label,
                (float(rungs.value[0]), float(rungs.error[0])),
                float(rungs.prediction[0]),
                None if many is None else float(many.prediction[0]),
                *slopes,
            )
        )
    return Table(
        name="ladder",
        caption="Bias of the scale in units of σ²/g², and its slope in the noise",
        columns=(
            Column("residual"),
            Column("measured", "measured"),
            Column("theory", "number"),
            Column("for many poses", "number"),
            Column("slope of K's bias (95 %)"),
            Column("of theory's own line", "number"),
        ),
        rows=rows,
    )
