"""Draw the figures that studies declare as data (`simval.figures`).

The bars of a figure hold for all of its points together (95 %); the sentence above it
is about all rows of its families, drawn or not.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from simval.change import EFFORT
from simval.figures import (
    VARYING,
    Figure,
    Picture,
    belongs,
    entries,
)
from simval.judge.settings import axis_words, setting_words, varying
from simval.report import panels
from simval.report.curves import (
    MAX_GROUPS,
    Curve,
    along_axis,
    axis_of,
    bar_width,
    bars,
    first,
    grouped,
    position,
    ratio_bars,
    ratio_strips,
    read,
    spans,
)
from simval.report.findings import Claim, behind, claiming, limited
from simval.report.formatting import FORMULAS, begun, slug, spelled
from simval.report.panels import (
    BOUND,
    COLOURS,
    GREY,
    MARKERS,
    AnyPanel,
    BarPanel,
    Drawing,
    Panel,
    Series,
)
from simval.results import Row
from simval.statistics import (
    EXACT,
    ORDER_2,
    ORDER_2_PRINTED,
    ORDER_4,
    ORDER_4_SOURCE,
    Statistic,
)
from simval.sweep.run import CellResult
from simval.units import Unit, of_row

STYLES = {
    ORDER_2: (panels.ORDER_2, "--"),
    ORDER_4_SOURCE: (panels.ORDER_4_SOURCE, "-."),
    ORDER_4: (panels.ORDER_4_COMPLETE, "-"),
    EXACT: (panels.EXACT, ":"),
    ORDER_2_PRINTED: (panels.ORDER_2_PRINTED, "-"),
}
"""Colour and line of each formula, the same in all figures."""
LINES = ("-", "--", ":", "-.")
DECADE = 10.0
FEW = 12
"""Points of a line that are marked."""

POINTS = " Points: measured; bars hold for all of the figure (95 %). Lines: predicted."
BARS = (
    " Bars: measured, with 95 % intervals that hold for all of a panel. "
    "Diamonds: predicted."
)

Cells = Sequence[CellResult]


class Point(NamedTuple):
    """A row of a cell, with its place in a figure."""

    panel: str
    line: str
    x: float
    cell: CellResult
    row: Row


def drawn(figure: Figure, cells: Cells) -> list[Drawing]:
    """Draw a figure of a study's cells, once or for each group of cells."""
    figure, cells = settled(figure, cells)
    groups, left_out = first(groups_of(figure, cells))
    if figure.single and groups:
        label = max(reversed(groups), key=lambda key: _places(figure, groups[key]))
        groups, left_out = {label: groups[label]}, ()
    apart = figure.each or figure.single
    drawings: list[Drawing] = []
    for label, own in groups.items() if apart else [("", cells)]:
        alone = {"": own} if apart else groups
        parts = [_panels(figure, alone)] + [
            _panels(each, first(groups_of(*settled(each, own)))[0])
            for each in figure.beside
        ]
        if len({len(part) for part in parts}) == 1:  # of the same thing side by side
            parts = [[*row] for row in zip(*parts, strict=True)]
        panels = [*chain(*parts)]
        if not panels:
            continue
        marks = BARS if figure.along == "" else POINTS if figure.compared else ""
        drawing = Drawing(
            name=slug(f"{figure.name} {label if figure.each else ''}"),
            asked=figure.asked,
            caption=f"{begun(label)}{'. ' * bool(label)}{figure.caption}{marks}",
            panels=panels,
            columns=figure.columns,
        )
        if not drawings:  # the first says what is so of every cell
            drawings.append(_said(figure, drawing, cells))
            continue
        drawing = behind(drawing, *_claims(figure, own), before=f"{begun(label)}: ")
        drawings.append(replace(drawing, fold=drawing.fold or label))
    if drawings:
        drawings[-1] = replace(drawings[-1], left_out=left_out)
    return drawings


