"""Write drawings as SVG or PNG; the same data gives the same bytes.

Every panel has the same width; letters are as large as a phone needs them, and the
page's style makes them smaller where there is room. What is about the axes (title,
labels, names, and in a file the legend) is measured with the widths of DejaVu Sans, and
the margins are made for it; long words are broken into lines before. Text stays text;
who has not this font reads another, for which there is some slack. Axes, ticks and
labels are drawn in ``currentColor``, so that the page's own colours, light or dark,
apply to them.

Panels over one another share the axis below them: a panel and its strips, and all of
those over time. On the page a legend is HTML, one for a figure where each label looks
the same in all of its panels. The numbers that are drawn stand in the figure too, for
the page's script to write them as CSV.
"""

import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from html import escape
from itertools import chain, pairwise
from re import compile as pattern_of
from re import sub
from textwrap import wrap
from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.extras import refuse_without
from simval.report import interactivity
from simval.report.marks import (
    MARK,
    SAMPLE,
    SIZE,
    SMALL,
    TITLE,
    Entry,
    Frame,
    Group,
    Ink,
    Lines,
    Marks,
    Scale,
    Words,
    framed,
    minor_ticks,
    ticks_of,
)
from simval.report.panels import (
    GREY,
    INK,
    AnyPanel,
    BarPanel,
    DotPanel,
    Drawing,
    HeatPanel,
    Panel,
    SpherePanel,
    shade,
    told,
)

INCH = 72.0  # in points, of which all lengths are
WIDTH = 330.0  # of a panel: a phone's, in letters that are read there
# height of axes by how many panels are side by side, of three, and of a long curve
UPS, UP, UP_LONG = {1: 75.0, 2: 110.0}, 140.0, 75.0
LEAST_UP = 0.6  # of that height, for few rows
DISC = 194.0  # height of a map of directions
LEFT, RIGHT = 30.0, 16.0  # margins, at least
ENDS, NEAR = 84.0, 0.85
"""Room for the names of lines at their ends, and how far along the axis these are."""
LEADING = 0.42  # from the middles of two names to where they would touch, in heights
EDGE = 4.0  # about all
SPREAD = 3.0
"""How many times finer than another a scale of one quantity may be, to be shared."""
MOST = 3000  # numbers of a series that stand in the figure
TICK, PAD = 3.0, 3.5  # its length, and what is between it and its name
BETWEEN = 7.0  # from the sample of a legend to its words
SPACING = 1.2  # from one line of words to the next, in their size
ROW = 13.0  # of names
NAMES = 115.0  # at most, for the names of rows
LETTER = 0.6  # mean width of a letter over its height
SLACK = 0.92  # share of the room that is used, for a reader with a wider font
SEAMS = pattern_of(r"(?<=[_:,=/])")
"""After these letters a word that is longer than a line is broken."""
APART = 0.45  # of a row, between the dots of a name
HALF = 0.36  # from the middle of letters to their foot, in their size
DOTS_PER_INCH = 240  # of a PNG: sharp on a screen at twice its size
WHITE, DARK = "#ffffff", "#1c1c1e"
FONT = "DejaVu Sans"

LETTERS = {
    0.3: "'ijlI|J ,.·", 0.34: '/:;\\', 0.4: "f-()[]t!²³⁰¹⁴⁵⁶⁷⁸⁹", 0.46: 'r"',
    0.53: "*_°szc⁻?", 0.59: "LFkvxy", 0.64: "PTYoeEhnuSbdgpqσθ$0123456789{}aK",
    0.7: "AVXZBRC", 0.79: "UNHDG&OQ", 0.84: "w#+<=>^~×−±", 0.99: "M%mW@",
}  # fmt: skip
"""Widths of letters of DejaVu Sans over their height, rounded up; of others 0.7."""
ADVANCES = {letter: width for width, own in LETTERS.items() for letter in own}

