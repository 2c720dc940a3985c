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
from simval.report.findings import Claim, behind, claiming, limited, percent
from simval.report.measures import GROUPS, part, together
from simval.report.noise import (
    SLOPES,
    Set,
    fits,
    panel,
    panels_of,
    ratios_of,
    rms_sets,
    slope_fold,
    slope_words,
    together_z,
)
from simval.report.panels import Drawing
from simval.report.section import Context, Section, Shown, made
from simval.report.table import Column, Table
from simval.report.units import OF_A_CALIBRATION
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
        for drawing in (
            _rms(shown, noisy),
            _bias(shown, noisy),
            _spread(shown, noisy),
            _together(shown),
        )
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


def rms_claim(cells: Sequence[CellResult]) -> Claim:
    """That the RMS errors of calibrations are what theory says."""
    return Claim(subject="The RMS error", cells=cells, what=[RMS], by=FIRST_ORDER)


def _rms(groups: Groups, cells: Sequence[CellResult]) -> Drawing | None:
    sets = rms_sets(groups)
    if not sets:
        return None
    z = together_z(sets)
    drawing = Drawing(
        name="calibration",
        asked="Is the error what theory says, and at the Cramér-Rao bound?",
        caption=(
            "RMS error of T, K and B, and below it measured over predicted. Points: "
            f"simulation; the bars ({z:.2f} standard errors) hold for all points of "
            "the figure together with 95 % confidence. Line: theory (first-order "
            "covariance and second-order bias). Dotted: Cramér-Rao bound."
        ),
        alternative=(
            "RMS error of misalignment, scale and bias against the noise per sample on "
            "logarithmic axes, simulated points beside predicted lines and the "
            "Cramér-Rao bound; and the ratio of both on a linear axis"
        ),
        panels=panels_of(sets, NOISE, z),
    )
    return claiming(drawing, rms_claim(cells))


def _together(groups: Groups) -> Drawing | None:
    whole = curves(groups, together(FIRST_ORDER))
    if not whole:
        return None
    z, bounds = bar_width(whole), curves(groups, together(CRAMER_RAO))
    label = "RMS error, relative"
    return Drawing(
        name="calibration-together",
        fold="RMS error of all nine parameters together",
        caption=(
            "RMS error of all nine parameters, B in units of g. Bars: "
            f"{z:.2f} standard errors, 95 % for all together."
        ),
        alternative=(
            "RMS error of all nine parameters together against the noise per sample, "
            "beside theory and the Cramér-Rao bound, and over theory"
        ),
        panels=[
            panel("T, K and B / g", NOISE, label, whole, bounds, z),
            *ratios_of("T, K and B / g", NOISE, whole, bounds, z),
        ],
        columns=2,
    )


def _spread(groups: Groups, cells: Sequence[CellResult]) -> Drawing | None:
    sets = _sets(groups, SD, FIRST_ORDER)
    if not sets:
        return None
    words = "standard deviation"
    caption = "Standard deviation alone, RMS over the three entries."
    return behind(_apart(sets, "calibration-sd", words, caption), _scatter(cells))


def _scatter(cells: Sequence[CellResult]) -> Claim:
    said = "The standard deviation alone"
    return Claim(subject=said, cells=cells, what=[SD], by=FIRST_ORDER)


def _bias(groups: Groups, cells: Sequence[CellResult]) -> Drawing | None:
    sets = _sets(groups, BIAS, SECOND_ORDER)
    if not sets:
        return None
    claim = Claim(subject="The bias", cells=cells, what=[BIAS], by=SECOND_ORDER)
    below = 0 < claim.found.compared == claim.found.unseen
    caption = (
        "Bias alone (estimate minus truth), projected on the direction that theory "
        "predicts. Hollow triangles: upper limits, where these trials cannot tell "
        "the bias from zero; where no ratio is below, none can be seen."
    )
    drawing = replace(
        _apart(sets, "calibration-bias", "bias", caption),
        asked="Is there a bias, and is it what theory says?",
    )
    if not below:
        return claiming(drawing, claim)
    said = limited("The bias", claim, _scatter(cells), "the scatter")
    return replace(drawing, finding=said, claims=[claim])


def _sets(groups: Groups, family: Family, predictor: str) -> list[Set]:
    """Standard deviation or bias of T, K and B in the units of a person."""
    found: list[Set] = []
    for key, title in GROUPS.items():
        unit = OF_A_CALIBRATION[key]
        drawn = [c.scaled(unit) for c in curves(groups, part(family, key, predictor))]
        if drawn:
            found.append((title, unit, drawn, []))
    return found


def _apart(sets: Sequence[Set], name: str, words: str, caption: str) -> Drawing:
    z = together_z(sets)
    values = [
        panel(title, NOISE, f"{words}, {unit.name}", measured, z=z)
        for title, unit, measured, _ in sets
    ]
    below = [
        shown
        for title, _, measured, _ in sets
        for shown in ratios_of(title, NOISE, measured, [], z)
    ]
    return Drawing(
        name=name,
        caption=f"{caption} Bars: {z:.2f} standard errors, 95 % for all together.",
        alternative=(
            f"{words.capitalize()} of T, K and B against the noise per sample on "
            "logarithmic axes, simulated points beside the predicted lines"
        ),
        panels=[*values, *below],
    )


def _slopes(groups: Groups) -> Table:
    rows, found = [], []
    measures: list[tuple[str, int, Measure]] = [
        (f"rms of {n}", 1, statistic(RMS(n), FIRST_ORDER)) for n in GROUPS
    ]
    measures.append(("rms together", 1, together(FIRST_ORDER)))
    measures += [(f"sd of {n}", 1, part(SD, n, FIRST_ORDER)) for n in GROUPS]
    measures += [(f"bias of {n}", 2, part(BIAS, n, SECOND_ORDER)) for n in GROUPS]
    for words, expected, measure in measures:
        for c in curves(groups, measure):
            found.append(fits(c))
            rows.append((words, c.label, *slope_words(c, found[-1]), float(expected)))
    return Table(
        name="calibration-slopes",
        caption="Slopes in the noise, with 95 % intervals",
        columns=(Column("error"), Column("cells"), *SLOPES),
        rows=rows,
        fold=slope_fold(found),
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
        fold=_recovered(rows),
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


def _recovered(rows: Sequence[tuple[str, str, float, float | None]]) -> str:
    """Words of the fold of what is recovered without noise: none where one is not."""
    if any(not (most is not None and abs(value) <= most) for *_, value, most in rows):
        return ""
    most = max(abs(value) for *_, value, _ in rows) if rows else 0.0
    return f"Without noise all {len(rows)} are recovered, within {percent(most)}"
