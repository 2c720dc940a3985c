"""Sections that studies declare: figures, tables of rows, tables of slopes.

Of any study efficiency, coverage and NEES are drawn; one that declares no figure of its
own is drawn along what varies most.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from simval.change import EFFORT
from simval.figures import (
    VARYING,
    Artifact,
    Distribution,
    Figure,
    Listing,
    Shown,
    Trace,
    belongs,
    predictor,
    words,
)
from simval.judge.settings import axis_words, varying
from simval.report.artifacts import drawn_artifacts
from simval.report.curves import fitted_slope, order
from simval.report.findings import Claim, behind, claiming, slopes_said
from simval.report.formatting import slug, spelled
from simval.report.gallery import (
    Cells,
    Point,
    curves_of,
    drawn,
    groups_of,
    line_of,
    panels_of,
    place_of,
    rows_of,
    settled,
    with_unit,
)
from simval.report.panels import AnyPanel, Drawing
from simval.report.section import Context, Section, made
from simval.report.table import NUMBERS, Column, Kind, Table, numbers_of
from simval.results import Row
from simval.statistics import (
    BUDGET,
    COVERAGE,
    COVERAGE_NORMAL,
    EFFICIENCY,
    FAMILIES,
    FIRST_ORDER,
    NEES,
    Family,
    Statistic,
)
from simval.studies import STUDIES
from simval.sweep.run import CellResult
from simval.units import of_row

# ---- tables of rows and slopes

MAX_ROWS = 120
"""Rows of a table on the page."""


def slopes_of(figure: Figure, cells: Cells) -> list[tuple[Any, ...]]:
    """Each line of a figure: its name and cells, its curve, and the leading order."""
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
    """Table of fitted slopes beside those of theory; none without lines.

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
        caption=f"Slopes along the axis: {spelled(anchor)}",
        columns=(
            Column("statistic"),
            Column("of", shown="line"),
            Column("fitted", shown="fitted slope"),
            Column("of theory's own line", "number", shown="slope of theory's line"),
            Column("leading order", "number", shown="theory's leading order"),
        ),
        rows=rows,
        shown=MAX_ROWS,
    )
    return [table] if any(len(np.unique(c.x)) > 1 for _, _, c, _ in lines) else []


def listed(listing: Listing, cells: Cells) -> list[Table]:
    """Table of rows, with a line for each cell and key; none without rows."""
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
        fields.append((title, _itself))
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


def _itself(row: Row) -> Row:
    return row


def _predicted(row: Row) -> float | None:
    return row.prediction


# ---- sections


def section_of(context: Context, anchor: str) -> Section | None:
    """Everything that studies declare for a section; None if nothing."""
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
    """Name the statistics of a section's studies that are not shown in it."""
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
    """Families and statistics that some figure or table shows."""
    if isinstance(shown, Artifact):
        return [*shown.about]
    if isinstance(shown, Listing):
        return [*shown.rows]
    every = (shown, *shown.beside)
    axes = [FAMILIES[name] for each in every if (name := str(each.along)) in FAMILIES]
    floors = [each.floor for each in every if each.floor is not None]
    rows = (row for each in every for row in each.rows)
    return [*rows, *shown.claimed, *shown.about, *axes, *floors]


# ---- efficiency, coverage, NEES

MAX_PANELS = 9  # for the size of a page, as is `MAX_KINDS`
MAX_KINDS = 4
"""Statistics of a family drawn one by one; of more, their mean."""
MEAN = "mean over parameters"
SHOWN = (COVERAGE, NEES)
OF_THEIR_OWN = ("filter",)
"""Studies that draw these families along time."""


def _entry_line(row: Row) -> str:
    words = (*row.statistic.entries, row.predictor)
    return ", ".join(each for each in words if each not in (MEAN, FIRST_ORDER))


_DRAWN = Figure(
    name="efficiency",
    asked="Is the scatter at the bound?",
    what="Efficiency",
    rows=[EFFICIENCY],
    along=VARYING,
    lines=_entry_line,
    value="efficiency",
    level=1.0,
    log_y=False,
    ratio=False,
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
            "Coverage: how often the stated intervals contain the truth, against their "
            "stated level."
        ),
    ),
    replace(
        _DRAWN,
        name="nees",
        asked="Are the stated covariances right?",
        what="NEES",
        rows=[NEES],
        value="NEES",
        level=None,
        ratio=True,
        caption=(
            "NEES, the squared error in units of its own covariance, over its mean "
            "by theory: 1 where the covariance is right, above where too small. Of a "
            "covariance that is known not to hold, theory says how far it may be off; "
            "that is recorded, not judged."
        ),
    ),
)


def statistics_section(context: Context) -> Section | None:
    """Make the section on statistics over time and trials."""
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
                panels += panels_of(figure, _pooled(cells, family))
        if panels:
            drawing = Drawing(
                name=figure.name,
                asked=figure.asked,
                caption=f"{figure.caption} Bars: 95 % for a panel together.",
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
    """Rows of a family, without control variates, by theory."""
    kinds: dict[str, list[Row]] = {}
    for row in cell.rows:
        if row.statistic.family == family and not row.statistic.controlled:
            kinds.setdefault(row.predictor, []).append(row)
    return kinds


def _pooled(cells: list[CellResult], family: Family) -> dict[str, list[CellResult]]:
    """Rows of a family, or their mean if they are many, under a title."""
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
    """Mean of some statistics of a cell, with an upper bound on its error."""
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
MAX_OTHERS = 6  # for the size of a page, as is `MAX_NUMBERS`
MAX_NUMBERS = 40


def other_section(context: Context) -> Section | None:
    """Make the section on studies that declare none."""
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
    )


def _has_section(study: str) -> bool:
    return study in STUDIES and STUDIES[study].section is not None


def _shown(
    context: Context, study: str, cells: Sequence[CellResult]
) -> tuple[list[Drawing], list[Table]]:
    """What a study declares, or figures of its statistics; and all its numbers."""
    known = study in STUDIES and STUDIES[study].shown
    drawings, tables = shown_of(context, "other", [study]) if known else ([], [])
    if not known:
        drawings = _drawings(study, cells)
    return drawings, [*tables, numbers(study, cells)]


def _drawings(study: str, cells: Sequence[CellResult]) -> list[Drawing]:
    """Figures of each statistic that has a prediction, or else of each."""
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
    """Table of every row of a study, with the parameters that vary."""
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
        shown=MAX_NUMBERS,
    )
