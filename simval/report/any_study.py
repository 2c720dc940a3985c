"""What is drawn of any study: efficiency, coverage and NEES, and what has no section.

A study that declares no figure of its own is drawn along what varies most.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simval.figures import VARYING, Figure, predictor
from simval.report.curves import varying
from simval.report.declared import shown_of
from simval.report.findings import Claim, behind, claiming
from simval.report.gallery import drawn, panels_of
from simval.report.panels import AnyPanel, Drawing
from simval.report.section import Context, Section, made
from simval.report.table import NUMBERS, Column, Table, numbers_of
from simval.report.words import axis_words, slug, spelled
from simval.results import Row
from simval.statistics import (
    BUDGET,
    COVERAGE,
    COVERAGE_NORMAL,
    EFFICIENCY,
    FIRST_ORDER,
    NEES,
    Family,
)
from simval.studies import STUDIES
from simval.sweep.run import CellResult

# ---- efficiency, coverage, NEES

MAX_PANELS = 9  # for the size of a page, as is `MAX_KINDS`
MAX_KINDS = 4
"""Statistics of a family drawn one by one; of more, their mean."""
MEAN = "mean over parameters"
SHOWN = (COVERAGE, NEES)
OF_THEIR_OWN = ("filter",)
"""Studies that draw these families along time."""


def _line(row: Row) -> str:
    words = (*row.statistic.entries, row.predictor)
    return ", ".join(each for each in words if each not in (MEAN, FIRST_ORDER))


_DRAWN = Figure(
    name="efficiency",
    asked="Is the scatter at the bound?",
    what="Efficiency",
    rows=[EFFICIENCY],
    along=VARYING,
    lines=_line,
    value="efficiency",
    level=1.0,
    log_y=False,
    caption=(
        "Efficiency: the Cramér-Rao bound of the variance over the variance; 1 is the "
        "best that an unbiased estimator can do."
    ),
)
FIGURES = (
    _DRAWN,
    replace(
        _DRAWN,
        name="coverage",
        asked="Do the stated intervals cover the truth?",
        what="Coverage",
        rows=[COVERAGE],
        value="share that covers",
        level=0.95,
        caption=(
            "Coverage: how often the stated intervals contain the truth, beside their "
            "stated level."
        ),
    ),
    replace(
        _DRAWN,
        name="nees",
        asked="Are the stated covariances right?",
        what="NEES",
        rows=[NEES],
        value="measured / predicted",
        caption=(
            "NEES, the squared error in units of its own covariance, over its mean "
            "by theory: 1 where the covariance is right, above where too small. Of a "
            "covariance that is known not to hold, theory says how far it may be off; "
            "that is recorded, not judged."
        ),
    ),
)


def statistics_section(context: Context) -> Section | None:
    """Make the section."""
    drawings: list[Drawing] = []
    for figure in FIGURES:
        (family,) = figure.rows
        assert isinstance(family, Family)
        panels: list[AnyPanel] = []
        every: list[CellResult] = []
        studies = dict.fromkeys((*STUDIES, *(cell.study for cell in context.run.cells)))
        for study in (name for name in studies if name not in OF_THEIR_OWN):
            cells = [c for c in context.cells(study) if _kinds(c, family)]
            every += cells
            if cells:
                values, ratios = panels_of(figure, _pooled(cells, family))
                panels += ratios if family == NEES else values
        if panels:
            drawing = Drawing(
                name=figure.name,
                asked=figure.asked,
                caption=f"{figure.caption} Bars: 95 % for a panel together.",
                alternative=figure.caption,
                panels=panels[:MAX_PANELS],
                left_out=[panel.title for panel in panels[MAX_PANELS:]],
            )
            claim = Claim(subject=figure.what, cells=every, what=[family])
            drawings.append(
                behind(drawing, claim, asked=figure.asked)
                if drawings
                else claiming(drawing, claim)
            )
    if not drawings:
        return None
    return made(drawings)


def _kinds(cell: CellResult, family: Family) -> dict[str, list[Row]]:
    """Rows of a family, without control variates, by their predictor."""
    kinds: dict[str, list[Row]] = {}
    for row in cell.rows:
        if row.statistic.family == family and not row.statistic.controlled:
            kinds.setdefault(row.predictor, []).append(row)
    return kinds


def _pooled(cells: list[CellResult], family: Family) -> dict[str, list[CellResult]]:
    """The cells with their rows of a family, or of many their mean, below a title."""
    study = spelled(cells[0].study)
    found = [_kinds(cell, family) for cell in cells]
    if all(sum(map(len, kinds.values())) <= MAX_KINDS for kinds in found):
        rows = [[r for own in kinds.values() for r in own] for kinds in found]
        return {study: _with(cells, rows)}
    means = [[_mean(own) for own in kinds.values()] for kinds in found]
    return {f"{study}, {MEAN}": _with(cells, means)}


def _with(cells: list[CellResult], rows: list[list[Row]]) -> list[CellResult]:
    return [replace(c, rows=tuple(own)) for c, own in zip(cells, rows, strict=True)]


def _mean(rows: list[Row]) -> Row:
    """Mean of statistics of a cell; its error is at most the mean error."""
    numbers = [
        (r.value, r.standard_error, np.nan if r.prediction is None else r.prediction,
         r.remainder)
        for r in rows
    ]  # fmt: skip
    value, error, prediction, rest = map(float, np.mean(numbers, axis=0))
    return replace(
        rows[0],
        statistic=rows[0].statistic.family(MEAN),
        value=value,
        standard_error=error,
        prediction=prediction if np.isfinite(prediction) else None,
        remainder=rest,
        n=min(row.n for row in rows),
    )


# ---- studies without a section

ELSEWHERE = (EFFICIENCY, COVERAGE, COVERAGE_NORMAL, NEES, BUDGET)
MAX_OTHERS = 6  # for the size of a page, as is `MAX_ROWS`
MAX_ROWS = 40


def other_section(context: Context) -> Section | None:
    """Make the section."""
    studies = dict.fromkeys(cell.study for cell in context.run.cells)
    parts = [
        (
            STUDIES[study].title if study in STUDIES else study,
            *_shown(context, study, cells),
        )
        for study in studies
        if (cells := context.cells(study)) and not _has_section(study)
    ]
    if not parts:
        return None
    return made(
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
    shown = {panel.title for d in drawings for panel in d.panels[:MAX_OTHERS]}
    rest = [name for name in names if name not in shown]
    return [
        replace(d, panels=d.panels[:MAX_OTHERS], left_out=[*d.left_out, *rest])
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
