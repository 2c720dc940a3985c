"""Draw the artifacts that studies left, after checking them."""

import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.figures import Artifact, Distribution, Strip, Trace
from simval.report.curves import described
from simval.report.formatting import FORMULAS, begun, slug
from simval.report.gallery import LINES, STYLES, Cells, sentence, where_of
from simval.report.panels import COLOURS, MARKERS, Drawing, Panel, Series
from simval.report.section import Context
from simval.shapes import Float
from simval.sweep.run import CellResult

FOLDER = "artifacts"
ROOM = 1.35
"""Axis of a distribution over its greatest value: the legend has its place there."""
MOST = 1000
"""Points of a distribution; of more values, as many of the sorted ones, evenly, both
ends in. Their shares are 0.1 % apart, which is less than the width of the line."""

# what NumPy raises for a file that is damaged or no npz file
UNREADABLE: tuple[type[Exception], ...] = (
    *(OSError, ValueError, EOFError, AttributeError, KeyError, TypeError),
    *(zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError),
)


def listed(run: Path, pattern: str) -> list[Path]:
    """Artifacts of a run folder by a pattern of their names, sorted."""
    return sorted((run / FOLDER).glob(pattern))


def is_left(file: Path) -> bool:
    """True if a study left this artifact."""
    return file.exists()


def content_of(file: Path) -> bytes:
    """Read an artifact of a run folder."""
    try:
        return file.read_bytes()
    except OSError as error:
        msg = f"cannot read {file}: {error.strerror}; run the suite again"
        raise InputError(msg) from None


def arrays(file: Path) -> Mapping[str, Array]:
    """Read the arrays of an npz file; no pickle is ever loaded."""
    try:
        with np.load(file, allow_pickle=False) as content:
            return {name: np.asarray(content[name]) for name in content.files}
    except UNREADABLE as error:
        msg = f"{file} is damaged ({error}); run the suite again"
        raise InputError(msg) from None


def shaped(
    file: Path, content: Mapping[str, Array], name: str, *shape: int | None
) -> Array:
    """One array of a file, checked for its shape."""
    given = content[name].shape if name in content else None
    if (
        given is None
        or len(given) != len(shape)
        or not all(
            have >= 1 if want is None else have == want
            for have, want in zip(given, shape, strict=True)
        )
    ):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        have = "is missing" if given is None else f"has shape {given}"
        msg = f"{file}: `{name}` {have}; it must have ({wanted}); run the suite again"
        raise InputError(msg)
    return np.asarray(content[name], dtype=float)


def drawn_artifacts(
    picture: Distribution | Trace, context: Context, cells: Cells
) -> list[Drawing]:
    """Draw the artifacts of a study's cells, in one figure or in one each."""
    folder = context.run.folder / FOLDER
    found = [
        (cell, folder / name)
        for cell in cells
        if is_left(folder / (name := picture.file(cell.parameters)))
    ]
    places = np.linspace(0, len(found) - 1, min(len(found), picture.most)).astype(int)
    shown = [(cell, file, arrays(file)) for cell, file in (found[i] for i in places)]
    groups = [[each] for each in shown] if picture.each else [shown] if shown else []
    drawings = []
    for i, group in enumerate(groups):
        panels = [
            panel
            for left in group
            for panel in _panels(picture, left, _words(left[0], cells))
        ]
        where = begun(where_of(group[0][0], cells)) if picture.each else ""
        said = _said(picture, group, cells)
        said = f"{where}{': ' * bool(where)}{said}".strip()
        drawings.append(
            Drawing(
                name=slug(f"{picture.name} {where}" if i else picture.name),
                asked="" if i else picture.asked,
                finding="" if i else said,
                fold=said if i else "",
                caption=picture.caption,
                panels=panels,
                columns=picture.columns,
            )
        )
    if drawings:
        chosen = {cell.name for cell, _, _ in shown}
        rest = [_words(c, cells) for c, _ in found if c.name not in chosen]
        drawings[-1] = replace(drawings[-1], left_out=rest)
    return drawings


Left = tuple[CellResult, Path, Mapping[str, Array]]
"""A cell, the file of its artifact, and what that holds."""


