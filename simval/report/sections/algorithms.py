"""Algorithms side by side, the package's own and a user's: how wrong, where, how fast.

Where a run has a user's code this is what comes first after the verdict.
"""

from dataclasses import dataclass

from simval.judge.algorithms import STUDIES, algorithm_of
from simval.plugins.loading import BUILTIN
from simval.report.contest import contest_of
from simval.report.panels import Drawing
from simval.report.section import Context, Section, made
from simval.report.sections.algorithm_figures import dots, failing
from simval.report.sections.algorithm_tables import by_cell, side_by_side
from simval.report.sections.other import numbers
from simval.report.table import Table
from simval.studies.filter import REFERENCE
from simval.sweep import Run

CALLED = {
    "estimator": "attitude estimators",
    "calibrator": "calibrators",
    "filter": "attitude filters",
}
CALL = {
    "estimator": "A call estimates 1024 attitudes.",
    "calibrator": "A call calibrates one set of poses.",
    "filter": "A call is 200 rows of one trial; the built-in one is made for many.",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """What is shown of the algorithms of one kind."""

    title: str
    drawings: tuple[Drawing, ...]
    tables: tuple[Table, ...]
    call: str  # what one call does
    classes: int  # of exact cases, in which an algorithm may fail; 0 without any
    failing: bool  # whether one does


def section(context: Context) -> Section | None:
    """Make the section."""
    parts = [part for study in STUDIES if (part := _part(context, study)) is not None]
    if not parts:
        return None
    return made(
        "algorithms",
        "Algorithms side by side",
        [drawing for part in parts for drawing in part.drawings],
        [table for part in parts for table in part.tables],
        parts=parts,
    )


def _part(context: Context, study: str) -> Part | None:
    cells = [cell for cell in context.run.cells if cell.study == study]
    alone = {algorithm_of(cell) for cell in cells} == {REFERENCE}
    if not cells or alone:  # of the reference filter there is a section of its own
        return None
    contest, who = contest_of(cells), CALLED[study]
    accuracy, failures = dots(study, who, contest), failing(study, who, contest)
    times = context.run.timing.get("calls", {})
    rest = (by_cell(study, contest), numbers(study, context.cells(study)))
    return Part(
        title=who.capitalize(),
        drawings=tuple(d for d in (accuracy, failures) if d is not None),
        tables=(
            side_by_side(study, contest, context.verdicts, times),
            *(table for table in rest if table.rows),
        ),
        call=CALL[study],
        classes=max(len(contest.failures(name)) for name in contest.algorithms),
        failing=failures is not None,
    )


def has_user_code(run: Run) -> bool:
    """Whether a run measures an algorithm that is not the package's own."""
    return any(
        cell.study in STUDIES and algorithm_of(cell) not in BUILTIN
        for cell in run.cells
    )