# corners of marks from their middle, in halves of their size; "o" is a dot
CORNERS = {
    "s": ((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)),
    "^": ((0.0, -1.0), (1.0, 0.9), (-1.0, 0.9)),
    "v": ((0.0, 1.0), (1.0, -0.9), (-1.0, -0.9)),
    "D": ((0.0, -1.2), (1.2, 0.0), (0.0, 1.2), (-1.2, 0.0)),
    "P": ((-0.4, -1.1), (0.4, -1.1), (0.4, -0.4), (1.1, -0.4), (1.1, 0.4), (0.4, 0.4),
          (0.4, 1.1), (-0.4, 1.1), (-0.4, 0.4), (-1.1, 0.4), (-1.1, -0.4),
          (-0.4, -0.4)),
    "_": ((-1.8, -0.2), (1.8, -0.2), (1.8, 0.2), (-1.8, 0.2)),
}  # fmt: skip


# ---- layout


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """A panel with its place on paper."""

    panel: AnyPanel
    frame: Frame
    x: Scale  # axes at their places
    y: Scale
    top: float  # from the edge of its part
    height: float
    groups: Sequence[Group]

    @property
    def box(self) -> tuple[float, float, float, float]:
        """The box of its axes: left, top, right, bottom."""
        return self.x.start, self.y.stop, self.x.stop, self.y.start


class Part(NamedTuple):
    """Panels above one another."""

    sheets: Sequence[Sheet]
    legend: Sequence[Entry]  # its own, where the figure has none

    @property
    def height(self) -> float:
        """Height of the panels together."""
        return sum(sheet.height for sheet in self.sheets)

    @property
    def long(self) -> bool:
        """True if it has a curve with many points."""
        return any(_long(sheet.panel) for sheet in self.sheets)


class Plan(NamedTuple):
    """A figure, laid out on paper."""

    parts: Sequence[Part]
    legend: Sequence[Entry]  # of all of them
    labels: Sequence[str]  # of the series, by their keys
    finer: float  # how many times one of the scales of a quantity is than another


def planned(drawing: Drawing, *, legends: bool = False) -> Plan:
    """Lay out a drawing, with or without legends."""
    panels = [
        [*map(_in_lines, (panel, *getattr(panel, "strips", ())))]
        for panel in drawing.panels
    ]
    labels = interactivity.labels_of(p for part in panels for p in part)
    parts = [[framed(panel, labels) for panel in part] for part in panels]
    finer = _share_scales(panels, parts)
    every = _entries(frame for part in parts for frame in part)
    # each label looks the same in every panel, and nothing else does
    one = len({e.label for e in every}) == len({*map(sample, every)}) == len(every)
    own = [[] if one else _entries(part) for part in parts]
    curves = [p for part in panels for p in part if isinstance(p, Panel)]
    up = UPS.get(drawing.columns, UP)
    if drawing.columns == 1 and len(curves) == sum(map(len, panels)):
        up = UP_LONG if any(map(_long, curves)) else up
        if one and len({(p.x_label, p.log_x) for p in curves}) == 1:  # as over time
            panels, parts, own = [[*chain(*panels)]], [[*chain(*parts)]], [[]]
    if one and legends:
        own[-1] = every
    titled = legends or len(drawing.panels) > 1  # or it stands above
    parts = [*map(_on_one_axis, parts)]
    ends = [_ends(part, frames, up) for part, frames in zip(panels, parts, strict=True)]
    names = [(0.0, end.text) for part in ends for each in part for end in each]
    right = WIDTH - max(RIGHT, MARK + PAD + _widest(names, SMALL))
    made = [
        Part(
            _sheets(part, frames, named, right, up, legend if legends else (), titled),
            legend,
        )
        for part, frames, named, legend in zip(panels, parts, ends, own, strict=True)
    ]
    return Plan(made, every if one else [], labels, finer)


def _long(panel: AnyPanel) -> bool:
    return isinstance(panel, Panel) and panel.long


def _entries(frames: Iterable[Frame]) -> list[Entry]:
    """Legend entries of some panels, each once."""
    every = {(e.label, sample(e)): e for frame in frames for e in frame.entries}
    return [*every.values()]


