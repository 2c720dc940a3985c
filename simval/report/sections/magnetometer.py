"""Magnetometer: variance of the weighted fit and of the usual recipe over the bound."""

from collections.abc import Sequence

from simval.report.curves import bar_width, bars, first, grouped
from simval.report.findings import Claim, claiming
from simval.report.measures import placed
from simval.report.panels import BarPanel, Drawing
from simval.report.ratio import ratio_bars
from simval.report.section import Context, Section, Shown, made
from simval.report.words import spelled
from simval.results import Row
from simval.statistics import VARIANCE_OVER_BOUND
from simval.sweep.run import CellResult

ALTERNATIVE = (
    "Variance of the weighted fit and of the usual recipe over the bound, measured "
    "beside predicted, for matrix, hard iron and dip"
)
WORDS = {"M": "matrix M", "b": "hard iron b"}
SHOWN = Shown("magnetometer", (VARIANCE_OVER_BOUND,))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("magnetometer")
    if not cells:
        return None
    groups, left_out = first(grouped(cells))
    shown = {label: own[0] for label, own in groups.items()}
    one, *others = [_panel(cell, label) for label, cell in shown.items()]
    curves = [placed(label, _rows(cell), cell) for label, cell in shown.items()]
    ratios = ratio_bars("over theory", one.names, curves, bar_width(curves))
    named = [list(panel.names) for panel in (one, *others)]
    alike = all(names == named[0] for names in named)
    drawing = Drawing(
        name="magnetometer",
        asked="Does the weighted fit reach the bound, and what does the recipe cost?",
        caption=(
            "Variance over the Cramér-Rao bound, mean over the entries of a matrix or "
            "vector: the weighted fit of all 22 parameters, which reaches 1, and the "
            "usual recipe, an ellipsoid for each sensor and then the turn between "
            "them. Bars: measured, with 95 % intervals that hold for all bars of a "
            "panel together. Diamonds: predicted. Beside it, of all settings drawn, "
            "measured over predicted, with bands that hold for all points together."
        ),
        panels=[one, *([ratios] if ratios and alike else [])],
        columns=2,
        left_out=left_out,
        alternative=ALTERNATIVE,
    )
    claim = Claim(subject="The variance", cells=cells, what=[VARIANCE_OVER_BOUND])
    drawings = [claiming(drawing, claim, before=_cost(cells))]
    if others:
        drawings.append(
            Drawing(
                name="magnetometer-settings",
                fold=f"The same in {len(others)} more settings",
                caption="Bars: measured, 95 % for a panel. Diamonds: predicted.",
                panels=others,
                alternative=ALTERNATIVE,
            )
        )
    return made("magnetometer", "Magnetometer", drawings)


def _rows(cell: CellResult) -> list[Row]:
    return [
        row
        for row in cell.rows
        if row.statistic.family == VARIANCE_OVER_BOUND and not row.statistic.controlled
    ]


def _cost(cells: Sequence[CellResult]) -> str:
    """The greatest variance over the bound, of all settings."""
    rows = [row for cell in cells for row in _rows(cell)]
    if not rows:
        return ""
    worst = max(rows, key=lambda row: row.value)
    return (
        f"The variance is at most {worst.value:.3g} times the bound ({_named(worst)}). "
    )


def _named(row: Row) -> str:
    """What a row is of, in words."""
    what, *recipe = row.statistic.entries
    return ", ".join((WORDS.get(what, what), *recipe))


def _panel(cell: CellResult, label: str) -> BarPanel:
    rows = _rows(cell)
    return bars(
        [(cell, row) for row in rows],
        [_named(row) for row in rows],
        label or spelled(cell.study),
        "variance over the bound",
    )
