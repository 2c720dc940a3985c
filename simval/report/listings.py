"""Tables of declared data: the rows of a study, and the slopes of its figures."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from simval.change import EFFORT
from simval.figures import Figure, Listing, belongs, words
from simval.report.curves import varying
from simval.report.findings import Claim, slopes_said
from simval.report.gallery import (
    Cells,
    Point,
    curves_of,
    groups_of,
    line_of,
    place_of,
    rows_of,
    settled,
    with_unit,
)
from simval.report.parameters import axis_words
from simval.report.slope import fitted_slope, order
from simval.report.table import Column, Kind, Table
from simval.report.words import spelled
from simval.results import Row
from simval.units import of_row

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
    """A table of fitted slopes, theory's own and the leading orders, if there are any.

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
            Column("of theory's own line", "number"),
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
