"""Error budget: what each source of error contributes, measured and predicted."""

from collections import Counter
from collections.abc import Sequence

from simval.report.curves import bar_width, bars, first, grouped
from simval.report.findings import Claim, claiming
from simval.report.measures import placed
from simval.report.panels import BarPanel, Drawing
from simval.report.ratio import ratio_bars
from simval.report.section import Context, Section, Shown, made
from simval.report.units import of_row
from simval.report.words import spelled
from simval.results import Row
from simval.statistics import BUDGET
from simval.sweep.run import CellResult

SHOWN = Shown("end_to_end", (BUDGET,))


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = [
        cell
        for cell in context.run.cells
        if any(row.statistic.family == BUDGET for row in cell.rows)
    ]
    if not cells:
        return None
    groups, left_out = first(grouped(cells))
    shown = {label: own[0] for label, own in groups.items()}
    panels = [_panel(cell, label) for label, cell in shown.items()]
    curves = [placed(label, _rows(cell), cell) for label, cell in shown.items()]
    alike = all(list(panel.names) == list(panels[0].names) for panel in panels)
    names = panels[0].names
    ratios = ratio_bars("over theory", names, curves, bar_width(curves))
    drawing = Drawing(
        name="budget",
        asked="What does each source of error contribute?",
        caption=(
            "Bars: measured, with 95 % intervals that hold for all bars of a panel "
            "together. Diamonds: predicted, carried from the noise through the "
            "calibration to the attitude. Last: measured over "
            "predicted, with bands that hold for all points together."
        ),
        alternative="Contribution of each source of error, measured and predicted",
        panels=[*panels, *([ratios] if ratios and alike else [])],
        columns=2 if len(panels) < 2 else 3,
        left_out=left_out,
    )
    claim = Claim(subject="Every part", cells=cells, what=[BUDGET])
    return made(
        "budget",
        "Error budget",
        [claiming(drawing, claim, before=_greatest(cells))],
        cells=len(shown) + len(left_out),
        shown=len(shown),
    )


def _rows(cell: CellResult) -> list[Row]:
    rows = [row for row in cell.rows if row.statistic.family == BUDGET]
    return list({row.statistic: row for row in rows}.values())


def _greatest(cells: Sequence[CellResult]) -> str:
    """The part that contributes most, and in how many cells it does."""
    parts = [
        [row for row in _rows(cell) if row.statistic.entries[0] != "total"]
        for cell in cells
    ]
    most = [max(own, key=lambda row: row.value) for own in parts if len(own) > 1]
    if not most:
        return ""
    ((name, count),) = Counter(r.statistic.entries[0] for r in most).most_common(1)
    sizes = sorted(r.value for r in most if r.statistic.entries[0] == name)
    unit = of_row(most[0].unit)
    ends = dict.fromkeys(f"{unit.factor * x:.3g}" for x in (sizes[0], sizes[-1]))
    where = "" if len(most) == 1 else f" in {count} of {len(most)} cells"
    return f"Most comes from the {name}{where}: {' to '.join(ends)} {unit.name}. "


def _panel(cell: CellResult, label: str) -> BarPanel:
    rows = _rows(cell)
    unit = of_row(rows[0].unit)
    return bars(
        [(cell, row) for row in rows],
        [row.statistic.entries[0] for row in rows],
        label or spelled(cell.study),
        f"contribution, {unit.name}",
        unit,
    )
