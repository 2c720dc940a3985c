"""Drawings as inline SVG, or as files in SVG and PNG: same data, same bytes.

Every panel has axes of a fixed size. What is about them (title, labels, names, legend)
is measured with the widths of DejaVu Sans, and the margins are made for it; long words
are broken into lines before. Text stays text; who has not this font reads another, for
which there is some slack. Axes, ticks and labels are drawn in ``currentColor``, so that
the page's own colours, light or dark, apply to them.
"""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from html import escape
from re import compile as pattern_of
from textwrap import wrap
from typing import Any

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
    Frame,
    Group,
    Ink,
    Lines,
    Marks,
    Scale,
    Words,
    framed,
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
    told,
)

INCH = 72.0  # in points, of which all lengths are
# width of a panel by how many are side by side, height of its axes
WIDTHS = {1: 475.0, 2: 353.0}
WIDTH, UP = 310.0, 158.0
LEAST_UP = 0.6  # of that height, for few rows
DISC = 194.0  # height of a map of directions
LEFT, RIGHT = 68.0, 25.0  # margins, at least: a tick of eight digits; half of one
EDGE = 4.0  # about all
TICK, PAD = 3.5, 3.5  # its length, and what is between it and its name
MOST_COLUMNS = 3  # of a legend
BETWEEN = 7.0  # from the sample of a legend to its words
SPACING = 1.2  # from one line of words to the next, in their size
ROW = 13.0  # of names
NAMES, WIDE_NAMES = 115.0, 173.0  # at most, for the names of rows; of a panel alone
LETTER = 0.6  # mean width of a letter over its height
SLACK = 0.92  # share of the room that is used, for a reader with a wider font
SEAMS = pattern_of(r"(?<=[_:,=/])")
"""After these letters a word that is longer than a line is broken."""
APART = 0.45  # of a row, between the dots of a name
HALF = 0.36  # from the middle of letters to their foot, in their size
DOTS_PER_INCH = 160  # of a PNG: sharp on a screen at twice its size
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
}  # fmt: skip


# ---- layout


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """A panel on paper."""

    x: float  # its corner on the figure's
    y: float
    height: float
    box: tuple[float, float, float, float]  # of its axes: left, top, right, bottom
    groups: Sequence[Group]
    discs: str


def sheets_of(drawing: Drawing) -> tuple[list[Sheet], float, float]:
    """The panels of a drawing side by side, and the size of all."""
    columns = min(len(drawing.panels), drawing.columns)
    width = WIDTHS.get(drawing.columns, WIDTH)
    names = NAMES if drawing.columns > 1 else WIDE_NAMES
    sheets = [_sheet(panel, width, names, i) for i, panel in enumerate(drawing.panels)]
    top = 0.0
    for i in range(0, len(sheets), columns):
        row = sheets[i : i + columns]
        for k, sheet in enumerate(row):
            sheets[i + k] = replace(sheet, x=k * width, y=top)
        top += max(sheet.height for sheet in row)
    return sheets, width * columns, top


def _sheet(panel: AnyPanel, width: float, names: float, place: int) -> Sheet:
    """A panel with the room that its words need."""
    frame = framed(_in_lines(panel, width, names), place)
    up, top = _up(panel, frame), EDGE
    if frame.title:
        top += _high(frame.title, TITLE) + 6.0
    names_up = [] if frame.bare else ticks_of(frame.y, up, along=False)
    widest = max((_wide(name) for _, name in names_up), default=0.0) / SLACK
    label = _high(frame.y.label) + 4.0 if frame.y.label else 0.0
    left, right = max(LEFT, EDGE + label + widest + PAD + TICK), width - RIGHT
    if frame.slant:
        below = max(
            (_wide(name, SMALL) for _, name in frame.x.ticks or ()), default=0.0
        )
        left = max(left, EDGE + below / SLACK * float(np.cos(np.radians(frame.slant))))
    if frame.bare:
        left, right = (width - up) / 2.0, (width + up) / 2.0
    x, y = Scale(frame.x, left, right), Scale(frame.y, top + up, top)
    title = Words(frame.title, (left + right) / 2.0, EDGE + TITLE / 2.0, TITLE)
    ink: list[Ink] = [title]
    below = top + up
    if not frame.bare:
        names_below = ticks_of(frame.x, right - left, along=True)
        words, below = _below(frame, x, names_below, top + up)
        ink += words + _beside(frame, y, names_up, left, widest)
        ink += _axes(x, y, names_below, names_up)
    legend, height = _legend(frame, width, below)
    groups = [Group(ink, inside=False), *frame.draw(x, y), *legend]
    box = (left, top, right, top + up)
    places = [np.column_stack([x(s.x), y(s.y)]) for s in frame.points]
    discs = interactivity.discs(panel, frame.points, places, place, box)
    return Sheet(x=0.0, y=0.0, height=height, box=box, groups=groups, discs=discs)


