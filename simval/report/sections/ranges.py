"""Range of each attitude formula: from what noise it is off, over many geometries."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.report.artifacts import arrays, is_left, shaped
from simval.report.curves import MAX_GROUPS
from simval.report.distribution import share_at_most
from simval.report.panels import Drawing, Panel
from simval.report.section import Context, Section, Shown, made
from simval.report.sections.attitude import CLAIMED, STYLES
from simval.report.table import Column, Table
from simval.report.words import FORMULAS, slugs
from simval.statistics import LIMIT_RATIO, NEXT_ORDER, Family
from simval.sweep.run import CellResult

PARTS = ("covariance", "bias")
SHARES = ("1%", "10%")
ROOM = 1.75
"""Axis over the greatest ratio: the legend has its place there."""
QUANTILES = ("least", "5%", "median", "95%", "most")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """Least |q̄| / σ in each geometry by formula, part and share; and where sought."""

    ratios: Mapping[tuple[str, str, str], Array]
    least: float
    most: float


SHOWN = Shown("attitude_map", (LIMIT_RATIO, NEXT_ORDER))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("attitude_map")
    if not cells:
        return None
    folder = context.run.folder / "artifacts"
    found = [(cell, r) for cell in cells if (r := _limits(folder, cell)) is not None]
    shown = found[:MAX_GROUPS]
    names = slugs("ranges", (str(cell.parameters["frame"]) for cell, _ in shown))
    drawings = [
        _drawing(name, cell, limits, folded=i > 0)
        for i, (name, (cell, limits)) in enumerate(zip(names, shown, strict=True))
    ]
    if drawings:
        drawn = {cell.name for cell, _ in shown}
        rest = [cell.name for cell in cells if cell.name not in drawn]
        drawings[-1] = replace(drawings[-1], left_out=rest)
    tables = [
        _table(
            "ranges",
            LIMIT_RATIO,
            cells,
            "Least |q̄| / σ at which each formula is within the limit: quantiles over "
            "the geometries",
        ),
        _table(
            "ranges-next-order",
            NEXT_ORDER,
            cells,
            "Ratio of the next order to the second, |C₄ - C₂| / |C₂|, where each "
            "formula reaches the limit: quantiles over the geometries",
        ),
    ]
    return made("ranges", "Range of each attitude formula", drawings, tables)


def _limits(folder: Path, cell: CellResult) -> Found | None:
    frame, count = cell.parameters["frame"], cell.parameters["geometries"]
    file = folder / f"attitude-map-{frame}-{count}.npz"
    if not is_left(file):
        return None
    content = arrays(file)
    most, least = shaped(file, content, "searched", 2)
    ratios = {
        (name, part, share): shaped(file, content, f"{name}, {part}, {share}", count)
        for name in CLAIMED
        for part in PARTS
        for share in SHARES
    }
    return Found(ratios=ratios, least=float(least), most=float(most))


def _drawing(name: str, cell: CellResult, found: Found, *, folded: bool) -> Drawing:
    frame, count = cell.parameters["frame"], cell.parameters["geometries"]
    said = f"Estimator in the {frame} frame. {_needed(found)}"
    return Drawing(
        name=name,
        asked="" if folded else "How far from singular must a geometry be?",
        finding="" if folded else said,
        fold=said if folded else "",
        caption=(
            f"Estimator in the {frame} frame: the share of {count} random geometries "
            "in which each formula is within 1 %, and within 10 %, of the exact "
            "answer, over the length of the un-normalised quaternion in units of the "
            "noise; singular is to the left. Between the two dashed lines are 80 % of "
            "the geometries. The source's fourth order has the bias "
            "of the second order, so these two are one line. Limits are sought from "
            f"{found.most:g} down to {found.least:g}; no chance is involved."
        ),
        alternative=(
            f"Estimator in the {frame} frame: share of random geometries in which each "
            "attitude formula is within 1 % and within 10 % of the exact covariance "
            f"and bias, against |q̄| / σ. {_needed(found)}"
        ),
        panels=[
            _panel(part, share, count, found) for part in PARTS for share in SHARES
        ],
        columns=2,
    )


def _needed(found: Found) -> str:
    """What half and nine tenths of the geometries need, in a sentence."""
    needed = []
    for name in CLAIMED:
        half, most = np.quantile(found.ratios[name, "covariance", "1%"], [0.5, 0.9])
        needed.append(f"{half:.3g} and {most:.3g} for {FORMULAS[name]}")
    return (
        "The covariance is within 1 %, in half and in nine tenths of the geometries, "
        f"from |q̄| / σ of {'; '.join(needed)}."
    )


def _panel(part: str, share: str, count: int, found: Found) -> Panel:
    end = ROOM * max(float(found.ratios[name, part, share].max()) for name in CLAIMED)
    return Panel(
        title=f"{part} within {share.replace('%', ' %')}",
        x_label="|q̄| / σ",
        y_label=f"share of {count} geometries",
        series=tuple(
            share_at_most(name, found.ratios[name, part, share], end, *STYLES[name])
            for name in CLAIMED
        ),
        log_x=False,
        log_y=False,
        references=((0.1, ""), (0.9, "")),
    )


def _table(
    name: str, family: Family, cells: Sequence[CellResult], caption: str
) -> Table:
    rows = []
    for cell in cells:
        frame, count = cell.parameters["frame"], cell.parameters["geometries"]
        for formula in CLAIMED:
            for part, share in ((p, s) for p in PARTS for s in SHARES):
                found = [cell.row(family(part, share, q), formula) for q in QUANTILES]
                if any(row is not None for row in found):
                    values = [None if row is None else row.value for row in found]
                    limit = share.replace("%", " %")
                    rows.append((frame, count, formula, part, limit, *values))
    return Table(
        name=name,
        fold=f"{caption}" if rows else "",
        caption=caption,
        columns=(
            Column("frame"),
            Column("geometries", "number"),
            Column("formula"),
            Column("moment"),
            Column("within"),
            *(Column(q.replace("%", " %"), "number", 3) for q in QUANTILES),
        ),
        rows=rows,
    )
