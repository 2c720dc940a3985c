"""Calibration error against noise: T, K, B and together, bias and spread apart."""

from collections.abc import Sequence
from dataclasses import replace

from simval.report.curves import (
    Groups,
    Measure,
    bar_width,
    curves,
    first,
    grouped,
    statistic,
)
from simval.report.measures import GROUPS, part, together
from simval.report.noise import (
    SLOPES,
    panel,
    panels_of,
    rms_sets,
    slope_cells,
    together_z,
    unit_of,
)
from simval.report.panels import Drawing
from simval.report.section import Context, Section, Shown, made
from simval.report.table import Column, Table
from simval.statistics import (
    BIAS,
    CRAMER_RAO,
    FIRST_ORDER,
    RECOVERY,
    RMS,
    SD,
    SECOND_ORDER,
    Family,
)
from simval.sweep.run import CellResult

NOISE = "noise per sample, m/s²"
SHOWN = Shown("calibration", (RMS, SD, BIAS, RECOVERY))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("calibration")
    if not cells:
        return None
    noisy = [cell for cell in cells if cell.parameters["noise_std"] > 0.0]
    exact = [cell for cell in cells if cell.parameters["noise_std"] == 0.0]
    groups = grouped(noisy, "noise_std") if noisy else {}
    shown, left_out = first(groups)
    drawings = [
        replace(drawing, left_out=left_out)
        for drawing in (_rms(shown), _spread(shown), _bias(shown))
        if drawing is not None
    ]
    tables = [_slopes(groups)] if groups else []
    if exact:
        tables.append(_recoveries(exact))
    return made(
        "calibration",
        "Calibration error against noise",
        drawings,
        tables,
        groups=len(groups),
        shown=len(shown),
        seeds=len({cell.seed for cell in noisy}),
    )


def _rms(groups: Groups) -> Drawing | None:
    sets = rms_sets(groups)
    whole = curves(groups, together(FIRST_ORDER))
    if whole:
        bounds = curves(groups, together(CRAMER_RAO))
        sets.append(("together, B in units of g", "1", whole, bounds))
    if not sets:
        return None
    z = together_z(sets)
    return Drawing(
        name="calibration",
        caption=(
            "RMS error of T, K and B and of all nine parameters together. Points: "
            f"simulation; the bars ({z:.2f} standard errors) hold for all points of "
            "the figure together with 95 % confidence. Solid: theory (first-order "
            "covariance and second-order bias). Dotted: Cramér-Rao bound."
        ),
        alternative=(
            "RMS error of misalignment, scale, bias and all together against the noise "
            "per sample on logarithmic axes, simulated points beside predicted lines "
            "and the Cramér-Rao bound"
        ),
        panels=panels_of(sets, NOISE, z),
        columns=2,
    )


def _spread(groups: Groups) -> Drawing | None:
    return _apart(
        groups,
        SD,
        FIRST_ORDER,
        "calibration-sd",
        "standard deviation",
        "Standard deviation alone, RMS over the three entries. Expected slope: 1.",
    )


def _bias(groups: Groups) -> Drawing | None:
    return _apart(
        groups,
        BIAS,
        SECOND_ORDER,
        "calibration-bias",
        "bias",
        "Bias alone (estimate minus truth), projected on the direction that theory "
        "predicts. Hollow triangles: upper limits, where these trials cannot tell the "
        "bias from zero. Expected slope: 2.",
    )


def _apart(
    groups: Groups, family: Family, predictor: str, name: str, words: str, caption: str
) -> Drawing | None:
    sets = [(key, curves(groups, part(family, key, predictor))) for key in GROUPS]
    sets = [entry for entry in sets if entry[1]]
    if not sets:
        return None
    z = bar_width(c for _, measured in sets for c in measured)
    return Drawing(
        name=name,
        caption=f"{caption} Bars: {z:.2f} standard errors, 95 % for all together.",
        alternative=(
            f"{words.capitalize()} of T, K and B against the noise per sample on "
            "logarithmic axes, simulated points beside the predicted lines"
        ),
        panels=[
            panel(GROUPS[key], NOISE, f"{words}, {unit_of(key)}", measured, z=z)
            for key, measured in sets
        ],
    )


def _slopes(groups: Groups) -> Table:
    rows = []
    measures: list[tuple[str, int, Measure]] = [
        (f"rms of {n}", 1, statistic(RMS(n), FIRST_ORDER)) for n in GROUPS
    ]
    measures.append(("rms together", 1, together(FIRST_ORDER)))
    measures += [(f"sd of {n}", 1, part(SD, n, FIRST_ORDER)) for n in GROUPS]
    measures += [(f"bias of {n}", 2, part(BIAS, n, SECOND_ORDER)) for n in GROUPS]
    for words, expected, measure in measures:
        for c in curves(groups, measure):
            rows.append((words, c.label, *slope_cells(c), float(expected)))
    return Table(
        name="calibration-slopes",
        caption="Slopes in the noise, with 95 % intervals",
        columns=(Column("error"), Column("cells"), *SLOPES),
        rows=rows,
    )


def _recoveries(cells: Sequence[CellResult]) -> Table:
    rows = [
        (cell.name, str(row.statistic), row.value, row.prediction)
        for cell in cells
        for row in cell.rows
        if row.statistic.family == RECOVERY
    ]
    return Table(
        name="calibration-recovery",
        caption="Without noise: relative error of what was recovered, and its limit",
        columns=(
            Column("cell", "code"),
            Column("statistic"),
            Column("relative error", "number"),
            Column("limit", "number"),
        ),
        rows=rows,
        shown=60,
    )