Ticks = Sequence[tuple[float, str]]


def _axes(x: Scale, y: Scale, along: Ticks, up: Ticks) -> list[Lines]:
    """The grid, and the axes with their ticks."""
    grid, strokes = [], [[(x.start, y.stop), (x.start, y.start), (x.stop, y.start)]]
    for at in (float(x(value)) for value, _ in along):
        grid += [[(at, y.start), (at, y.stop)]] * x.axis.grid
        strokes += [[(at, y.start), (at, y.start + TICK)]] * x.axis.marked
    for at in (float(y(value)) for value, _ in up):
        grid += [[(x.start, at), (x.stop, at)]] * y.axis.grid
        strokes += [[(x.start, at), (x.start - TICK, at)]] * y.axis.marked
    faint = Lines([*map(np.array, grid)], GREY, 0.5, opacity=0.35)
    return [faint, Lines([*map(np.array, strokes)])]


def _below(
    frame: Frame, x: Scale, ticks: Ticks, down: float
) -> tuple[list[Words], float]:
    """Words below an axis, from this height; and their end."""
    down += PAD + TICK * x.axis.marked
    if frame.slant:
        how: Any = {"size": SMALL, "anchor": "end", "turn": frame.slant}
        words = [Words(name, float(x(at)), down + 2.0, **how) for at, name in ticks]
        longest = max((_wide(name, SMALL) for _, name in ticks), default=0.0)
        down += longest / SLACK * float(np.sin(np.radians(frame.slant)))
        down += max((_high(name, SMALL) for _, name in ticks), default=0.0)
    else:
        words = [Words(name, float(x(at)), down + SIZE / 2.0) for at, name in ticks]
        down += _high("1")
    if frame.x.label:
        middle = (x.start + x.stop) / 2.0
        words.append(Words(frame.x.label, middle, down + 3.0 + SIZE / 2.0))
        down += 3.0 + _high(frame.x.label)
    return words, down


def _beside(
    frame: Frame, y: Scale, ticks: Ticks, left: float, widest: float
) -> list[Words]:
    """Words left of an axis."""
    end, words = left - PAD - TICK * y.axis.marked, []
    for at, name in ticks:
        rise = (_high(name) - _high("1")) / 2.0
        words.append(Words(name, end, float(y(at)) - rise, anchor="end"))
    if frame.y.label:
        edge = end - widest - 4.0 - _high(frame.y.label) + SIZE / 2.0
        middle = (y.start + y.stop) / 2.0
        words.append(Words(frame.y.label, edge, middle, turn=90.0))
    return words


