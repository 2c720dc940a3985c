"""Page that compares two runs: what became better or worse, and by how much.

Numbers come first: what moved, by study and kind of statistic, the largest first; then
a figure of each with both curves; then every common value.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from simval.judge import Difference, Move, RunComparison
from simval.judge.result_lines import runs_account
from simval.judge.settings import axis_words
from simval.report.curves import (
    Curve,
    axis_of,
    bar_width,
    curve,
    grouped,
    spans,
)
from simval.report.formatting import spelled
from simval.report.panels import COLOURS, Drawing, Panel, Series
from simval.report.section import Section, located, made, part_of, template
from simval.report.table import Column, Table, tabulated
from simval.statistics import Statistic
from simval.sweep import Run
from simval.sweep.run import CellResult
from simval.units import value_words

SHOWN = 400
"""Rows of a table, or cells of one run only, that a page shows; the rest is counted."""
MAX_FIGURES = 12
OPEN = 3
"""Figures that are seen at once; the others are behind a fold."""

LITTLE = 3.0
"""Least factor of the values on a logarithmic axis."""

Key = tuple[str, str, Statistic, str]
"""Study, group of cells, statistic and predictor: what one figure shows."""


def render_comparison(a: Run, b: Run, comparison: RunComparison) -> str:
    """Render the comparison of two runs as one HTML page.

    Parameters
    ----------
    a, b : Run
        Before and after.
    comparison : RunComparison
        As from `simval.judge.compare_runs`.

    Returns
    -------
    str
        The page; the same runs give the same bytes.
    """
    return template("page").render(
        title=f"{a.folder.name} and {b.folder.name}",
        sections=comparison_sections(a, b, comparison),
        version=b.manifest["versions"]["simval"],
        source=f"the run folders {a.folder.name} and {b.folder.name}",
    )


def comparison_sections(
    a: Run, b: Run, comparison: RunComparison
) -> tuple[Section, ...]:
    """Make the sections of the page."""
    parts = [located(part_of(run).run) for run in (a, b)]
    drawings = _drawings(parts[0], parts[1], comparison)
    figures = {drawing.finding: drawing.name for drawing in drawings}
    return (
        made(
            drawings,
            [moves_table(comparison.moves, figures)],
            account=runs_account(a, b, comparison),
            changed=comparison.kinds.count("changed"),
        ).under("compared", "What changed"),
        made(tables=[differences_table(comparison)]).under(
            "differences", "Differences"
        ),
        made(
            environment=comparison.environment,
            only_a=comparison.only_a[:SHOWN],
            only_b=comparison.only_b[:SHOWN],
            hidden=max(0, len(comparison.only_a) - SHOWN)
            + max(0, len(comparison.only_b) - SHOWN),
            names=(a.folder.name, b.folder.name),
        ).under("dependencies", "What the runs depend on"),
    )


def told(move: Move) -> str:
    """A change as one sentence."""
    return f"{move.way.capitalize()}: {move.sentence}."


def moves_table(moves: Sequence[Move], figures: Mapping[str, str]) -> Table:
    """Make the table of changes, the largest first."""
    fields: dict[Column, Callable[[Move], Any]] = {
        Column("which way", "answer"): lambda m: m.way,
        Column("what"): lambda m: f"{spelled(m.study)}, {m.what}",
        Column("by how much"): lambda m: m.size,
        Column("standard errors", "number"): lambda m: _few_digits(m.worst.sigmas),
        Column("cells"): lambda m: f"{m.cells} of {m.of}",
        Column("before", "number", 5): lambda m: m.worst.before,
        Column("after", "number", 5): lambda m: m.worst.after,
        Column("unit", "unit"): lambda m: m.worst.statistic.unit,
        Column("figure", "figure"): lambda m: figures.get(told(m)),
    }
    return tabulated(
        moves,
        fields,
        name="moves",
        caption="Changes, largest first; standard errors, before and after are those "
        "of the value that changed most",
        shown=SHOWN,
    )


def _few_digits(sigmas: float | None) -> float | None:
    """Standard errors to the digits that matter."""
    if sigmas is None or not np.isfinite(sigmas):
        return None
    return round(sigmas) if abs(sigmas) >= 100.0 else float(f"{sigmas:.2g}")


def _drawings(a: Run, b: Run, comparison: RunComparison) -> list[Drawing]:
    """A figure for each kind of change, with both curves and their bands."""
    cells_a = {cell.name: cell for cell in a.cells}
    twins = {pair.old.name: pair.new.name for pair in comparison.pairs}
    drawings: list[Drawing] = []
    seen: set[Key] = set()
    for move, difference in _worst(comparison):
        cell = cells_a.get(difference.cell_a)
        if cell is None:  # of a large run, whose part is drawn
            continue
        label, old = _group(a, cell)
        key = (cell.study, label, difference.a.statistic, difference.a.predictor)
        if key in seen:
            continue
        seen.add(key)
        names = {twins[c.name] for c in old if c.name in twins}
        new = tuple(c for c in b.cells if c.name in names)
        drawing = _drawing(len(drawings), key, difference, (a, b), (old, new))
        fold = told(move) if len(drawings) >= OPEN else ""
        drawings.append(replace(drawing, finding=told(move), fold=fold))
        if len(drawings) == MAX_FIGURES:
            break
    return drawings


def _worst(comparison: RunComparison) -> Iterator[tuple[Move, Difference]]:
    """Each kind of change with its largest difference, the largest first."""
    known = {(d.cell, d.statistic): d for d in reversed(comparison.of("changed"))}
    for move in comparison.moves:
        yield move, known[move.worst.cell, move.worst.statistic]


def _group(run: Run, cell: CellResult) -> tuple[str, tuple[CellResult, ...]]:
    cells = run.of(cell.study)
    groups = grouped(cells, axis_of(cells))
    return next((k, members) for k, members in groups.items() if cell in members)


def _drawing(
    number: int,
    key: Key,
    difference: Difference,
    runs: tuple[Run, Run],
    cells: tuple[tuple[CellResult, ...], tuple[CellResult, ...]],
) -> Drawing:
    study, label, name, predictor = key
    axis = axis_of(cells[0])
    found = [
        curve(run.folder.name, members, axis, lambda cell: cell.row(name, predictor))
        for run, members in zip(runs, cells, strict=True)
    ]
    curves = [c for c in found if c is not None]
    z = bar_width(curves)
    series: list[Series] = []
    for i, c in enumerate(curves):
        series.append(c.points(z, i))
        line = "-" if i else "--"
        series.append(Series(label="", x=c.x, y=c.value, colour=COLOURS[i], line=line))
    sigmas = difference.sigmas
    size = f"{sigmas:+.1f} standard errors" if sigmas is not None else "deterministic"
    where = f"{study}{', ' if label else ''}{label}"
    return Drawing(
        name=f"compared{number}",
        caption=(
            f"{difference.name} ({where}): "
            f"{difference.a.value:.6g} in {runs[0].folder.name}, "
            f"{difference.b.value:.6g} in {runs[1].folder.name} ({size}; cell "
            f"{difference.cell}). Bars: {z:.2f} standard errors, 95 % for all "
            "points together."
        ),
        panels=[
            Panel(
                title=f"{spelled(study)}, {name}",
                x_label=axis_words(study, axis),
                y_label=value_words(difference.a.unit),
                series=series,
                log_x=bool(curves) and spans(LITTLE, [c.x for c in curves]),
                log_y=bool(curves) and spans(LITTLE, [c.value for c in curves]),
            ),
            *_apart(curves, axis_words(study, axis), name.better),
        ],
    )


def _apart(curves: list[Curve], along: str, aim: str | None) -> list[Panel]:
    """Plot the change in percent, or in standard errors where values are near zero."""
    if len(curves) != 2 or not np.array_equal(curves[0].x, curves[1].x):
        return []
    a, b = curves
    error = np.hypot(a.error, b.error)
    if len(np.unique(a.x)) < len(a.x):
        return []  # values of several seeds cannot be paired
    z = bar_width([a])
    if aim != "zero" and np.all(a.value != 0.0):
        size = 100.0 / np.abs(a.value)
        series = Series(
            label="", x=a.x, y=size * (b.value - a.value), band=z * size * error
        )
        title, unit = "B over A, less 1", "change, %"
    elif np.all(error > 0.0):
        y = (b.value - a.value) / error
        series = Series(label="", x=a.x, y=y, band=np.full(len(a.x), z))
        title, unit = "B minus A", "standard errors"
    else:
        return []
    return [
        Panel(
            title=title,
            x_label=along,
            y_label=unit,
            series=(series,),
            log_x=spans(LITTLE, [a.x]),
            log_y=False,
            references=((0.0, ""),),
        )
    ]


def differences_table(comparison: RunComparison) -> Table:
    """Make the table of all statistics that both runs have."""
    fields: dict[Column, Callable[[Difference], Any]] = {
        Column("which way", "answer"): _word,
        Column("standard errors", "number", 3): lambda d: d.sigmas,
        Column("change, %", "number", 3): lambda d: (
            100.0 * (d.after - d.before) / abs(d.before) if d.before else None
        ),
        Column("A", "measured"): lambda d: (d.a.value, d.a.standard_error),
        Column("B", "measured"): lambda d: (d.b.value, d.b.standard_error),
        Column("unit", "unit"): lambda d: d.a.unit,
        Column("statistic"): lambda d: str(d.a.statistic),
        Column("against"): lambda d: "; ".join(d.predictors),
        Column("cell", "code"): lambda d: d.cell,
        Column("B minus A", "measured"): lambda d: (d.after - d.before, d.error),
        Column("p", "number", 2): lambda d: d.p_value,
        Column("prediction"): lambda d: "changed" if d.prediction_changed else "",
    }
    count = comparison.total
    return tabulated(
        comparison.differences,
        fields,
        name="differences",
        caption="Every common statistic: changed ones first, by the size of the change",
        shown=SHOWN,
        fold=f"Every common statistic: {count:,}" if count else "",
    )


def _word(difference: Difference) -> str:
    """Better or worse, or else changed or the same."""
    if difference.kind == "same" or difference.standing == "neither":
        return difference.kind
    return difference.standing
