"""Attitude error against noise: bias and covariance beside every prediction."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from simval.report import palette
from simval.report.curves import Curve, Measure, bar_width, curve, first, grouped
from simval.report.findings import Claim, behind, claiming, order_words
from simval.report.measures import left_out, moment
from simval.report.noise import SLOPES, Fits, fits, slope_fold, slope_words
from simval.report.panels import GREY, Drawing, Panel, Series
from simval.report.ratio import ratio_panel
from simval.report.section import Context, Section, Shown, made
from simval.report.slope import order
from simval.report.table import Column, Table
from simval.report.units import RELATIVE, Unit
from simval.report.words import FORMULAS, slugs
from simval.statistics import (
    BIAS,
    COVARIANCE,
    EXACT,
    ORDER_2,
    ORDER_4,
    ORDER_4_SOURCE,
    RMS,
    UNIT_LENGTH,
    Family,
)
from simval.sweep.run import CellResult

STYLES = {
    ORDER_2: (palette.ORDER_2, "--"),
    ORDER_4_SOURCE: (palette.ORDER_4_SOURCE, "-."),
    ORDER_4: (palette.ORDER_4_COMPLETE, "-"),
    EXACT: (palette.EXACT, ":"),
}
CLAIMED = {ORDER_2: 4.0, ORDER_4_SOURCE: 6.0, ORDER_4: 6.0}
"""Order of what each formula leaves out, by its stated order."""

NOISE = "noise of each unit vector, relative"
PARTS = (BIAS, COVARIANCE)
SHOWN = Shown("attitude", (BIAS, COVARIANCE, UNIT_LENGTH))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("attitude")
    if not cells:
        return None
    groups = grouped(cells, "noise_std")
    shown, left_out = first(groups)
    drawings = [
        _drawing(name, label, shown[label], () if i else cells)
        for i, (name, label) in enumerate(
            zip(slugs("attitude", shown), shown, strict=True)
        )
    ]
    drawings[-1] = replace(drawings[-1], left_out=left_out)
    return made(
        "attitude",
        "Attitude error against noise",
        drawings,
        [_orders(groups), _slopes(groups), _unit_lengths(cells)],
        groups=len(groups),
        shown=len(shown),
    )


def remainders(cells: Sequence[CellResult], part: Family) -> list[Panel]:
    """What each truncated formula leaves out, beside the moment; none without any."""
    series: list[Series] = []
    for predictor in CLAIMED:
        c = curve("", cells, "noise_std", left_out(part, predictor))
        if c is None or not np.any(c.value > 0.0):
            continue
        if not series:
            series.append(line(c.x, c.prediction, EXACT, f"the {part.words}"))
        series.append(line(c.x, c.value, predictor, predictor))
    if not series:
        return []
    sampled = curve("", cells, "noise_std", moment(part, EXACT))
    if sampled is not None:
        dotted = Series(
            label="standard error", x=sampled.x, y=sampled.error, colour=GREY, line=":"
        )
        series.append(dotted)
    title = f"{part.words}: what is left out"
    return [_panel(title, "norm of what is left out", series)]


def beside_predictions(
    cells: Sequence[CellResult],
    measure_against: Callable[[str], Measure],
    z: float | None = None,
    unit: Unit = RELATIVE,
) -> list[Series]:
    """Simulated points over the noise, and a line for each prediction."""
    series = []
    points = curve("simulated", cells, "noise_std", measure_against(EXACT))
    if points is not None:
        bars = bar_width([points]) if z is None else z
        series.append(points.scaled(unit).points(bars))
    for predictor in STYLES:
        c = curve("", cells, "noise_std", measure_against(predictor))
        if c is not None:
            y = unit.factor * c.prediction
            series.append(line(c.x, y, predictor, predictor))
    return series


def line(x: np.ndarray, y: np.ndarray, predictor: str, label: str) -> Series:
    """A line in the style of its prediction."""
    colour, style = STYLES[predictor]
    words = FORMULAS.get(label, label)
    return Series(label=words, x=x, y=y, colour=colour, line=style)


def _panel(title: str, y_label: str, series: Sequence[Series]) -> Panel:
    return Panel(
        title=title,
        x_label=NOISE,
        y_label=y_label,
        series=tuple(series),
    )


def _drawing(
    name: str, label: str, cells: Sequence[CellResult], every: Sequence[CellResult]
) -> Drawing:
    """Figure of one geometry; the first says what is so of `every` cell."""
    sampled = [curve("", cells, "noise_std", moment(part, EXACT)) for part in PARTS]
    curves = [c for c in sampled if c is not None]
    z = bar_width(curves)
    panels: list[Panel] = []
    for part, c in zip(PARTS, sampled, strict=True):
        series = beside_predictions(cells, partial(moment, part), z)
        panels.append(_panel(part.words, f"norm of the {part.words}", series))
        panels += _over_exact(part, cells, c, z)
        panels += remainders(cells, part)
    place = f"{label}: " if label else ""
    drawing = Drawing(
        name=name,
        caption=(
            f"{_begun(f'{place}left')}, bias and covariance of the "
            f"simulated error (bars: {z:.2f} standard errors, 95 % for all points of "
            "the figure together) beside theory; in the middle the same over the exact "
            "theory, where each formula can be seen to leave it. Right, how far each "
            "truncated formula is from the exact answer, computed without sampling: "
            "the moment itself has slope 2, what the second order leaves out slope 4, "
            "what the complete fourth order leaves out slope 6. What lies below the "
            "dotted standard error cannot be told from the exact answer with these "
            "samples."
        ),
        alternative=(
            f"{_begun(f'{place}bias')} and covariance of the attitude error "
            "against the noise on logarithmic axes, simulated points beside predicted "
            "lines; both over the exact theory on a linear axis; and the distance of "
            "each truncated prediction from the exact one"
        ),
        panels=panels,
    )
    asked = "Are bias and covariance what theory says?"
    claims = [_claim(f"The {part.words}", every or cells, part) for part in PARTS[::-1]]
    if not every:
        return behind(drawing, *claims, asked=asked, before=_begun(place))
    return claiming(replace(drawing, asked=asked), *claims)


def rms_claim(cells: Sequence[CellResult]) -> Claim:
    """That the RMS errors of attitudes are those of the exact theory."""
    return _claim("The RMS error", cells, RMS)


def _claim(subject: str, cells: Sequence[CellResult], family: Family) -> Claim:
    exact = "the exact theory"
    return Claim(subject=subject, cells=cells, what=[family], by=EXACT, theory=exact)


def _begun(words: str) -> str:
    return words[:1].upper() + words[1:]


def _over_exact(
    part: Family, cells: Sequence[CellResult], sampled: Curve | None, z: float
) -> list[Panel]:
    """Simulation and every formula over the exact theory."""
    if sampled is None:
        return []
    lines = []
    for predictor in CLAIMED:
        c = curve("", cells, "noise_std", moment(part, predictor))
        if c is not None and np.array_equal(c.x, sampled.x):
            over = c.prediction / sampled.prediction
            lines.append(line(c.x, over, predictor, predictor))
    title = f"{part.words} over the exact theory"
    found = ratio_panel(title, NOISE, [sampled], z, lines)
    return [] if found is None else [replace(found, height=1.0)]


def _orders(groups: Mapping[str, Sequence[CellResult]]) -> Table:
    rows = []
    for label, cells in groups.items():
        for part in PARTS:
            for predictor, claimed in CLAIMED.items():
                c = curve("", cells, "noise_std", left_out(part, predictor))
                if c is None:
                    continue
                at = f"{c.x[0]:g} to {_second(c.x):g}" if len(c.x) > 1 else ""
                slope = order(c.x, c.value)
                rows.append((label, part.words, predictor, at, slope, claimed))
    return Table(
        name="attitude-orders",
        fold=order_words((row[2], row[4], row[5]) for row in rows),
        caption=(
            "Order of each formula: slope of what it leaves out at the two smallest "
            "noise levels, without sampling"
        ),
        columns=(
            Column("cells"),
            Column("moment"),
            Column("formula"),
            Column("noise"),
            Column("slope", "number", 5),
            Column("stated order", "number"),
        ),
        rows=rows,
        shown=120,
    )


def _unit_lengths(cells: Sequence[CellResult]) -> Table:
    kinds = ("simulated", EXACT, ORDER_4, ORDER_2, ORDER_4_SOURCE)
    rows = []
    for cell in cells:
        found = {
            row.statistic.entries[0]: row.value
            for row in cell.rows
            if row.statistic.family == UNIT_LENGTH
        }
        if not found:
            continue
        geometry, noise = cell.parameters["geometry"], cell.parameters["noise_std"]
        values = (found.get(kind) for kind in kinds)
        rows.append((geometry, float(noise), *values))
    return Table(
        name="unit-length",
        fold=_lengths(kinds, rows),
        caption=(
            "Unit length: truth and estimate have length 1, so tr C + |m|² = 2 q'm "
            "for the bias m and covariance C of truth less estimate. Relative defect: "
            "rounding for samples and the exact answer, what it leaves out for a "
            "truncated formula"
        ),
        columns=(
            Column("geometry", "number", 19),
            Column("noise", "number"),
            *(Column(kind, "number", 3) for kind in kinds),
        ),
        rows=rows,
        shown=120,
    )


def _lengths(kinds: Sequence[str], rows: Sequence[Sequence[float | None]]) -> str:
    """The greatest defect of the unit length, in words."""
    told = []
    for i, kind in enumerate(kinds):
        values = [value for row in rows if (value := row[i + 2]) is not None]
        if values:
            told.append(f"{FORMULAS.get(kind, kind)} {max(values):.1e}")
    return f"Unit length, greatest relative defect: {'; '.join(told)}" if told else ""


def _second(x: np.ndarray) -> float:
    distinct = np.unique(x)
    return float(distinct[min(1, len(distinct) - 1)])


def _slopes(groups: Mapping[str, Sequence[CellResult]]) -> Table:
    rows = []
    found: list[Fits] = []
    for label, cells in groups.items():
        for part in PARTS:
            c = curve(label, cells, "noise_std", moment(part, EXACT))
            if c is not None:
                found.append(fits(c))
                rows.append((label, part.words, *slope_words(c, found[-1]), 2.0))
    return Table(
        name="attitude-slopes",
        fold=slope_fold(found),
        caption="Slopes of the simulated moments in the noise, with 95 % intervals",
        columns=(Column("cells"), Column("moment"), *SLOPES),
        rows=rows,
        shown=120,
    )