def _legend(frame: Frame, width: float, top: float) -> tuple[list[Group], float]:
    """The legend below the axes, in as many columns as there is room; and the end."""
    entries, room = list(frame.entries), SLACK * width
    for count in range(min(len(entries), MOST_COLUMNS), 0, -1):
        size = -(-len(entries) // count)
        columns = [entries[i : i + size] for i in range(0, len(entries), size)]
        wide = [max(_wide(e.label, SMALL) for e in column) for column in columns]
        across = sum(wide) + len(wide) * (SAMPLE + BETWEEN) + SIZE * (len(wide) - 1)
        if across <= room:
            break
    else:  # there is none
        return [], top + EDGE
    groups, x, foot = [], (width - across) / 2.0, top
    for column, own in zip(columns, wide, strict=True):
        y = top + 2.0 * EDGE
        for entry in column:
            first = y + SMALL / 2.0
            sample = [_moved(ink, np.array([x, first])) for ink in entry.ink]
            after = x + SAMPLE + BETWEEN
            words = Words(entry.label, after, first, SMALL, anchor="start")
            groups.append(Group([*sample, words], entry.attributes, inside=False))
            y += _high(entry.label, SMALL) + 4.0
        foot, x = max(foot, y), after + own + SIZE
    return groups, foot + EDGE


def _moved(ink: Lines | Marks, by: Array) -> Lines | Marks:
    if isinstance(ink, Marks):
        return replace(ink, places=ink.places + by)
    return replace(ink, paths=[path + by for path in ink.paths])


def _up(panel: AnyPanel, frame: Frame) -> float:
    """Height of the axes: as usual, or what the names of its rows need."""
    if isinstance(panel, SpherePanel):
        return DISC
    if isinstance(panel, Panel):
        return UP * panel.height
    names = [name for _, name in frame.y.ticks or ()]
    lines: float = 1 + max((name.count("\n") for name in names), default=0)
    if isinstance(panel, DotPanel):
        lines = max(lines, APART * (1 + len(panel.series)))
    return max(LEAST_UP * UP, ROW * lines * len(names))


def _wide(text: str, size: float = SIZE) -> float:
    """Width of the longest line of words."""
    lines = text.split("\n")
    return size * max(sum(ADVANCES.get(c, 0.7) for c in line) for line in lines)


def _high(text: str, size: float = SIZE) -> float:
    return SPACING * size * (1 + text.count("\n"))


def broken(text: str, room: float, size: float = SIZE) -> str:
    """Break words into lines of this length, or within a word at a seam."""
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


def _in_lines(panel: AnyPanel, width: float, names: float) -> AnyPanel:
    """A panel with its long words broken into lines."""
    changes: Any = {}
    left = LEFT
    if isinstance(panel, BarPanel | DotPanel | HeatPanel):
        changes["names"] = [broken(name, names) for name in panel.names]
        left = max(LEFT, *map(_wide, changes["names"]))
    if isinstance(panel, HeatPanel):
        changes["columns"] = [broken(name, NAMES, SMALL) for name in panel.columns]
    across = width - left - RIGHT
    changes["title"] = broken(panel.title, across, TITLE)
    if isinstance(panel, Panel | BarPanel | DotPanel):
        changes["x_label"] = broken(panel.x_label, across)
    if isinstance(panel, Panel | DotPanel):
        # there is some room above and below the axes
        up = panel.height if isinstance(panel, Panel) else LEAST_UP
        changes["y_label"] = broken(panel.y_label, UP * up + 22.0)
        changes["series"] = [
            replace(s, label=broken(s.label, width - INCH, SMALL)) for s in panel.series
        ]
    return replace(panel, **changes)


# ---- SVG


def root(drawing: Drawing) -> str:
    """Id of the ``svg`` element, and prefix of every id in it."""
    return f"svg-{drawing.name}"


def svg(drawing: Drawing) -> str:
    """Draw as one ``svg`` element for each panel, which a page sets side by side."""
    if len(drawing.panels) == 1:
        return _svg(drawing)
    return "".join(
        _svg(
            replace(
                drawing,
                name=f"{drawing.name}-{i}",
                alternative=told(panel),
                panels=[panel],
            )
        )
        for i, panel in enumerate(drawing.panels, 1)
    )


def svg_file(drawing: Drawing) -> str:
    """Draw as a separate SVG file: dark ink on white paper.

    Parameters
    ----------
    drawing : Drawing
        What to draw.

    Returns
    -------
    str
        Text of the file.
    """
    paper = f"<style>#{root(drawing)} {{ color: {DARK}; background: {WHITE}; }}</style>"
    return _svg(drawing).replace(">", ">" + paper, 1) + "\n"


def _svg(drawing: Drawing) -> str:
    """Draw as an ``svg`` element with prefixed ids and a text alternative."""
    name = root(drawing)
    sheets, width, height = sheets_of(drawing)
    images, discs = [], []
    for i, sheet in enumerate(sheets):
        moved = f'<g transform="translate({sheet.x:g} {sheet.y:.1f})">'
        start, end = (moved, "</g>") if sheet.x or sheet.y else ("", "")
        images.append(f"{start}{''.join(_inked(sheet, f'{name}-axes-{i}'))}{end}")
        discs.append(f"{start}{sheet.discs}{end}" if sheet.discs else "")
    image, over = "\n".join(images), "".join(discs)
    # the size comes from the view box, so the figure can shrink with the page
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:.1f}" '
        f'font-family="{FONT}, Verdana, sans-serif" font-size="{SIZE:g}" '
        f'fill="currentColor" id="{name}"'
    )
    label = f'role="img" aria-label="{escape(drawing.alternative)}"'
    if not over and "data-key=" not in image:
        return f"{head} {label}>\n{image}\n</svg>\n"
    titles = escape("; ".join(panel.title for panel in drawing.panels))
    over = over and f'<g fill="none" pointer-events="all">\n{over}</g>\n'
    return (
        f'{head} role="group" aria-label="{titles}">\n<g {label}>\n{image}\n</g>\n'
        f"{over}</svg>\n"
    )


