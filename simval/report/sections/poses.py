"""Calibration error against the number of poses, and the geometry of the poses."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simval.report.curves import MAX_GROUPS, Groups, curves, first, grouped, statistic
from simval.report.measures import together
from simval.report.noise import (
    Set,
    drawn,
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
    error = _error(groups)
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
    shown = drawn(sets)
    z = together_z(shown)
    return Drawing(
        name="poses",
        asked="How many poses are needed?",
        finding=_gained(sets),
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
        panels=panels_of(shown, COUNT, z),
    )


def _gained(sets: Sequence[Set]) -> str:
    """What more poses gain, from all of theory's lines between the same two numbers."""
    every = measured_of(sets)
    few, many = min(c.x[0] for c in every), max(c.x[-1] for c in every)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        found = [
            c.prediction[0] / c.prediction[-1]
            for c in every
            if (c.x[0], c.x[-1]) == (few, many)
        ]
    if not (found and np.isfinite(found).all() and many > few):
        return ""
    gains = dict.fromkeys(f"{end:.2g}" for end in (min(found), max(found)))
    return (
        f"{many:g} poses instead of {few:g}: {' to '.join(gains)} times more accurate "
        "by theory."
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
    measured = curves(groups, together(FIRST_ORDER), "poses")
    found = [fits(c) for c in measured]
    rows = [
        (c.label, *slope_words(c, fit), -0.5)
        for c, fit in zip(measured, found, strict=True)
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
