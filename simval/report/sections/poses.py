"""Calibration error against the number of poses, and the geometry of the poses."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simval.report.curves import MAX_GROUPS, Groups, curves, first, grouped, statistic
from simval.report.findings import agrees
from simval.report.measures import together
from simval.report.noise import (
    Set,
    fits,
    measured_of,
    panels_of,
    rms_sets,
    slope_fold,
    slope_words,
    together_z,
)
from simval.report.panels import Drawing, Panel
from simval.report.section import Context, Section, Shown, made
from simval.report.table import Column, Table
from simval.statistics import CONDITION, FIRST_ORDER

COUNT = "number of poses"
SHOWN = Shown("scene", (CONDITION,))


def section(context: Context) -> Section | None:
    """Make the section."""
    noisy = [
        cell
        for cell in context.cells("calibration")
        if cell.parameters["noise_std"] > 0.0
    ]
    groups = {
        label: cells
        for label, cells in grouped(noisy, "poses").items()
        if len({cell.parameters["poses"] for cell in cells}) > 1
    }
    shown, left_out = first(groups)
    error = _error(shown)
    errors = [] if error is None else [replace(error, left_out=left_out)]
    geometry = _geometry(context)
    drawings = errors if geometry is None else [*errors, geometry]
    if not drawings:
        return None
    tables = [_slopes(groups)] if groups else []
    return made(
        "poses",
        "Number and geometry of the poses",
        drawings,
        tables,
        groups=len(groups),
        shown=len(shown),
    )


def _error(groups: Groups) -> Drawing | None:
    sets = rms_sets(groups, "poses")
    if not sets:
        return None
    z = together_z(sets)
    return Drawing(
        name="poses",
        asked="How many poses are needed?",
        finding=_gained(sets) + agrees("The RMS error", measured_of(sets), at="poses"),
        caption=(
            "RMS error against the number of poses, for each noise level, and below it "
            "measured over predicted. Expected "
            "slope: -1/2 once the directions are spread evenly. Bars: "
            f"{z:.2f} standard errors, 95 % for all together; dotted: Cramér-Rao bound."
        ),
        alternative=(
            "RMS error of misalignment, scale and bias against the number of poses on "
            "logarithmic axes, beside theory and the Cramér-Rao bound, and over theory"
        ),
        panels=panels_of(sets, COUNT, z),
    )


def _gained(sets: Sequence[Set]) -> str:
    """What more poses gain, from theory's line of the first curve."""
    c = measured_of(sets)[0]
    last = len(c.x) - 1
    gain = c.prediction[0] / c.prediction[last]
    if not (np.isfinite(gain) and c.x[last] > c.x[0]):
        return ""
    return (
        f"{c.x[last]:g} poses instead of {c.x[0]:g}: {gain:.2g} times more accurate. "
    )


def _geometry(context: Context) -> Drawing | None:
    cells = [c for c in context.cells("scene") if c.row(CONDITION()) is not None]
    scenes = curves(grouped(cells, "poses"), statistic(CONDITION()), "poses")
    finite = [c for c in scenes if np.isfinite(c.value).all()]
    if not any(len(np.unique(c.x)) > 1 for c in finite):
        return None  # a single point is in the numbers; it is no curve
    return Drawing(
        name="poses-condition",
        fold="Condition number of the calibration, for each scene",
        caption=(
            "Condition number of the calibration's normalised Jacobian: how many times "
            "worse the worst determined combination of parameters is than the best."
        ),
        alternative="Condition number against the number of poses, for each scene",
        panels=[
            Panel(
                title="geometry of the poses",
                x_label=COUNT,
                y_label="condition number",
                series=tuple(
                    c.points(0.0, i) for i, c in enumerate(finite[:MAX_GROUPS])
                ),
            )
        ],
        left_out=[c.label for c in finite[MAX_GROUPS:]],
    )


def _slopes(groups: Groups) -> Table:
    drawn = curves(groups, together(FIRST_ORDER), "poses")
    found = [fits(c) for c in drawn]
    rows = [
        (c.label, *slope_words(c, fit), -0.5)
        for c, fit in zip(drawn, found, strict=True)
    ]
    return Table(
        name="poses-slopes",
        fold=slope_fold(found),
        caption="Slope of the RMS error of all parameters in the number of poses",
        columns=(
            Column("cells"),
            Column("fitted (95 %)"),
            Column("of theory's own line", "number"),
            Column("for many poses", "number"),
        ),
        rows=rows,
        shown=60,
    )