def _said(picture: Artifact, group: Sequence[Left], cells: Cells) -> str:
    """Sentence for a figure, from its rows or from the arrays of its last cell."""
    if not isinstance(picture, Trace) or picture.tells is None:
        return sentence(picture, [group[0][0]] if picture.each else cells)
    cell, _, content = group[-1]
    where = "" if picture.each else f"{begun(_words(cell, cells))}: "
    return f"{where}{picture.tells(content)}"


def _words(cell: CellResult, cells: Cells) -> str:
    """What distinguishes a cell from the others; all its settings if it is alone."""
    return where_of(cell, cells) or described(cell.study, cell.parameters)


def _panels(picture: Artifact, left: Left, where: str) -> list[Panel]:
    if isinstance(picture, Trace):
        return [_strip(picture, each, left, where) for each in picture.strips]
    assert isinstance(picture, Distribution)
    return _distributions(picture, left, where)


def _distributions(picture: Distribution, left: Left, where: str) -> list[Panel]:
    """A panel for each set of arrays of an artifact."""
    cell, file, content = left
    panels = []
    for title, lines in picture.arrays(cell.parameters).items():
        values = {k: shaped(file, content, name, None) for k, name in lines.items()}
        end = ROOM * max(float(each.max()) for each in values.values())
        series = [
            Series(
                label=FORMULAS.get(name, name),
                x=np.full(2, place),
                y=np.array([0.0, 1.0]),
                colour=STYLES[name][0],
                line=STYLES[name][1],
            )
            for name, place in picture.upright.items()
        ]
        for i, (name, each) in enumerate(values.items()):
            style = STYLES.get(name, (COLOURS[i % len(COLOURS)], LINES[i % 4]))
            series.append(share_at_most(FORMULAS.get(name, name), each, end, *style))
        panels.append(
            Panel(
                title=title or where,
                x_label=picture.axis,
                y_label=picture.value,
                series=series,
                log_x=False,
                log_y=False,
                references=[(share, "") for share in picture.references],
            )
        )
    return panels


def share_at_most(
    label: str, values: Float[Array, " n"], end: float, colour: str, line: str
) -> Series:
    """Cumulative share of the values, as a curve up to the end of the axis."""
    count = len(values)
    chosen = np.linspace(0, count - 1, min(count, MOST)).astype(int)
    ordered = np.sort(values)
    return Series(
        label=label,
        x=np.append(ordered[chosen], [ordered[-1], end]),
        y=np.append((chosen + 0.5) / count, [1.0, 1.0]),
        colour=colour,
        line=line,
    )


def _strip(trace: Trace, strip: Strip, left: Left, where: str) -> Panel:
    """One pair of axes of a trace, drawn."""
    _, file, content = left
    read = partial(shaped, file, content)
    series: list[Series] = []
    if strip.array:
        x = read(strip.along or trace.along, None)
        flat = np.ndim(content.get(strip.array, x)) == 1
        values = read(strip.array, len(x), *([] if flat else [len(strip.names)]))
        columns = [values] if flat else [*values.T]
        names = [""] if flat else strip.names
        for name, column, colour in zip(names, columns, COLOURS, strict=False):
            series.append(Series(label=name, x=x, y=column, colour=colour, line="-"))
    for i, name in enumerate([] if strip.array else sorted(content)):
        values = read(name, None)
        line = Series(
            label="",
            x=np.arange(len(values), dtype=float),
            y=np.where(values > 0.0, values, np.nan) if strip.log_y else values,
            colour=COLOURS[i % len(COLOURS)],
            line=LINES[i % len(LINES)],  # of lines that coincide each is seen
        )
        marker = MARKERS[i % len(MARKERS)]
        series += [line, replace(line, label=name, line="", marker=marker)]
    spans: tuple[tuple[float, float], ...] = ()
    if strip.shaded and np.size(content.get(strip.shaded, 1)):
        spans = tuple((float(a), float(b)) for a, b in read(strip.shaded, None, 2))
    level = [(float(read(strip.level, 1)[0]), strip.level)] if strip.level else ()
    return Panel(
        title=strip.title or where,
        x_label=trace.axis,
        y_label=strip.value,
        series=series,
        log_x=False,
        log_y=strip.log_y,
        references=level,
        spans=spans,
    )