def _share_scales(
    panels: Sequence[Sequence[AnyPanel]], parts: Sequence[list[Frame]]
) -> float:
    """Give panels of the same quantity one scale, if that suits each of them."""
    alike: dict[tuple[str, bool], list[list[Frame]]] = {}
    for (panel, *_), part in zip(panels, parts, strict=True):
        if isinstance(panel, Panel) and panel.limits is None:
            alike.setdefault((panel.y_label, part[0].y.log), []).append(part)
    finer = 1.0
    for (_, log), own in alike.items():
        ends = np.array([(part[0].y.low, part[0].y.high) for part in own])
        places = np.log(ends) if log else ends
        lengths = np.ptp(places, axis=1)
        if np.ptp(places) > SPREAD * lengths.min():
            finer = max(finer, float(lengths.max() / lengths.min()))
            continue
        for part in own:
            y = replace(part[0].y, low=ends.min(), high=ends.max())
            part[0] = replace(part[0], y=y)
    return finer


def _on_one_axis(frames: list[Frame]) -> list[Frame]:
    """Panels over one another, on the axis of all of them."""
    low, high = min(f.x.low for f in frames), max(f.x.high for f in frames)
    return [replace(f, x=replace(frames[0].x, low=low, high=high)) for f in frames]


class End(NamedTuple):
    """The name of a line at its end."""

    text: str
    height: float  # on its axes
    key: str  # by which the page's script knows the line


def _line_ends(panel: AnyPanel, frame: Frame, up: float) -> list[End]:
    """Names of all lines of a panel, if there is room for each; else none."""
    x, y = Scale(frame.x, 0.0, 1.0), Scale(frame.y, 0.0, _up(panel, frame, up))
    found = [
        End(broken(s.label, SLACK * ENDS, SMALL), float(y(s.y[-1])), key)
        for s, key in frame.named
        if x(s.x[-1]) >= NEAR
    ]
    found.sort(key=lambda end: end.height)
    apart = all(
        above.height - below.height
        >= LEADING * (_high(above.text, SMALL) + _high(below.text, SMALL))
        for below, above in pairwise(found)
    )
    return found if apart and len(found) == len(frame.named) else []


def _ends(
    panels: Sequence[AnyPanel], frames: Sequence[Frame], up: float
) -> list[list[End]]:
    """Names of lines in panels over one another; of one alone only in a strip."""
    found = [_line_ends(*each, up) for each in zip(panels, frames, strict=True)]
    return [own if len(found[0]) > 1 else [] for own in found]


def _sheets(
    panels: Sequence[AnyPanel],
    frames: Sequence[Frame],
    ends: Sequence[Sequence[End]],
    right: float,
    up: float,
    legend: Sequence[Entry],
    titled: bool,
) -> list[Sheet]:
    """Lay out panels above one another, the names of their lines from `right` on."""
    highs = [_up(*each, up) for each in zip(panels, frames, strict=True)]
    left = max(map(_left, frames, highs))
    found: list[Sheet] = []
    for panel, frame, high, own in zip(panels, frames, highs, ends, strict=True):
        top = sum(sheet.height for sheet in found)
        last = len(found) == len(panels) - 1
        named = titled and getattr(panel, "limits", None) is None  # and no strip
        below = legend if last else ()
        sides = left, right
        sheet = _sheet(panel, frame, sides, high, top, below, last=last, titled=named)
        names = [
            Group([Words(end.text, right + MARK, middle, SMALL, "start")],
                  f'class="ends" {end.key}', inside=False)
            for end in own
            for lift in [(_high(end.text, SMALL) - _high("1", SMALL)) / 2.0]
            for middle in [sheet.y.start - end.height - lift]
        ]  # fmt: skip
        found.append(replace(sheet, groups=[*sheet.groups, *names]))
    return found


Ticks = Sequence[tuple[float, str]]


def _widest(names: Ticks, size: float = SIZE) -> float:
    return max((_wide(name, size) for _, name in names), default=0.0) / SLACK