def _inked(sheet: Sheet, name: str) -> Iterator[str]:
    (left, top), (right, bottom) = _reach(sheet)
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


def _reach(sheet: Sheet) -> Array:
    """Corners of the axes and of whole marks at their ends."""
    return np.array(sheet.box).reshape(2, 2) + MARK * np.array([[-1.0], [1.0]])


def _part(ink: Ink) -> str:
    if isinstance(ink, Words):
        return _words(ink)
    return _marks(ink) if isinstance(ink, Marks) else _lines(ink)


def _colour(colour: str) -> str:
    return "currentColor" if colour == INK else colour


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
    size = "" if ink.size == SIZE else f' font-size="{ink.size:g}"'
    anchor = "" if ink.anchor == "start" else f' text-anchor="{ink.anchor}"'
    parts = []
    for text, x, y in _placed_lines(ink):
        place = f'x="{x:.1f}" y="{y:.1f}"'
        if ink.turn:
            place = f'transform="translate({x:.1f} {y:.1f}) rotate({-ink.turn:g})"'
        parts.append(f"<text {place}{size}{anchor}>{escape(text, quote=False)}</text>")
    return "".join(parts)


def _placed_lines(ink: Words) -> Iterator[tuple[str, float, float]]:
    """Each line of words and the foot of its letters."""
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
    sheets, width, height = sheets_of(drawing)
    figure = Figure(figsize=(width / INCH, height / INCH), dpi=INCH, facecolor=WHITE)
    for sheet in sheets:
        for group in sheet.groups:
            for ink in group.ink:
                _add(figure, ink, sheet, cut=group.inside)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()


def _add(figure: Any, ink: Ink, sheet: Sheet, *, cut: bool) -> None:
    """Add ink to a figure of Matplotlib, whose heights go up."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Polygon, Rectangle
    from matplotlib.text import Text
    from matplotlib.transforms import Affine2D

    inches = Affine2D().translate(sheet.x, sheet.y).scale(1.0 / INCH, -1.0 / INCH)
    place = inches.translate(0.0, figure.get_figheight()) + figure.dpi_scale_trans
    artists: list[Any] = []
    if isinstance(ink, Words):
        sides = {"start": "left", "middle": "center", "end": "right"}
        how: Any = {"family": FONT, "color": DARK, "rotation_mode": "anchor"}
        how |= {"size": ink.size, "rotation": ink.turn, "ha": sides[ink.anchor]}
        artists += [Text(x, y, text, **how) for text, x, y in _placed_lines(ink)]
    elif isinstance(ink, Marks):
        how = {"ls": "none", "marker": ink.marker, "ms": MARK, "mew": 0.5}
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
            size = right - left, bottom - top
            artist.set_clip_path(Rectangle((left, top), *size, transform=place))


def _dark(colour: str) -> str:
    return DARK if colour == INK else colour
