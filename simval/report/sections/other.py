"""Studies without their own section: their statistics along what varies."""

from collections.abc import Sequence

import numpy as np

from simval.report.curves import (
    Curve,
    axis_of,
    bar_width,
    curves,
    first,
    grouped,
    spans,
    statistic,
    varying,
)
from simval.report.findings import Claim, claiming
from simval.report.gallery import shown_of
from simval.report.panels import Drawing, Panel, Series
from simval.report.parameters import axis_words
from simval.report.section import Context, Section, made
from simval.report.table import NUMBERS, Column, Table, numbers_of
from simval.report.words import slug, spelled
from simval.statistics import BUDGET, COVERAGE, COVERAGE_NORMAL, EFFICIENCY, NEES
from simval.studies import STUDIES
from simval.sweep.run import CellResult
from simval.units import value_words

ELSEWHERE = (EFFICIENCY, COVERAGE, COVERAGE_NORMAL, NEES, BUDGET)
MAX_PANELS = 6  # for the size of a page, as is `MAX_ROWS`
MAX_ROWS = 40


def section(context: Context) -> Section | None:
    """Make the section."""
    studies = dict.fromkeys(cell.study for cell in context.run.cells)
    parts = [
        (context.titles.get(study, study), *_shown(context, study, cells))
        for study in studies
        if (cells := context.cells(study)) and not _has_section(study)
    ]
    if not parts:
        return None
    return made(
        "other",
        "Further studies",
        [drawing for _, drawings, _ in parts for drawing in drawings],
        [table for _, _, tables in parts for table in tables],
        parts=parts,
        found=" ".join(f"{title}.".replace("?.", "?") for title, _, _ in parts),
    )


def _has_section(study: str) -> bool:
    return study in STUDIES and STUDIES[study].section is not None


def _shown(
    context: Context, study: str, cells: Sequence[CellResult]
) -> tuple[list[Drawing], list[Table]]:
    """What a study declares, or a figure of its statistics; and all its numbers."""
    known = study in STUDIES and STUDIES[study].shown
    drawings, tables = shown_of(context, "other", [study]) if known else ([], [])
    if not known and (drawing := _drawing(study, cells)) is not None:
        drawings.append(drawing)
    return drawings, [*tables, numbers(study, cells)]


def _drawing(study: str, cells: Sequence[CellResult]) -> Drawing | None:
    axis = axis_of(cells)
    keys = dict.fromkeys(
        (row.statistic, row.predictor, row.unit)
        for cell in cells
        for row in cell.rows
        if row.prediction is not None and row.statistic.family not in ELSEWHERE
    )
    keys = keys or dict.fromkeys(
        (row.statistic, row.predictor, row.unit) for cell in cells for row in cell.rows
    )
    groups, left_out = first(grouped(cells, axis))
    panels = []
    for name, predictor, unit in keys:
        measured = curves(groups, statistic(name, predictor), axis)
        if any(len(np.unique(c.x)) > 1 for c in measured):
            words = axis_words(study, axis)
            panels.append(scored(str(name), words, unit, measured, predictor))
    if not panels:
        return None
    drawn = {panel.title for panel in panels[:MAX_PANELS]}
    names = dict.fromkeys(spelled(str(row.statistic)) for c in cells for row in c.rows)
    rest = [name for name in names if name not in drawn]
    drawing = Drawing(
        name=slug(f"study {study}"),
        caption=(
            "Points: measured, with bars that hold for all points of a panel together "
            "(95 %). Lines: predicted. All of its numbers are in the table."
        ),
        alternative=f"Statistics of the study {study} over {axis}, beside predictions",
        panels=panels[:MAX_PANELS],
        left_out=[*left_out, *rest],
    )
    what = list(dict.fromkeys(name for name, _, _ in keys))
    claim = Claim(subject="What was measured", cells=cells, what=what)
    return claiming(drawing, claim)


def scored(
    name: str, axis: str, unit: str, measured: Sequence[Curve], predictor: str = ""
) -> Panel:
    """A statistic of several groups along an axis, with predictions where there are."""
    z = bar_width(measured)
    series: list[Series] = []
    for i, c in enumerate(measured):
        series.append(c.points(z, i))
        if np.isfinite(c.prediction).any():
            series.append(c.predicted("-", "" if i else predictor))
    return Panel(
        title=spelled(name),
        x_label=axis,
        y_label=value_words(unit),
        series=tuple(series),
        log_x=spans(10.0, [c.x for c in measured]),
        log_y=spans(10.0, [c.value for c in measured]),
        dodge=True,
    )


def numbers(study: str, cells: Sequence[CellResult]) -> Table:
    """Every row of a study, with the parameters that vary."""
    keys = varying(cells)
    rows = [
        (*(cell.parameters.get(key) for key in keys), *numbers_of(row))
        for cell in cells
        for row in cell.rows
    ]
    return Table(
        name=slug(f"study {study}"),
        caption=f"Numbers of the study {study}",
        columns=(*(Column(axis_words(study, key)) for key in keys), *NUMBERS),
        rows=rows,
        shown=MAX_ROWS,
    )