def _left(frame: Frame, up: float) -> float:
    """Width that the names left of the axes need."""
    if frame.bare:
        return (WIDTH - up) / 2.0
    beside = _widest(ticks_of(frame.y, up, along=False)) + PAD + TICK
    aslant = frame.x.ticks if frame.slant else None
    below = _widest(aslant or (), SMALL) * float(np.cos(np.radians(frame.slant)))
    return max(LEFT, EDGE + beside, EDGE + below)


def _sheet(
    panel: AnyPanel,
    frame: Frame,
    sides: tuple[float, float],
    up: float,
    top: float,
    legend: Sequence[Entry],
    *,
    last: bool,
    titled: bool,
) -> Sheet:
    """Lay out one panel with the room that its words need."""
    down = EDGE if frame.y.label else 0.0
    ink: list[Ink] = []
    # the name of the axis may say the same
    title = frame.title if titled else ""
    title = "" if frame.y.label.startswith(title) else title
    for text, size in ((title, TITLE), (frame.y.label, SIZE)):
        if text:
            ink.append(Words(text, 1.0, down + size / 2.0, size, anchor="start"))
            down += _high(text, size) + 1.0
    down += PAD
    left, right = sides
    x = Scale(frame.x, left, left + up if frame.bare else right)
    y = Scale(frame.y, down + up, down)
    groups, down = [Group(ink, inside=False)], down + up
    if not frame.bare:
        ticks = ticks_of(frame.x, x.stop - left, along=True)
        words, down = _below(frame, x, ticks, down) if last else ([], down)
        groups.append(_ruled(x, y, ticks, words, flat=True))
        ticks = ticks_of(frame.y, up, along=False)
        groups.append(_ruled(y, x, ticks, _beside(y, ticks, left), flat=False))
    entries, down = _legend(legend, left, down)
    return Sheet(
        panel=panel,
        frame=frame,
        x=x,
        y=y,
        top=top,
        height=down,
        groups=[*groups, *frame.draw(x, y), entries],
    )


def _ruled(
    axis: Scale, other: Scale, ticks: Ticks, words: Sequence[Words], *, flat: bool
) -> Group:
    """An axis with its grid, ticks and names."""
    kind, foot, out = axis.axis, other.start, TICK if flat else -TICK
    named = [float(axis(value)) for value, _ in ticks]
    grid = [[(at, foot), (at, other.stop)] for at in named * kind.grid]
    strokes = [[(axis.start, foot), (axis.stop, foot)]]
    strokes += [[(at, foot), (at, foot + out)] for at in named * kind.marked]
    between = axis(np.array(minor_ticks(kind))).tolist()
    strokes += [[(at, foot), (at, foot + out / 2.0)] for at in between]
    faint, ink = (
        [np.array(path)[:, :: 1 if flat else -1] for path in paths]
        for paths in (grid, strokes)
    )
    lines = [Lines(faint, GREY, 0.5, opacity=0.35), Lines(ink)]
    return Group([*lines, *words], f'class="{"x" if flat else "y"}"', inside=False)


def _below(
    frame: Frame, x: Scale, ticks: Ticks, down: float
) -> tuple[list[Words], float]:
    """Words below an axis, and where they end."""
    down += PAD + TICK * x.axis.marked
    if frame.slant:
        how: Any = {"size": SMALL, "anchor": "end", "turn": frame.slant}
        words = [Words(name, float(x(at)), down + 2.0, **how) for at, name in ticks]
        down += _widest(ticks, SMALL) * float(np.sin(np.radians(frame.slant)))
        down += max((_high(name, SMALL) for _, name in ticks), default=0.0)
    else:
        words = [Words(name, float(x(at)), down + SIZE / 2.0) for at, name in ticks]
        down += _high("1")
    if frame.x.label:
        place = x.stop, down + 2.0 + SIZE / 2.0
        words.append(Words(frame.x.label, *place, anchor="end"))
        down += 2.0 + _high(frame.x.label)
    return words, down


