"""Attitude error against closeness to singularity, which limits each formula."""

from dataclasses import replace

import numpy as np

from simval.report.curves import Curve, bar_width, curve, statistic
from simval.report.findings import claiming
from simval.report.measures import left_out
from simval.report.notes import Measured
from simval.report.panels import Drawing, Panel, Series
from simval.report.ratio import ratio_panel
from simval.report.section import Context, Section, Shown, made
from simval.report.sections.attitude import CLAIMED, STYLES, rms_claim
from simval.report.table import Column, Table
from simval.report.words import FORMULAS
from simval.statistics import (
    COVARIANCE,
    EXACT,
    FLIP_RATE,
    LIMIT_RATIO,
    NORM_OVER_NOISE,
    ORDER_2,
    ORDER_4,
    ORDER_4_SOURCE,
    OTHER_SELECTION_RATE,
    RMS,
)
from simval.sweep.run import CellResult

LENGTH = NORM_OVER_NOISE()
AXIS = NORM_OVER_NOISE.name
MARKS = {ORDER_2: "o", ORDER_4_SOURCE: "s", ORDER_4: "^"}
SHOWN = Shown("attitude_limits", (LIMIT_RATIO, FLIP_RATE, OTHER_SELECTION_RATE))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = [c for c in context.cells("attitude") if c.row(LENGTH) is not None]
    limits = context.cells("attitude_limits")
    drawings = [_closeness(cells)] if cells else []
    tables = []
    if limits:
        drawings.append(_limits(limits))
        tables.append(_table(limits))
    if not drawings:
        return None
    return made("closeness", "Closeness to singularity", drawings, tables)


def _closeness(cells: list[CellResult]) -> Drawing:
    growth = _over_noise(cells)
    drawing = Drawing(
        name="closeness",
        asked="What does a geometry near a singular one cost?",
        caption=(
            "All geometries and noise levels in one figure, over the length of the "
            "un-normalised quaternion, at the left in units of the noise: singular is "
            "to the left. Left: how far each formula's covariance is from the exact "
            "one. Then RMS error over the noise, simulated and exact, and one over "
            "the other."
        ),
        alternative=(
            "Relative distance of each predicted covariance from the exact one, and "
            "RMS error over noise, against the closeness to singularity"
        ),
        panels=[_formulas(cells), *_growth(growth)],
    )
    return claiming(drawing, rms_claim(cells))


def _limits(cells: tuple[CellResult, ...]) -> Drawing:
    panels = []
    for part in ("bias", "covariance"):
        series = []
        for predictor in CLAIMED:
            colour, line = STYLES[predictor]
            for share, style in (("1%", line), ("10%", ":")):
                name = LIMIT_RATIO(part, share)
                c = curve("", cells, "norm", statistic(name, predictor))
                if c is not None:
                    label = FORMULAS[predictor] if share == "1%" else ""
                    plain = Series(
                        label="", x=c.x, y=c.value, colour=colour, line=style
                    )
                    series += [
                        plain,
                        replace(plain, label=label, line="", marker=MARKS[predictor]),
                    ]
        panels.append(
            Panel(
                title=f"{part}: least |q̄| / σ",
                x_label="|q̄|",
                y_label="|q̄| / σ",
                series=tuple(series),
                log_x=False,
            )
        )
    return Drawing(
        name="limits",
        asked="From where on does a formula hold?",
        finding=_farthest(cells),
        caption=(
            "How far from singular a geometry must be, in units of the noise, for each "
            "formula to be within 1 %, and within 10 % (dotted), of the exact answer."
        ),
        alternative=(
            "Least ratio of |q̄| to the noise at which each formula is within 1 % and "
            "10 % of the exact answer, for geometries of different |q̄|"
        ),
        panels=panels,
        columns=2,
    )


def _table(cells: tuple[CellResult, ...]) -> Table:
    rows = []
    for cell in cells:
        flips = cell.row(FLIP_RATE(), EXACT)
        other = cell.row(OTHER_SELECTION_RATE())
        if flips is None or other is None:
            continue
        rows.append(
            (
                float(cell.parameters["norm"]),
                float(cell.parameters["ratio"]),
                (flips.value, flips.standard_error),
                flips.prediction,
                (other.value, other.standard_error),
            )
        )
    return Table(
        name="limits",
        fold="How often the raw sign flips, and how often free selection differs",
        caption="How often the raw sign flips, and how often free selection differs",
        columns=(
            Column("|q̄|", "number"),
            Column("|q̄| / σ", "number"),
            Column("flip rate", "measured"),
            Column("exact", "number"),
            Column("another frame selected", "measured"),
        ),
        rows=rows,
    )


def _formulas(cells: list[CellResult]) -> Panel:
    series = []
    for predictor in CLAIMED:
        c = curve(predictor, cells, AXIS, left_out(COVARIANCE, predictor))
        if c is None:
            continue
        colour, marker = STYLES[predictor][0], MARKS[predictor]
        ratio = c.value / c.prediction
        series.append(
            Series(
                label=FORMULAS[predictor], x=c.x, y=ratio, colour=colour, marker=marker
            )
        )
    return Panel(
        title="where a formula may be used",
        x_label="|q̄| / σ",
        y_label="difference from exact, relative",
        series=tuple(series),
        references=((0.1, "10 %"), (0.01, "1 %")),
    )


def _over_noise(cells: list[CellResult]) -> Curve | None:
    """RMS error in units of the noise, over the length of the quaternion."""

    def over_noise(cell: CellResult) -> Measured | None:
        row = cell.row(RMS(), EXACT)
        if row is None or row.prediction is None:
            return None
        sigma = float(cell.parameters["noise_std"])
        value, error = row.value / sigma, row.standard_error / sigma
        return Measured(value, error, row.prediction / sigma, n=row.n)

    c = curve("simulated", cells, AXIS, over_noise)
    if c is None:
        return None
    lengths = curve("", cells, AXIS, _length)
    assert lengths is not None  # the axis itself is a row of these cells
    return replace(c, x=lengths.value)


def _growth(c: Curve | None) -> list[Panel]:
    series: list[Series] = []
    below: list[Panel] = []
    if c is not None:
        order = np.argsort(c.x, kind="stable")
        z = bar_width([c])
        series = [
            c.points(z),
            Series(
                label="exact",
                x=c.x[order],
                y=c.prediction[order],
                colour=STYLES[EXACT][0],
                marker="+",
            ),
        ]
        found = ratio_panel("simulated over exact", "|q̄|", [c], z)
        below = [] if found is None else [replace(found, height=1.0)]
    return [
        Panel(
            title="what closeness costs",
            x_label="|q̄|",
            y_label="RMS error / σ",
            series=tuple(series),
        ),
        *below,
    ]


def _farthest(cells: tuple[CellResult, ...]) -> str:
    """The least ratio at which each formula is within 1 % in every geometry."""
    told = []
    for predictor in CLAIMED:
        c = curve(
            "", cells, "norm", statistic(LIMIT_RATIO("covariance", "1%"), predictor)
        )
        if c is not None:
            told.append(f"{float(c.value.max()):.3g} ({FORMULAS[predictor]})")
    if not told:
        return ""
    return f"The covariance is within 1 % where |q̄| / σ is at least {', '.join(told)}."


def _length(cell: CellResult) -> tuple[float, float, float] | None:
    """Length of the un-normalised quaternion, from its length in units of noise."""
    row = cell.row(LENGTH)
    if row is None or cell.row(RMS(), EXACT) is None:
        return None
    return row.value * float(cell.parameters["noise_std"]), 0.0, np.nan
