"""Attitude filters: errors over time beside the bound, and what they say of them."""

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any

import numpy as np
from markupsafe import Markup

from simval.judge.algorithms import algorithm_of
from simval.report.artifacts import arrays, is_left, shaped
from simval.report.attitudes import turning
from simval.report.curves import MAX_GROUPS, first, grouped
from simval.report.section import Context, Section, made
from simval.report.sections.filter_figures import (
    budget,
    costs,
    errors,
    honest,
    ratios,
    squares,
)
from simval.report.table import Column, Table
from simval.results import Row
from simval.statistics import (
    BOUND_AT,
    BUDGET_AT,
    DIVERGED,
    NEES,
    NEES_AT,
    NIS,
    RMS,
    RMS_AT,
    RMS_OVER_BOUND,
    SETTLING,
    Family,
)
from simval.studies.filter import artifact_of
from simval.studies.filter_rows import HEADING, INCLINATION
from simval.sweep.run import CellResult

SHOWN = (
    RMS, RMS_AT, BOUND_AT, NEES(), NEES_AT, DIVERGED, BUDGET_AT, NIS, SETTLING,
    RMS_OVER_BOUND,
)  # fmt: skip


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("filter")
    if not cells:
        return None
    every = grouped(cells, "algorithm")
    groups, left_out = first(every)
    drawings = [make(groups, left_out) for make in (errors, ratios, squares)]
    for place, said in ((0, costs(every)), (2, honest(every))):
        drawings[place] = replace(drawings[place], finding=said)
    drawn = [each for each in (*drawings, budget(groups)) if each.panels]
    pictures = _turning(context, cells)
    return made(
        "filters", "Attitude filters", drawn, [_table(cells)],
        turning=pictures[:MAX_GROUPS], hidden=max(len(pictures) - MAX_GROUPS, 0),
    )  # fmt: skip


def _turning(context: Context, cells: Sequence[CellResult]) -> list[tuple[str, Markup]]:
    """A moving picture of each cell that left attitudes, the worst first."""
    found = []
    for cell in cells:
        file = context.run.folder / "artifacts" / artifact_of(cell.parameters)
        if not is_left(file):
            continue
        content = arrays(file)
        time = shaped(file, content, "time", None)
        count = len(time)
        truth, estimate = (
            shaped(file, content, name, count, 4) for name in ("truth", "estimate")
        )
        if count < 2 or not (np.diff(time) > 0.0).all():
            continue
        words = f"{algorithm_of(cell)}, {cell.parameters.get('scenario', '')}"
        # cosine of half of the greatest angle between the two
        nearest = float(np.abs(np.vecdot(truth, estimate)).min())
        found.append((nearest, words, turning(words, time, truth, estimate)))
    found.sort(key=itemgetter(0))
    return [(words, picture) for _, words, picture in found]


def _table(cells: Sequence[CellResult]) -> Table:
    """A row for each cell: what was measured, and what theory said beforehand."""
    return Table(
        name="filter-scenarios",
        caption=(
            "Each filter in each scenario: its error, then the squares of errors (of "
            "3) and of innovations by what it states of them, each beside what "
            "theory predicts of the reference filter, and when it settles"
        ),
        columns=(
            Column("algorithm", "code"),
            Column("scenario"),
            Column("RMS error, degrees", "measured"),
            Column("over the bound", "measured"),
            Column("heading, degrees", "measured"),
            Column("inclination, degrees", "measured"),
            Column("NEES", "measured"),
            Column("predicted", "number"),
            Column("NIS", "measured"),
            Column("predicted", "number"),
            Column("settles after, s", "number", 3),
            Column("diverged", "number", 3),
        ),
        rows=[_line(cell) for cell in cells],
    )


def _line(cell: CellResult) -> tuple[Any, ...]:
    def of(family: Family, *entries: str) -> list[Row]:
        return [
            row
            for row in cell.rows
            if row.statistic.family == family and row.statistic.entries == entries
        ]

    def measured(rows: Sequence[Row], scale: float = 1.0) -> tuple[float, float] | None:
        if not rows:
            return None
        return scale * rows[0].value, scale * rows[0].standard_error

    def predicted(rows: Sequence[Row]) -> float | None:
        return rows[-1].prediction if rows else None

    degrees = float(np.degrees(1.0))
    rms, nees, nis = of(RMS), of(NEES), of(NIS)
    settled, lost = of(SETTLING), of(DIVERGED)
    return (
        algorithm_of(cell),
        cell.parameters.get("scenario", ""),
        measured(rms, degrees),
        measured(of(RMS_OVER_BOUND)),
        measured(of(RMS, HEADING), degrees),
        measured(of(RMS, INCLINATION), degrees),
        measured(nees),
        predicted(nees),
        measured(nis),
        predicted(nis),
        settled[0].value if settled else None,
        lost[0].value if lost else None,
    )