def _beside(y: Scale, ticks: Ticks, left: float) -> list[Words]:
    """Words left of an axis."""
    end = left - PAD - TICK * y.axis.marked
    return [
        Words(name, end, float(y(at)) - (_high(name) - _high("1")) / 2.0, anchor="end")
        for at, name in ticks
    ]


def _legend(entries: Sequence[Entry], left: float, top: float) -> tuple[Group, float]:
    """A legend below the axes, and where it ends."""
    ink: list[Ink] = []
    for entry in entries:
        name = broken(entry.label, SLACK * WIDTH - left - SAMPLE - BETWEEN, SMALL)
        first = top + 2.0 * EDGE
        ink += [_moved(each, np.array([left, first])) for each in entry.ink]
        words = left + SAMPLE + BETWEEN, first
        ink.append(Words(name, *words, SMALL, anchor="start"))
        top += _high(name, SMALL) + 4.0
    return Group(ink, inside=False), top + EDGE


def _moved(ink: Lines | Marks, by: Array) -> Lines | Marks:
    if isinstance(ink, Marks):
        return replace(ink, places=ink.places + by)
    return replace(ink, paths=[path + by for path in ink.paths])


def _up(panel: AnyPanel, frame: Frame, usual: float) -> float:
    """Height of the axes: the usual one, or what the names of its rows need."""
    if isinstance(panel, SpherePanel):
        return DISC
    if isinstance(panel, Panel):
        return usual * panel.height
    names = [name for _, name in frame.y.ticks or ()]
    lines: float = 1 + max((name.count("\n") for name in names), default=0)
    if isinstance(panel, DotPanel):
        lines = max(lines, APART * (1 + len(panel.series)))
    return max(LEAST_UP * usual, ROW * lines * len(names))


def _wide(text: str, size: float = SIZE) -> float:
    """Width of the longest line of a text."""
    lines = text.split("\n")
    return size * max(sum(ADVANCES.get(c, 0.7) for c in line) for line in lines)


def _high(text: str, size: float = SIZE) -> float:
    return SPACING * size * (1 + text.count("\n"))


def broken(text: str, room: float, size: float = SIZE) -> str:
    """Break words into lines that fit, within a word only at a seam."""
    most = max(1, int(room / (LETTER * size)))
    lines: list[str] = []
    for line in wrap(text, most, break_long_words=False, break_on_hyphens=False):
        parts = SEAMS.split(line) if len(line) > most else [line]
        lines.append("")
        for part in parts:
            if len(lines[-1]) + len(part) > most:
                lines += wrap(part, most)
            else:
                lines[-1] += part
    return "\n".join(line for line in lines if line)


def _in_lines(panel: AnyPanel) -> AnyPanel:
    """A panel with its long words broken into lines."""
    room = SLACK * WIDTH
    changes: Any = {"title": broken(panel.title, room, TITLE)}
    if isinstance(panel, BarPanel | DotPanel | HeatPanel):
        changes["names"] = [broken(name, NAMES) for name in panel.names]
    if isinstance(panel, HeatPanel):
        changes["columns"] = [broken(name, NAMES, SMALL) for name in panel.columns]
    for label in ("x_label", "y_label"):
        if hasattr(panel, label):
            changes[label] = broken(getattr(panel, label), room)
    return replace(panel, **changes)


# ---- SVG


def root(drawing: Drawing) -> str:
    """Id of the ``svg`` element, which prefixes every id in it."""
    return f"svg-{drawing.name}"


def shown(drawing: Drawing) -> tuple[Plan, list[str]]:
    """The ``svg`` elements that a page sets side by side, with their legends."""
    plan = planned(drawing)
    if len(plan.parts) == 1:
        return plan, [
            _svg([(0.0, 0.0, plan.parts[0])], plan, root(drawing), drawing.alternative)
        ]
    return plan, [
        _svg(
            [(0.0, 0.0, part)], plan, f"{root(drawing)}-{i}", told(part.sheets[0].panel)
        )
        for i, part in enumerate(plan.parts, 1)
    ]


