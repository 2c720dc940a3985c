"""What studies declare: sections, tables of rows and slopes, and what is not shown."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from simval.change import EFFORT
from simval.figures import (
    Artifact,
    Distribution,
    Figure,
    Listing,
    Shown,
    Trace,
    belongs,
    words,
)
from simval.report.artifacts import drawn_artifacts
from simval.report.curves import fitted_slope, order, varying
from simval.report.findings import Claim, slopes_said
from simval.report.gallery import (
    Cells,
    Point,
    curves_of,
    drawn,
    groups_of,
    line_of,
    place_of,
    rows_of,
    settled,
    with_unit,
)
from simval.report.panels import Drawing
from simval.report.section import Context, Section, made
from simval.report.table import Column, Kind, Table
from simval.report.words import axis_words, spelled
from simval.results import Row
from simval.statistics import FAMILIES, Family, Statistic
from simval.studies import STUDIES
from simval.units import of_row

# ---- tables of rows and slopes

MAX_ROWS = 120
"""Rows of a table on the page."""


def slopes_of(figure: Figure, cells: Cells) -> list[tuple[Any, ...]]:
    """Each line of a figure: what it is, of which cells, its curve, leading order."""
    rows: list[tuple[Any, ...]] = []
    figure, cells = settled(figure, cells)
    for label, own in groups_of(figure, cells).items() if figure.slope else ():
        points = [
            Point(words(row), line_of(figure, row, cell), place, cell, row)
            for cell in own
            for row in rows_of(figure, cell)
            if (place := place_of(figure, row, cell)) is not None
        ]
        for what, curves in curves_of(figure, points).items():
            for c in curves:
                leading = figure.slope
                if isinstance(leading, Mapping):
                    leading = leading.get(c.label)
                where = ", ".join(filter(None, (c.label, label)))
                rows.append((what, where, c, leading))
    return rows


def slope_tables(anchor: str, lines: Sequence[tuple[Any, ...]]) -> list[Table]:
    """A table of fitted slopes, theory's and the leading orders, if there are any.

    A line without chance has the slope between its two smallest places.
    """
    rows, found = [], []
    for what, where, c, leading in lines:
        slope, own = "needs two places on the axis", None
        if len(np.unique(c.x)) > 1 and not c.error.any():
            exact = order(c.x, c.value)
            slope = "" if exact is None else f"{exact:.3f}"
        elif len(np.unique(c.x)) > 1:
            fitted = fitted_slope(c.x, c.value, c.error)
            own = fitted_slope(c.x, c.prediction, c.error)
            slope = str(fitted or "not distinguishable from zero in these trials")
            found.append((fitted, own))
        rows.append((what, where, slope, own and round(own.value, 4), leading))
    said, well = slopes_said(found)
    table = Table(
        name=f"{anchor}-slopes",
        fold=(said if found else "Slopes along the axis") if well else "",
        caption=f"Slopes along the axis, with 95 % intervals: {spelled(anchor)}",
        columns=(
            Column("statistic"),
            Column("of"),
            Column("fitted"),
            Column("of theory's line", "number"),
            Column("leading order", "number"),
        ),
        rows=rows,
        shown=MAX_ROWS,
    )
    return [table] if any(len(np.unique(c.x)) > 1 for _, _, c, _ in lines) else []


def listed(listing: Listing, cells: Cells) -> list[Table]:
    """A table of rows: a line for each cell and key; none without rows."""
    cells = [c for c in cells if listing.where(c.parameters)]
    varied = [key for key in varying(cells) if key not in EFFORT]
    parameters = [*dict.fromkeys((*listing.parameters, *varied))]
    parameters += ["seed"] if len({cell.seed for cell in cells}) > 1 else []
    lines: dict[tuple[Any, ...], dict[str, Row]] = {}
    for cell in cells:
        values = {**cell.parameters, "seed": cell.seed}
        for row in (row for row in cell.rows if belongs(row, listing.rows)):
            keys = (key(row) for key in listing.keys.values())
            name = (*(values.get(k) for k in parameters), *keys)
            lines.setdefault(name, {}).setdefault(listing.column(row), row)
    if not lines:
        return []
    columns: list[Column] = []
    for i, key in enumerate(parameters):
        # all digits of a seed
        kinds = {type(name[i]) for name in lines}
        title = axis_words(cells[0].study, key)
        kind: Kind = "number" if kinds <= {int, float} else "text"
        columns.append(Column(title, kind, 19 if kinds == {int} else 6))
    columns += map(Column, listing.keys)
    fields: list[tuple[str, Callable[[Row], Any]]] = []
    for title in dict.fromkeys(title for line in lines.values() for title in line):
        own = [line[title] for line in lines.values() if title in line]
        sampled = any(row.standard_error > 0.0 for row in own)
        unit = listing.unit(own[0]) or of_row(own[0].unit)
        kind = "measured" if sampled else "number"
        told = with_unit(title, unit)
        columns.append(Column(title, kind, shown=told, factor=unit.factor))
        fields.append((title, _measured if sampled else _plain))
        if listing.predicted and any(row.prediction is not None for row in own):
            columns.append(Column("predicted", "number", factor=unit.factor))
            fields.append((title, _predicted))
    fold = "" if listing.open else listing.caption
    if listing.claim:
        claim = Claim(subject=listing.claim, cells=cells, what=listing.rows)
        fold = "" if claim.found.off else claim.said
    rows = [
        (*keys, *(get(line[title]) if title in line else None for title, get in fields))
        for keys, line in lines.items()
    ]
    return [
        Table(
            name=listing.name,
            fold=fold,
            caption=listing.caption,
            columns=columns,
            rows=rows,
            shown=MAX_ROWS,
        )
    ]


def _measured(row: Row) -> tuple[float, float]:
    return row.value, row.standard_error


def _plain(row: Row) -> float:
    return row.value


def _predicted(row: Row) -> float | None:
    return row.prediction


# ---- sections


def section_of(context: Context, anchor: str) -> Section | None:
    """All that studies declare for a section; None without anything."""
    drawings, tables = shown_of(context, anchor)
    if not drawings and not tables:
        return None
    own = [s for n, s in STUDIES.items() if s.section == anchor and context.cells(n)]
    about = " ".join(filter(None, (study.about for study in own)))
    return made(drawings, tables, about=about)


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
    context: Context, anchor: str, more: Sequence[Family] = ()
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
