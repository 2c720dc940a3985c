"""Leading errors over many geometries: which attitude formula is nearer, how often."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.report.artifacts import arrays, shaped
from simval.report.curves import MAX_GROUPS
from simval.report.distribution import share_at_most
from simval.report.panels import COLOURS, Drawing, Panel, Series
from simval.report.section import Context, Section, made
from simval.report.sections.attitude import STYLES
from simval.report.table import Column, Table
from simval.statistics import (
    EXACT,
    LEADING_ERROR_RATIO,
    LEADING_TERM_OFF,
    NEARER,
    ORDER_2,
    ORDER_2_PRINTED,
    ORDER_4_SOURCE,
)
from simval.sweep.run import CellResult

DRAWN = {
    ORDER_4_SOURCE: STYLES[ORDER_4_SOURCE],
    ORDER_2_PRINTED: (COLOURS[1], "-"),
}
Ratios = Mapping[str, Array]
"""Of each formula, one for each geometry."""

QUANTILES = ("least", "5%", "median", "95%", "most")
ZERO = 1e-4
"""The study knows the leading error to this share, so a smaller ratio may be 0."""


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("attitude_geometries")
    if not cells:
        return None
    folder = context.run.folder / "artifacts"
    found = [(cell, r) for cell in cells if (r := _ratios(folder, cell)) is not None]
    shown = found[:MAX_GROUPS]
    names = {cell.name for cell, _ in shown}
    rest = [cell.name for cell in cells if cell.name not in names]
    drawings = [_drawing(shown, rest)] if shown else []
    return made("geometries", "Nearer to the truth, or not", drawings, [_table(cells)])


def _ratios(folder: Path, cell: CellResult) -> Ratios | None:
    """Ratio of each formula in each geometry, as the study left them."""
    noise, frame, count = (
        cell.parameters[key] for key in ("noise", "frame", "geometries")
    )
    file = folder / f"attitude-geometries-{noise}-{frame}-{count}.npz"
    if not file.is_file():
        return None
    content = arrays(file)
    return {name: shaped(file, content, name, count) for name in DRAWN}


def _drawing(
    found: Sequence[tuple[CellResult, Ratios]], left_out: Sequence[str]
) -> Drawing:
    told = " ".join(
        _finding(name, [ratios[name] for _, ratios in found]) for name in DRAWN
    )
    return Drawing(
        name="geometries",
        caption=(
            f"{told} Drawn: the share of geometries in which the leading error of a "
            "formula's covariance, the term in σ⁴ that it has wrong, is at most so "
            "many times that of the second order. To the left of 1 (dashed) a formula "
            "is nearer to the truth than the second order; one of higher order would "
            "be at 0. The geometries are numbered, so no chance is involved."
        ),
        alternative=(
            "Distribution over random geometries of the leading error of the source's "
            "fourth order, and of equation (63) as printed, over that of the second "
            f"order. {told}"
        ),
        panels=[_panel(cell, ratios) for cell, ratios in found],
        left_out=left_out,
    )


def _panel(cell: CellResult, ratios: Ratios) -> Panel:
    colour, line = STYLES[ORDER_2]
    series = [
        share_at_most(name, ratios[name], *style) for name, style in DRAWN.items()
    ]
    one = Series(
        label=ORDER_2,
        x=np.ones(2),
        y=np.array([0.0, 1.0]),
        colour=colour,
        line=line,
    )
    noise, frame = cell.parameters["noise"], cell.parameters["frame"]
    return Panel(
        title=f"{noise} noise, {frame} frame",
        x_label="leading error over the second order's, 1",
        y_label=f"share of {cell.parameters['geometries']} geometries, 1",
        series=(one, *series),
        log_x=False,
        log_y=False,
    )


def _finding(name: str, ratios: Sequence[Array]) -> str:
    """What the distributions of one formula say, in a sentence."""
    shares = [float(np.mean(r < 1.0)) for r in ratios]
    medians = [float(np.median(r)) for r in ratios]
    counts = " or ".join(str(n) for n in sorted({len(r) for r in ratios}))
    least = min(float(r.min()) for r in ratios)
    higher = (
        "never of higher order" if least > ZERO else "in some perhaps of higher order"
    )
    return (
        f"{name}: {_often(shares)}, {higher}. It is nearer to the truth than the "
        f"second order in {_span([100.0 * s for s in shares])} % of {counts} "
        f"geometries, its median ratio is {_span(medians)}, its least {least:.2g}."
    )


def _often(shares: Sequence[float]) -> str:
    if min(shares) == 1.0:
        return "always better"
    if max(shares) == 0.0:
        return "always worse"
    if max(shares) < 0.5:
        return "usually worse, sometimes better"
    if min(shares) > 0.5:
        return "usually better, sometimes worse"
    return "better or worse, as the noise and the frame are"


def _span(values: Sequence[float]) -> str:
    low, high = (f"{value:.3g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _table(cells: Sequence[CellResult]) -> Table:
    rows = []
    for cell, name in ((cell, name) for cell in cells for name in DRAWN):
        statistics = [*LEADING_ERROR_RATIO.each(QUANTILES), NEARER()]
        found = [cell.row(statistic, name) for statistic in statistics]
        off = cell.row(LEADING_TERM_OFF(), EXACT)
        if any(row is not None for row in found):
            noise, frame, count = (
                cell.parameters[key] for key in ("noise", "frame", "geometries")
            )
            values = [None if row is None else row.value for row in (*found, off)]
            rows.append((noise, frame, count, name, *values))
    return Table(
        name="geometries",
        caption=(
            "Leading error of each formula's covariance over the second order's, over "
            "the geometries; share of them in which it is nearer to the truth; and how "
            "far the complete leading term is from an independent route, relative"
        ),
        columns=(
            Column("noise"),
            Column("frame"),
            Column("geometries", "number"),
            Column("formula"),
            *(Column(name.replace("%", " %"), "number", 3) for name in QUANTILES),
            Column("share nearer", "number", 3),
            Column("leading term off", "number", 2),
        ),
        rows=rows,
    )