def svg(drawing: Drawing) -> str:
    """The ``svg`` elements of a figure on a page."""
    return "".join(shown(drawing)[1])


def svg_file(drawing: Drawing) -> str:
    """Draw as an SVG file of its own: dark ink on white paper.

    Parameters
    ----------
    drawing : Drawing
        What to draw.

    Returns
    -------
    str
        Text of the file.
    """
    name = root(drawing)
    plan = planned(drawing, legends=True)
    text = _svg([*_grid(drawing, plan)], plan, name, drawing.alternative)
    paper = f"<style>#{name} {{ color: {DARK}; background: {WHITE}; }}</style>"
    plain = sub(r"var\([^,]*,(#\w+)\)", r"\1", text)  # who reads a file may know none
    return plain.replace(">", ">" + paper, 1) + "\n"


def _grid(drawing: Drawing, plan: Plan) -> Iterator[tuple[float, float, Part]]:
    """Parts of a figure side by side, each with its corner."""
    columns, top = min(len(plan.parts), drawing.columns), 0.0
    for i in range(0, len(plan.parts), columns):
        row = plan.parts[i : i + columns]
        yield from ((k * WIDTH, top, part) for k, part in enumerate(row))
        top += max(part.height for part in row)


def _size(placed: Sequence[tuple[float, float, Part]]) -> tuple[float, float]:
    width = max(left for left, *_ in placed) + WIDTH
    return width, max(top + part.height for _, top, part in placed)


def _svg(
    placed: Sequence[tuple[float, float, Part]], plan: Plan, name: str, words: str
) -> str:
    """Draw an ``svg`` element with prefixed ids and a text alternative."""
    images: list[str] = []
    discs: list[str] = []
    for left, top, part in placed:
        for sheet in part.sheets:
            down = top + sheet.top
            moved = (
                f' transform="translate({left:g} {down:.1f})"' if left or down else ""
            )
            axes = f' data-axes="{_axes(sheet)}"' if part.long else ""
            image = "".join(_inked(sheet, f"{name}-axes-{len(images)}"))
            images.append(f"<g{moved}{axes}>{image}</g>")
            own = _discs(sheet, plan.labels)
            discs += [f"<g{moved}>{own}</g>" if moved else own] * bool(own)
    image = "\n".join(images)
    # the size comes from the view box, so the figure can shrink with the page
    width, height = _size(placed)
    long = ' class="long"' * any(part.long for *_, part in placed)
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:.1f}" '
        f'font-family="{FONT}, Verdana, sans-serif" font-size="{SIZE:g}" '
        f'fill="currentColor" id="{name}"{long}'
    )
    label = f'role="img" aria-label="{escape(words)}"'
    if not discs and not long:
        return f"{head} {label}>\n{image}\n</svg>\n"
    over = f'<g fill="none" pointer-events="all">\n{"".join(discs)}</g>\n'
    names = (sheet.panel.title for *_, part in placed for sheet in part.sheets)
    titles = escape("; ".join(filter(None, names)))
    return (
        f'{head} role="group" aria-label="{titles}">\n'
        f"<g {label}>\n{image}\n</g>\n{over * bool(discs)}</svg>\n"
    )


def _axes(sheet: Sheet) -> str:
    """Places and ends of both axes, for the page's script."""
    ends = [sheet.frame.x.low, sheet.frame.x.high]
    if not sheet.frame.y.log:
        ends += [sheet.frame.y.low, sheet.frame.y.high]
    return " ".join(f"{x:.1f}" for x in sheet.box) + "".join(f" {x:.9g}" for x in ends)


def _discs(sheet: Sheet, labels: Sequence[str]) -> str:
    points = sheet.frame.points
    places = [np.column_stack([sheet.x(s.x), sheet.y(s.y)]) for s in points]
    return interactivity.discs(sheet.panel, points, places, labels, sheet.box)


def sample(entry: Entry) -> str:
    """The sample of a legend entry."""
    return "".join(map(_part, entry.ink))