def panels_of(figure: Figure, groups: Mapping[str, Cells]) -> Iterator[AnyPanel]:
    """A panel for each title, with the groups of cells as lines."""
    for title, cells in groups.items():
        own, cells = settled(figure, cells)
        for part in batches([*groups_of(own, cells).items()], MAX_GROUPS):
            titled = replace(own, panels=partial(_constant, title))
            yield from _panels(titled, dict(part))


def _constant(title: str, row: Row) -> str:
    return title


def batches(items: Sequence[Any], most: int) -> Iterator[Sequence[Any]]:
    """Split items into parts of about equal size, each with at most so many."""
    count = -(-len(items) // most)
    size = -(-len(items) // max(count, 1))
    return (items[i * size : (i + 1) * size] for i in range(count))


def _said(figure: Figure, drawing: Drawing, cells: Cells) -> Drawing:
    """The drawing with its question, and a sentence about its rows."""
    claims, before = _claims(figure, cells), sentence(figure, cells)
    drawing = replace(drawing, asked=figure.asked)
    if figure.scale and claims and claims[0].found.unseen == claims[0].found.compared:
        family, by, whole = figure.scale
        scale = Claim(subject="", cells=cells, what=[family], by=by)
        said = limited(figure.what, claims[0], scale, whole)
        return replace(drawing, finding=f"{before}{said}", claims=claims[:1])
    if figure.fold == "{claim}":
        return behind(drawing, *claims, asked=figure.asked, before=before)
    drawing = claiming(drawing, *claims, before=before)
    return replace(drawing, fold=figure.fold, asked="" if figure.fold else figure.asked)


def _claims(figure: Figure, cells: Cells) -> list[Claim]:
    """Claims that the rows of a figure agree with theory, one for each subject."""
    if not figure.compared or not figure.what:
        return []
    subjects, claimed = figure.what.split("; "), figure.claimed or figure.rows
    rows = [claimed] if len(subjects) == 1 else [[each] for each in claimed]
    claims = [
        Claim(subject=what, cells=cells, what=own, by=figure.by, theory=figure.theory)
        for what, own in zip(subjects, rows, strict=True)
    ]
    return [claim for claim in claims if claim.found.points]


def settled(figure: Figure, cells: Cells) -> tuple[Figure, Cells]:
    """The figure with its axis chosen, and the cells that it is about."""
    own = [c for c in cells if figure.where(c.parameters) and rows_of(figure, c)]
    if figure.along == VARYING:
        figure = replace(figure, along=axis_of(own))
    for name in figure.least:
        own = [
            cell
            for group in grouped(own, name).values()
            for least in [min(each.parameters[name] for each in group)]
            for cell in group
            if cell.parameters[name] == least
        ]
    return figure, own


def groups_of(figure: Figure, cells: Cells) -> dict[str, tuple[CellResult, ...]]:
    """Groups of cells that become lines of the figure."""
    named = (figure.along, figure.lines, *figure.least, *figure.over)
    groups = grouped(cells, *(each for each in named if isinstance(each, str)))
    few = 1 if figure.several else 0
    return {k: own for k, own in groups.items() if _places(figure, own) > few}


def _places(figure: Figure, cells: Cells) -> int:
    """Places of the points on the axis."""
    return len({place_of(figure, rows_of(figure, cell)[0], cell) for cell in cells})


def rows_of(figure: Figure, cell: CellResult) -> list[Row]:
    """Rows of a cell that a figure draws."""
    return [
        row
        for row in cell.rows
        if belongs(row, figure.rows) and figure.by in (None, row.predictor)
    ]


def line_of(figure: Figure, row: Row, cell: CellResult) -> str:
    """Name of the line or bar that a row belongs to."""
    if isinstance(figure.lines, str):
        return str(cell.parameters[figure.lines])
    return "" if figure.lines is None else figure.lines(row)


def place_of(figure: Figure, row: Row, cell: CellResult) -> float | None:
    """Place of a row on the axis."""
    if figure.along == "":
        return 0.0
    if callable(figure.along):
        return figure.along(row)
    return position(cell, figure.along)


def _unit(picture: Picture, row: Row) -> Unit:
    if callable(picture.unit):
        return picture.unit(row)
    return picture.unit or of_row(row.unit)


def with_unit(name: str, unit: Unit) -> str:
    """Label of an axis with its unit."""
    return f"{name}, {unit.name}" if unit.name else name


def _panels(figure: Figure, groups: Mapping[str, Cells]) -> list[AnyPanel]:
    """Panels of a figure."""
    if figure.along == "":
        return _bars(figure, groups)
    points = [
        Point(
            panel=label if figure.panels is None else figure.panels(row),
            line=", ".join(filter(None, (line_of(figure, row, cell), own_label))),
            x=place,
            cell=cell,
            row=row,
        )
        for label, cells in groups.items()
        for own_label in ["" if figure.panels is None else label]
        for cell in cells
        for row in rows_of(figure, cell)
        if (place := place_of(figure, row, cell)) is not None
    ]
    return _lines(figure, points)


def _bars(figure: Figure, groups: Mapping[str, Cells]) -> list[AnyPanel]:
    """A panel of bars for each group of cells, then the ratios of all."""
    panels: list[BarPanel] = []
    curves = []
    for label, cells in groups.items():
        found = [(cell, row) for cell in cells for row in rows_of(figure, cell)]
        seeds = len({cell.seed for cell in cells}) > 1
        names = [
            f"{line_of(figure, row, cell)}{f', seed {cell.seed}' if seeds else ''}"
            for cell, row in found
        ]
        row = found[0][1]
        unit = _unit(figure, row)
        value = with_unit(figure.value or row.statistic.family.words, unit)
        title = label or spelled(cells[0].study)
        panels.append(bars(found, names, title, value, unit))
        places = [Point("", label, float(i), *each) for i, each in enumerate(found)]
        curves.append(_curve(label, places))
    if not figure.ratio or any(p.names != panels[0].names for p in panels):
        return [*panels]
    ratios = ratio_bars("over theory", panels[0].names, curves, bar_width(curves))
    return [*panels, *filter(None, [ratios])]


def _curve(label: str, points: Sequence[Point]) -> Curve:
    """Make a curve of one line's rows."""
    return along_axis(label, [(p.x, p.cell, read(p.row)) for p in points])


def curves_of(figure: Figure, points: Sequence[Point]) -> dict[str, list[Curve]]:
    """Curves of each panel, in units for people."""
    found: dict[str, dict[tuple[str, str], list[Point]]] = {}
    for point in points:
        key = point.line, point.cell.name if figure.over else ""
        found.setdefault(point.panel, {}).setdefault(key, []).append(point)
    return {
        panel: [
            _curve(line, own).scaled(_unit(figure, own[0].row))
            for (line, _), own in lines.items()
        ]
        for panel, lines in found.items()
    }


def _lines(figure: Figure, points: Sequence[Point]) -> list[AnyPanel]:
    """Points with predictions along the axis, and strips with their ratios."""
    every = curves_of(figure, points)
    names = list(dict.fromkeys(point.line for point in points))
    whole = [c for curves in every.values() for c in curves]
    z = bar_width(whole)
    log_x, log_y = figure.log_x, figure.log_y
    if log_x is None:
        log_x = spans(DECADE, [c.x for c in whole])
    if log_y is None:
        log_y = spans(DECADE, [c.value for c in whole])
    panels: list[AnyPanel] = []
    for title, curves in every.items():
        own = [p for p in points if p.panel == title]
        row, study = own[0].row, own[0].cell.study
        theories = _theories(figure, curves, own)
        series = [*theories]
        for c in curves:
            for s in _series(figure, c, names.index(c.label), z):
                known = any(s.label == other.label for other in series)
                series.append(replace(s, label="") if known else s)
        series += [*_resolved(figure, own), *_floor(figure, own)]
        value = figure.value or row.statistic.family.words
        units = {_unit(figure, p.row) for p in own}
        panel = Panel(
            title=title or spelled(study),
            x_label=figure.axis or axis_words(study, str(figure.along)),
            y_label=value if len(units) > 1 else with_unit(value, *units),
            series=series,
            log_x=log_x,
            log_y=log_y,
            references=((figure.level, ""),) if figure.level is not None else (),
        )
        if figure.compared and figure.ratio:
            over = [s for c in curves for s in _over(c, theories)]
            placed = {names.index(c.label): c for c in curves}
            strips = ratio_strips(panel, figure.theory, placed, z, over)
            panel = replace(panel, strips=strips)
        panels.append(panel)
    return panels


def _series(figure: Figure, c: Curve, place: int, z: float) -> list[Series]:
    """Series of one line: its prediction and its points, or one without chance."""
    if figure.compared:
        predicted = c.predicted("-", "theory")
        if len(predicted.x) == 1:  # no line
            predicted = replace(predicted, line="", marker="_")
        measured = c.points(z, place)
        known = figure.theories or not np.isfinite(c.prediction).any()
        return [measured] if known else [predicted, measured]
    label = FORMULAS.get(c.label, c.label)
    colour, line = STYLES.get(
        c.label, (COLOURS[place % len(COLOURS)], LINES[place // len(COLOURS) % 4])
    )
    whole = Series(label=label, x=c.x, y=c.value, colour=colour, line=line)
    if len(c.x) > FEW or (c.label in STYLES and len(c.x) > 1):
        return [whole]
    marker = MARKERS[place % len(MARKERS)]
    marked = replace(whole, line="", marker=marker, notes=c.notes)
    return [marked] if len(c.x) == 1 else [replace(whole, label=""), marked]


def _theories(
    figure: Figure, curves: Sequence[Curve], points: Sequence[Point]
) -> list[Series]:
    """Lines of the other theories for the same statistics."""
    series: list[Series] = []
    for by in (*figure.theories, *filter(None, (figure.bound,))):
        name = "Cramér-Rao bound" if by == figure.bound else FORMULAS.get(by, by)
        colour, style = STYLES.get(by, (BOUND, ":"))
        for line in dict.fromkeys(c.label for c in curves):
            own = {
                (p.x, _unit(figure, p.row).factor * r.prediction)
                for p in points
                if p.line == line
                for r in p.cell.rows
                if r.key == (p.row.statistic, by) and r.prediction is not None
            }
            if own:
                x, y = np.array(sorted(own), dtype=float).T
                label = "" if any(s.label == name for s in series) else name
                series.append(Series(label=label, x=x, y=y, colour=colour, line=style))
    return series


def _over(c: Curve, theories: Sequence[Series]) -> Iterator[Series]:
    """Other theories' lines, divided by the prediction of a curve."""
    x, place = np.unique(c.x, return_index=True)
    for line in theories:
        own = c.prediction[place]
        if np.array_equal(line.x, x) and not np.array_equal(line.y, own):
            yield replace(line, label="", y=line.y / own)


def _resolved(figure: Figure, points: Sequence[Point]) -> list[Series]:
    """Standard error below which distances cannot be seen, relative."""
    found = {
        (p.x, r.standard_error / abs(r.prediction))
        for p in points
        for r in p.cell.rows
        if r.statistic.family == figure.resolved.get(p.panel)
        and r.predictor == EXACT
        and r.prediction
    }
    if not found:
        return []
    x, y = np.array(sorted(found)).T
    return [Series(label="standard error", x=x, y=y, colour=GREY, line=":")]


def _floor(figure: Figure, points: Sequence[Point]) -> list[Series]:
    """A value of a cell drawn as a level line, or values along the axis."""
    cell, factor = points[0].cell, _unit(figure, points[0].row).factor
    own = [r for r in cell.rows if figure.floor in (r.statistic, r.statistic.family)]
    if isinstance(figure.floor, Statistic):
        ends = [f(p.x for p in points) for f in (min, max)]
        line = [(x, row.value) for row in own for x in ends]
    else:
        line = [(place_of(figure, row, cell) or 0.0, row.value) for row in own]
    if not line:
        return []
    x, y = np.array(sorted(line)).T
    name = "Cramér-Rao bound"
    return [Series(label=name, x=x, y=factor * y, colour=BOUND, line=":")]


# ---- sentences


def sentence(picture: Picture, cells: Cells) -> str:
    """The sentence that a figure's template makes of its rows; empty without one."""
    figure = picture if isinstance(picture, Figure) else None
    rows = picture.about or (figure.rows if figure else ())
    by = figure.by if figure and not picture.about else None
    own = [
        (cell, row)
        for cell in cells
        for row in cell.rows
        if belongs(row, rows) and by in (None, row.predictor) and np.isfinite(row.value)
    ]
    if not own or not picture.says:
        return ""
    named = picture.named or (figure.lines if figure else None) or entries

    def called(cell: CellResult, row: Row) -> str:
        label = str(cell.parameters[named]) if isinstance(named, str) else named(row)
        return FORMULAS.get(label, label)

    def said(*values: float) -> str:
        unit = _unit(picture, own[0][1])
        numbers = dict.fromkeys(f"{unit.factor * value:.3g}" for value in values)
        behind = f"\N{NO-BREAK SPACE}{unit.name}" if unit.name else ""
        return f"{' to '.join(numbers)}{behind}"

    ranked = sorted(own, key=lambda pair: abs(pair[1].value))
    lines: dict[str, list[float]] = {}
    for cell, row in own:
        lines.setdefault(called(cell, row), []).append(row.value)
    ends = {"least": ranked[0], "most": ranked[-1]}
    told = {name: said(row.value) for name, (_, row) in ends.items()}
    told |= {
        f"{name}_of": ", ".join(
            filter(None, (called(*pair), where_of(pair[0], cells, named)))
        )
        for name, pair in ends.items()
    }
    told["each"] = "; ".join(
        f"{said(min(v), max(v))} for {name}" for name, v in lines.items()
    )
    told["most_each"] = "; ".join(
        f"{said(max(v))} for {name}" for name, v in lines.items()
    )
    if figure and "{gains}" in figure.says:
        told |= _gains(figure, own)
    return f"{picture.says.format(**told)} " if "" not in told.values() else ""


def _gains(figure: Figure, own: Sequence[tuple[CellResult, Row]]) -> dict[str, str]:
    """Ends of the axis, and the ratio of theory's values there."""
    lines: dict[tuple[Any, ...], list[tuple[float, float]]] = {}
    for cell, row in own:
        rest = {k: v for k, v in cell.parameters.items() if k != figure.along}
        place = place_of(figure, row, cell)
        if place is not None and row.prediction:
            key = row.statistic, str(rest), cell.seed
            lines.setdefault(key, []).append((place, row.prediction))
    ends = [(min(line), max(line)) for line in lines.values()]
    few, many = min(a for (a, _), _ in ends), max(b for _, (b, _) in ends)
    with np.errstate(all="ignore"):
        gains = [
            float(np.divide(x, y)) for (a, x), (b, y) in ends if few == a < b == many
        ]
    told = dict.fromkeys(f"{f(gains):.2g}" for f in (min, max)) if gains else ()
    return {"few": f"{few:g}", "many": f"{many:g}", "gains": " to ".join(told)}


def where_of(cell: CellResult, cells: Cells, without: object = None) -> str:
    """Spell the parameters that distinguish a cell from the others of its study."""
    keys = [key for key in varying(cells) if key not in (*EFFORT, without)]
    return ", ".join(setting_words(cell.study, k, cell.parameters.get(k)) for k in keys)
