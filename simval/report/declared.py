"""A section of what studies declare, and the statistics that it does not show."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from simval.figures import (
    Artifact,
    Distribution,
    Listing,
    Shown,
    Trace,
    belongs,
)
from simval.report.artifacts import drawn_artifacts
from simval.report.gallery import drawn
from simval.report.listings import listed, slope_tables, slopes_of
from simval.report.panels import Drawing
from simval.report.section import Context, Section, made
from simval.report.table import Table
from simval.statistics import FAMILIES, Family, Statistic
from simval.studies import STUDIES


def section_of(context: Context, anchor: str, title: str) -> Section | None:
    """All that studies declare for a section; None without anything."""
    drawings, tables = shown_of(context, anchor)
    if not drawings and not tables:
        return None
    own = [s for n, s in STUDIES.items() if s.section == anchor and context.cells(n)]
    about = " ".join(filter(None, (study.about for study in own)))
    return made(anchor, title, drawings, tables, about=about)


def shown_of(
    context: Context, anchor: str, studies: Iterable[str] = STUDIES
) -> tuple[list[Drawing], list[Table]]:
    """All figures and tables that studies declare for a section."""
    drawings: list[Drawing] = []
    tables: list[Table] = []
    slopes: list[tuple[Any, ...]] = []
    for name, study in ((name, STUDIES[name]) for name in studies):
        cells = context.cells(name)
        for shown in study.shown if cells else ():
            if (shown.section or study.section or "other") != anchor:
                continue
            if isinstance(shown, Listing):
                tables += listed(shown, cells)
            elif isinstance(shown, Distribution | Trace):
                drawings += drawn_artifacts(shown, context, cells)
            else:
                drawings += drawn(shown, cells)
                for each in (shown, *shown.beside):
                    slopes += slopes_of(each, cells)
    return drawings, [*slope_tables(anchor, slopes), *tables]


def elsewhere(
    context: Context, anchor: str, more: Sequence[Family | Statistic] = ()
) -> tuple[str, ...]:
    """Statistics of a section's studies that nothing of theirs, nor `more`, shows."""
    names: dict[str, None] = {}
    for name, study in STUDIES.items():
        if study.section != anchor:
            continue
        wanted = [*more, *(each for shown in study.shown for each in _wanted(shown))]
        partly = {each.family for each in wanted if isinstance(each, Statistic)}
        for row in (row for cell in context.cells(name) for row in cell.rows):
            if not belongs(row, wanted):
                # where a part of a family is shown, the others by their full names
                what = row.statistic
                whole = what if what.family in partly else replace(what, entries=())
                names[str(whole)] = None
    return tuple(names)


def _wanted(shown: Shown) -> list[Family | Statistic]:
    """Families and statistics that something shows."""
    if isinstance(shown, Artifact):
        return [*shown.about]
    if isinstance(shown, Listing):
        return [*shown.rows]
    every = (shown, *shown.beside)
    axes = [FAMILIES[name] for each in every if (name := str(each.along)) in FAMILIES]
    floors = [each.floor for each in every if each.floor is not None]
    rows = (row for each in every for row in each.rows)
    return [*rows, *shown.claimed, *shown.about, *axes, *floors]
