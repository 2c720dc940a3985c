"""Leading errors over many geometries: which attitude formula is nearer, how often."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.report import palette
from simval.report.artifacts import arrays, is_left, shaped
from simval.report.curves import MAX_GROUPS
from simval.report.distribution import share_at_most
from simval.report.panels import Drawing, Panel, Series
from simval.report.section import Context, Section, Shown, made
from simval.report.sections.attitude import STYLES
from simval.report.table import Column, Table
from simval.statistics import (
    EXACT,
    LEADING_ERROR_RATIO,
    LEADING_TERM_OFF,
    NEARER,
    ORDER_2,
    ORDER_2_PRINTED,
    ORDER_4,
    ORDER_4_SOURCE,
)
from simval.sweep.run import CellResult

DRAWN = {
    ORDER_4_SOURCE: STYLES[ORDER_4_SOURCE],
    ORDER_2_PRINTED: (palette.ORDER_2_PRINTED, "-"),
}
Ratios = Mapping[str, Array]
"""Of each formula, one for each geometry."""

CALLED = {
    ORDER_4_SOURCE: "The source's fourth order",
    ORDER_2_PRINTED: "Equation (63) as printed",
}
ROOM = 1.35
"""Axis over the greatest ratio: the legend has its place there."""
QUANTILES = ("least", "5%", "median", "95%", "most")
ZERO = 1e-4
"""The study knows the leading error to this share, so a smaller ratio may be 0."""


SHOWN = Shown("attitude_geometries", (LEADING_ERROR_RATIO, NEARER, LEADING_TERM_OFF))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("attitude_geometries")
    if not cells:
        return None
    folder = context.run.folder / "artifacts"
    found = [(cell, r) for cell in cells if (r := _ratios(folder, cell)) is not None]
    shown = found[:MAX_GROUPS]
    names = {cell.name for cell, _ in shown}
    rest = [_place(cell) for cell in cells if cell.name not in names]
    drawings = [_drawing(found, rest)] if shown else []
    return made(
        "geometries",
        "Attitude formulas over many geometries",
        drawings,
        [_table(cells)],
    )


def _ratios(folder: Path, cell: CellResult) -> Ratios | None:
    """Ratio of each formula in each geometry, as the study left them."""
    noise, frame, count = (
        cell.parameters[key] for key in ("noise", "frame", "geometries")
    )
    file = folder / f"attitude-geometries-{noise}-{frame}-{count}.npz"
    if not is_left(file):
        return None
    content = arrays(file)
    return {name: shaped(file, content, name, count) for name in DRAWN}


def _drawing(
    found: Sequence[tuple[CellResult, Ratios]], left_out: Sequence[str]
) -> Drawing:
    told = " ".join(_finding(name, found) for name in DRAWN)
    return Drawing(
        name="geometries",
        asked="Is a formula nearer to the truth than the second order?",
        finding=_nearer(found),
        caption=(
            f"{told} Drawn: the share of geometries in which the leading error of a "
            "formula's covariance, the term in σ⁴ that it has wrong, is at most so "
            "many times that of the second order. To the left of 1 (dashed) a formula "
            "is nearer to the truth than the second order; the complete fourth order, "
            "which is of higher order, is at 0. The geometries are numbered, so no "
            "chance is involved."
        ),
        alternative=(
            "Distribution over random geometries of the leading error of the source's "
            "fourth order, and of equation (63) as printed, over that of the second "
            f"order. {told}"
        ),
        panels=[_panel(cell, ratios) for cell, ratios in found[:MAX_GROUPS]],
        left_out=left_out,
    )


def _nearer(found: Sequence[tuple[CellResult, Ratios]]) -> str:
    """In how many geometries each formula is nearer to the truth, in short."""
    told = []
    for name in DRAWN:
        shares = [100.0 * float(np.mean(of_all[name] < 1.0)) for _, of_all in found]
        ends = dict.fromkeys(f"{share:.3g}" for share in (min(shares), max(shares)))
        told.append((CALLED[name], f"{' to '.join(ends)} %"))
    (one, share), *others = told
    also = "".join(f", {name} in {each}" for name, each in others)
    several = ", depending on noise and frame" if len(found) > 1 else ""
    return (
        f"{one} is nearer to the truth than the second order in {share} of the "
        f"geometries{also}{several}."
    )


def _panel(cell: CellResult, ratios: Ratios) -> Panel:
    end = ROOM * max(float(values.max()) for values in ratios.values())
    series = [
        share_at_most(name, ratios[name], end, *style) for name, style in DRAWN.items()
    ]
    return Panel(
        title=_place(cell),
        x_label="leading error / the second order's",
        y_label=f"share of {cell.parameters['geometries']} geometries",
        series=(_upright(ORDER_4, 0.0), _upright(ORDER_2, 1.0), *series),
        log_x=False,
        log_y=False,
    )


def _upright(name: str, ratio: float) -> Series:
    colour, line = STYLES[name]
    ends = np.array([0.0, 1.0])
    return Series(label=name, x=np.full(2, ratio), y=ends, colour=colour, line=line)


def _place(cell: CellResult) -> str:
    return f"{cell.parameters['noise']} noise, {cell.parameters['frame']} frame"


def _finding(name: str, found: Sequence[tuple[CellResult, Ratios]]) -> str:
    """What the distributions of one formula say, in a sentence."""
    ratios = [of_all[name] for _, of_all in found]
    counts = " or ".join(str(n) for n in sorted({len(r) for r in ratios}))
    shares = [(100.0 * float(np.mean(r < 1.0)), _place(c)) for (c, _), r in
              zip(found, ratios, strict=True)]  # fmt: skip
    (low, where), (high, other) = min(shares), max(shares)
    share = (
        f"{low:.3g} % of {counts} geometries"
        if low == high
        else f"{low:.3g} % ({where}) to {high:.3g} % ({other}) of {counts} geometries"
    )
    medians = [f"{m:.3g}" for m in sorted(float(np.median(r)) for r in ratios)]
    median = " to ".join(dict.fromkeys((medians[0], medians[-1])))
    pooled = np.concatenate(ratios)
    return (
        f"{CALLED[name]} is {_often(float(np.mean(pooled < 1.0)))} than the second "
        f"order{_higher(float(pooled.min()))}. It is nearer to the truth in {share}; "
        f"its leading error is {median} times as large in the median, "
        f"{pooled.min():.4g} times at least, {pooled.max():.4g} at most."
    )


def _often(nearer: float) -> str:
    """How often a formula is better, from the share in which it is nearer."""
    if nearer in (0.0, 1.0):
        return "always better" if nearer else "always worse"
    if nearer < 0.5:
        return "usually worse, sometimes better,"
    return "usually better, sometimes worse,"


def _higher(least: float) -> str:
    return ", and never of higher order" if least > ZERO else ""


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
        fold="Quantiles of the leading errors over the geometries",
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
            *(Column(name.replace("%", " %"), "number", 4) for name in QUANTILES),
            Column("share nearer", "number", 3),
            Column("leading term off", "number", 2),
        ),
        rows=rows,
    )