def _inked(sheet: Sheet, name: str) -> Iterator[str]:
    (left, top), (right, bottom) = _reach(sheet)
    frame = sheet.frame
    labels = frame.title, frame.x.label, frame.upward or frame.y.label
    said = zip(("panel", "x", "y"), map(_one_line, labels), strict=True)
    names = "".join(f' data-{key}="{escape(words)}"' for key, words in said)
    yield f"<metadata{names}>{escape(_numbers(frame), quote=False)}</metadata>"
    yield (
        f'<clipPath id="{name}"><rect x="{left:.1f}" y="{top:.1f}" '
        f'width="{right - left:.1f}" height="{bottom - top:.1f}"/></clipPath>\n'
    )
    for group in sheet.groups:
        ink = "".join(map(_part, group.ink))
        cut = f' clip-path="url(#{name})"' if group.inside else ""
        names = f" {group.attributes}" if group.attributes else ""
        if ink:
            yield f"<g{names}{cut}>{ink}</g>" if names or cut else ink


def _numbers(frame: Frame) -> str:
    """The data of a panel as CSV, with a heading.

    Of more than `MOST` marks of a kind every second, or fewer; lines have no more.
    """
    return "".join(
        f"#{_one_line(label)}\n{''.join(map(_comma, rows[:: 1 + len(rows) // MOST]))}"
        for label, rows in frame.data
    )


def _comma(row: Iterable[Any]) -> str:
    parts = (_one_line(x) if isinstance(x, str) else f"{x:.9g}" for x in row)
    return ",".join(f'"{x}"' if "," in x else x for x in parts) + "\n"


def _one_line(words: str) -> str:
    return " ".join(words.replace('"', "'").split())


def _reach(sheet: Sheet) -> Array:
    """Corners of the axes, extended to whole marks at their ends."""
    more = 0.5 if _long(sheet.panel) else MARK
    return np.array(sheet.box).reshape(2, 2) + more * np.array([[-1.0], [1.0]])


def _part(ink: Ink) -> str:
    if isinstance(ink, Words):
        return _words(ink)
    return _marks(ink) if isinstance(ink, Marks) else _lines(ink)


def _colour(colour: str) -> str:
    return "currentColor" if colour == INK else shade(colour)


def _lines(ink: Lines) -> str:
    parts = []
    for path in ink.paths:
        points = [f"{x:.1f} {y:.1f}" for x, y in path.tolist()]
        parts.append("M" + "L".join(points) + "Z" * ink.filled)
    if not parts:
        return ""
    opacity = f' opacity="{ink.opacity:.3g}"' if ink.opacity < 1.0 else ""
    if ink.filled:
        return f'<path d="{"".join(parts)}" fill="{_colour(ink.colour)}"{opacity}/>'
    dash = f' stroke-dasharray="{ink.dash}"' if ink.dash else ""
    return (
        f'<path d="{"".join(parts)}" fill="none" stroke="{_colour(ink.colour)}" '
        f'stroke-width="{ink.width:g}"{dash}{opacity}/>'
    )


def _marks(ink: Marks) -> str:
    places = ink.places.tolist()
    if not places:
        return ""
    colour = _colour(ink.colour)
    if ink.marker == "o" and not ink.hollow:
        dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in places)
        return (
            f'<path d="{dots}" stroke="{colour}" stroke-width="{MARK:g}" '
            'stroke-linecap="round"/>'
        )
    corners = np.array(CORNERS[ink.marker]) * MARK / 2.0
    (right, down), steps = corners[0], np.diff(corners, axis=0)
    rest = "l" + " ".join(f"{a:.2g} {b:.2g}" for a, b in steps.tolist()) + "z"
    d = "".join(f"M{x + right:.1f} {y + down:.1f}{rest}" for x, y in places)
    if ink.hollow:
        return f'<path d="{d}" fill="none" stroke="{colour}"/>'
    return f'<path d="{d}" fill="{colour}"/>'


