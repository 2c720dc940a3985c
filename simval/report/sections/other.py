"""Studies without their own section: their statistics along what varies."""

from collections.abc import Sequence
from dataclasses import replace

from simval.figures import VARYING, Figure, predictor
from simval.report.curves import varying
from simval.report.declared import shown_of
from simval.report.gallery import drawn
from simval.report.panels import Drawing
from simval.report.parameters import axis_words
from simval.report.section import Context, Section, made
from simval.report.table import NUMBERS, Column, Table, numbers_of
from simval.report.words import slug, spelled
from simval.statistics import BUDGET, COVERAGE, COVERAGE_NORMAL, EFFICIENCY, NEES
from simval.studies import STUDIES
from simval.sweep.run import CellResult

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
    if not known:
        drawings = _drawings(study, cells)
    return drawings, [*tables, numbers(study, cells)]


def _drawings(study: str, cells: Sequence[CellResult]) -> list[Drawing]:
    """Each statistic with a prediction, or each of all, along what varies."""
    known = {
        row.statistic: row.prediction is not None
        for cell in cells
        for row in cell.rows
        if row.statistic.family not in ELSEWHERE
    }
    predicted = [what for what, has in known.items() if has]
    figure = Figure(
        name=f"study {study}",
        what="What was measured",
        rows=predicted or [*known],
        along=VARYING,
        panels=lambda row: spelled(str(row.statistic)),
        lines=predictor,
        value="value",
        several=True,
        ratio=False,
        log_x=None,
        log_y=None,
        caption="All of its numbers are in the table.",
    )
    drawings = drawn(figure, cells)
    names = dict.fromkeys(spelled(str(what)) for what in known)
    shown = {panel.title for d in drawings for panel in d.panels[:MAX_PANELS]}
    rest = [name for name in names if name not in shown]
    return [
        replace(d, panels=d.panels[:MAX_PANELS], left_out=[*d.left_out, *rest])
        for d in drawings
    ]


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