def _words(ink: Words) -> str:
    size = "" if ink.size == SIZE else f' font-size="{ink.size / SIZE:g}em"'
    size += ' font-weight="600"' * (ink.size == TITLE)
    anchor = "" if ink.anchor == "start" else f' text-anchor="{ink.anchor}"'
    parts = []
    for text, x, y in _placed_lines(ink):
        place = f'x="{x:.1f}" y="{y:.1f}"'
        if ink.turn:
            place = f'transform="translate({x:.1f} {y:.1f}) rotate({-ink.turn:g})"'
        parts.append(f"<text {place}{size}{anchor}>{escape(text, quote=False)}</text>")
    return "".join(parts)


def _placed_lines(ink: Words) -> Iterator[tuple[str, float, float]]:
    """Each line of a text with its baseline."""
    lines = ink.text.split("\n")
    turn = np.radians(ink.turn)
    for i, line in enumerate(lines if ink.text else []):
        away = ink.size * (HALF + SPACING * i)
        yield (
            line,
            ink.x + away * float(np.sin(turn)),
            ink.y + away * float(np.cos(turn)),
        )


# ---- PNG


def png(drawing: Drawing) -> bytes:
    """Draw as a PNG picture: dark ink on white paper.

    Parameters
    ----------
    drawing : Drawing
        What to draw.

    Returns
    -------
    bytes
        Content of the file; the same for the same data.

    Raises
    ------
    InputError
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        refuse_without("plots", "writing .png", "; or write .svg")
    plan = planned(drawing, legends=True)
    placed = [*_grid(drawing, plan)]
    width, height = _size(placed)
    figure = Figure(figsize=(width / INCH, height / INCH), dpi=INCH, facecolor=WHITE)
    for left, top, part in placed:
        for sheet in part.sheets:
            for group in sheet.groups:
                for ink in group.ink:
                    corner = left, top + sheet.top
                    _add(figure, ink, sheet, corner, cut=group.inside)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()


def _add(
    figure: Any, ink: Ink, sheet: Sheet, corner: tuple[float, float], *, cut: bool
) -> None:
    """Add ink to a Matplotlib figure, whose heights count upwards."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Polygon, Rectangle
    from matplotlib.text import Text
    from matplotlib.transforms import Affine2D

    inches = Affine2D().translate(*corner).scale(1.0 / INCH, -1.0 / INCH)
    place = inches.translate(0.0, figure.get_figheight()) + figure.dpi_scale_trans
    artists: list[Any] = []
    if isinstance(ink, Words):
        sides = {"start": "left", "middle": "center", "end": "right"}
        how: Any = {"family": FONT, "color": DARK, "rotation_mode": "anchor"}
        how |= {"weight": "bold" if ink.size == TITLE else "normal"}
        how |= {"size": ink.size, "rotation": ink.turn, "ha": sides[ink.anchor]}
        artists += [Text(x, y, text, **how) for text, x, y in _placed_lines(ink)]
    elif isinstance(ink, Marks):
        size = MARK * (2.0 if ink.marker == "_" else 1.0)
        how = {"ls": "none", "marker": ink.marker, "ms": size, "mew": 0.5}
        how |= {"fillstyle": "none" if ink.hollow else "full"}
        artists.append(Line2D(*ink.places.T, color=_dark(ink.colour), **how))
    else:
        how = {"color": _dark(ink.colour), "alpha": ink.opacity}
        how["lw"] = 0.0 if ink.filled else ink.width
        if ink.dash:
            how["ls"] = (0, tuple(float(n) / ink.width for n in ink.dash.split()))
        for path in ink.paths:
            artists.append(
                Polygon(path, **how) if ink.filled else Line2D(*path.T, **how)
            )
    (left, top), (right, bottom) = _reach(sheet)
    for artist in artists:
        artist.set_transform(place)
        figure.add_artist(artist, clip=False)
        if cut:
            box = right - left, bottom - top
            artist.set_clip_path(Rectangle((left, top), *box, transform=place))


def _dark(colour: str) -> str:
    return DARK if colour == INK else colour
