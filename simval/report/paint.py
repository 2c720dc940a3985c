"""Drawings as inline SVG or PNG: same data, same bytes; text stays text.

Every panel has axes of a fixed size. What is about them (title, labels, names, legend)
is measured with the metrics of DejaVu Sans, and the margins are made for it; long words
are broken into lines before. Axes, ticks and labels are drawn in one placeholder colour
that becomes ``currentColor`` in SVG, so that the page's own colours, light or dark,
apply to them.
"""

import io
import re
import signal
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from html import escape
from multiprocessing import get_context
from textwrap import wrap
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure

from simval.report import interactivity
from simval.report.marks import SMALL, paint, placed
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

POINTS = 72.0  # in an inch
DOTS_PER_INCH = 160  # of points drawn as pixels: sharp on a screen at twice its size

# width of a panel by how many are side by side, height of its axes, inches
WIDTHS = {1: 6.6, 2: 4.9}
WIDTH, UP = 4.3, 2.2
DISC = 2.7  # height of a map of directions
LEFT, RIGHT = 0.95, 0.35  # margins, at least: a tick of eight digits; half of one
EDGE = 0.05  # about all
MOST_COLUMNS = 3  # of a legend
LINE = 0.18  # from one line of words to the next
NAMES, WIDE_NAMES = 1.6, 2.4  # at most, for the names of rows; of a panel alone
SIZE, TITLE = 10.0, 11.0  # of labels and titles, points
LETTER = 0.6  # mean width of a letter over its height
SLACK = 0.92  # share of the room that is used, for a reader with a wider font
SEAMS = re.compile(r"(?<=[_:,=/])")
"""After these letters a word that is longer than a line is broken."""

ALONE = 40
"""Panels that one process draws sooner than several that start for them."""

APART = 0.45  # of a line, between the dots of a name
STYLE: Any = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # its metrics; a reader without it has another
    "font.size": SIZE,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": TITLE,
    "axes.titley": 1.0,  # an automatic place takes a third longer
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": GREY,
    "grid.alpha": 0.35,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": SMALL,
    "lines.markersize": 4.0,
    "errorbar.capsize": 2.0,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "axes.formatter.useoffset": False,
}


def root(drawing: Drawing) -> str:
    """Id of the ``svg`` element, and prefix of every id in it."""
    return f"svg-{drawing.name}"


def svg(drawing: Drawing) -> str:
    """Draw as one ``svg`` element for each panel, which a page sets side by side."""
    return "".join(map(_svg, _parts(drawing)))


def images(drawings: Sequence[Drawing], workers: int) -> dict[str, str]:
    """Draw many as `svg` does, by name, in several processes.

    None where that would not be quicker: who needs a picture draws it then.
    """
    parts = [(drawing.name, part) for drawing in drawings for part in _parts(drawing)]
    if workers < 2 or len(parts) < ALONE:
        return {}
    # a fork of this process could inherit locks; one that only draws has no others
    context = get_context("forkserver")
    context.set_forkserver_preload([__name__])
    pool = ProcessPoolExecutor(workers, context, initializer=_begin_worker)
    try:
        with pool:
            drawn = list(pool.map(_svg, [part for _, part in parts]))
    except BrokenProcessPool:  # killed, for memory as a rule: one draws them too
        return {}
    found = {drawing.name: "" for drawing in drawings}
    for (name, _), text in zip(parts, drawn, strict=True):
        found[name] += text
    return found


def _begin_worker() -> None:
    # the process that waits for the pictures is the one to interrupt
    signal.signal(signal.SIGINT, signal.SIG_IGN)


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
    paper = (
        f"<style>#{root(drawing)} {{ color: #1c1c1e; background: #ffffff; }}</style>"
    )
    return _svg(drawing).replace(">", ">" + paper, 1) + "\n"


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
    """
    buffer = io.BytesIO()
    style: Any = {**STYLE, "savefig.facecolor": "#ffffff"}
    with mpl.rc_context(style):
        figure_of(drawing).savefig(
            buffer, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None}
        )
    return buffer.getvalue()


def _parts(drawing: Drawing) -> list[Drawing]:
    """A drawing for each panel, with a name and an alternative of its own."""
    if len(drawing.panels) == 1:
        return [drawing]
    parts = []
    for i, panel in enumerate(drawing.panels, 1):
        name = f"{drawing.name}-{i}"
        parts.append(
            replace(drawing, name=name, alternative=told(panel), panels=[panel])
        )
    return parts


def _svg(drawing: Drawing) -> str:
    """Draw as an ``svg`` element with prefixed ids and a text alternative."""
    name = root(drawing)
    buffer = io.StringIO()
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    style: Any = {**STYLE, "svg.hashsalt": name}
    with mpl.rc_context(style):
        figure = figure_of(drawing)
        interactivity.name_parts(figure, drawing.panels)
        figure.savefig(buffer, format="svg", dpi=DOTS_PER_INCH, metadata=nothing)
        over = interactivity.points(
            figure, drawing.panels, [placed(p) for p in drawing.panels]
        )
    text = buffer.getvalue()
    text = interactivity.with_keys(text[text.index("<svg") :], drawing.panels)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # ids that nothing refers to, and the indentation
    used = {a or b for a, b in re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', text)}
    text = re.sub(r' id="([^"]*)"', lambda m: m[0] if m[1] in used else "", text)
    text = re.sub(r">\s+<", ">\n<", text)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(xlink:href="#|url\(#)', rf"\g<1>{name}-", text)
    # the style sheet inside must not reach the rest of the page
    text = text.replace(
        '<style type="text/css">*{', f'<style type="text/css">#{name} *{{'
    )
    text = re.sub(r"<[^>]*>", _rounded, text)
    text = text.replace(INK, "currentColor")
    # the size comes from the view box, so the figure can shrink with the page
    head, rest = text.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]*"', "", head)
    label = f'role="img" aria-label="{escape(drawing.alternative)}"'
    if not over and "data-key=" not in rest:
        return f'{head} id="{name}" {label}>{rest}'
    image, end = rest.rsplit("</svg>", 1)
    titles = escape("; ".join(panel.title for panel in drawing.panels))
    whole = f'{head} id="{name}" role="group" aria-label="{titles}">'
    return f"{whole}\n<g {label}>{image}</g>\n{over}</svg>{end}"


def _rounded(tag: re.Match[str]) -> str:
    """Round the coordinates in a tag to a hundredth of a point, which is invisible."""
    return re.sub(r"\d+\.\d{3,}", lambda m: f"{float(m[0]):.2f}", tag[0])


def figure_of(drawing: Drawing) -> Figure:
    """The panels of a drawing, side by side, each with the room that its words need."""
    columns = min(len(drawing.panels), drawing.columns)
    width = WIDTHS.get(drawing.columns, WIDTH)
    figure = Figure(figsize=(width * columns, UP + 1.0), dpi=POINTS)
    boxes = []  # axes, legend, and their margins: left, below, right, above; and height
    names = NAMES if drawing.columns > 1 else WIDE_NAMES
    for panel in [_in_lines(panel, width, names) for panel in drawing.panels]:
        up = _up(panel)
        axes = figure.add_axes((0.1, 0.1, 0.5, 0.5))
        _resize(axes, LEFT, 0.5, width - LEFT - RIGHT, up)
        paint(panel, axes)
        boxes.append((axes, up, *_margins(axes, width)))
    heights = [up + below + above for _, up, _, (_, below, _, above) in boxes]
    rows = [max(heights[i : i + columns]) for i in range(0, len(heights), columns)]
    figure.set_size_inches(width * columns, sum(rows))
    for i, (axes, up, legend, (left, below, right, _)) in enumerate(boxes):
        row, column = divmod(i, columns)
        x, y = column * width, sum(rows[row:]) - heights[i]
        _resize(axes, x + left, y + below, width - left - right, up)
        if legend is not None:
            legend.set_bbox_to_anchor((x + width / 2.0, y), figure.dpi_scale_trans)
    return figure


def _resize(axes: Any, x: float, y: float, across: float, up: float) -> None:
    """Put axes with their lower left corner there, in inches."""
    width, height = axes.figure.get_size_inches()
    axes.set_position((x / width, y / height, across / width, up / height))


def _up(panel: AnyPanel) -> float:
    """Height of the axes: as usual, or what the names of its rows need."""
    if isinstance(panel, SpherePanel):
        return DISC
    if isinstance(panel, Panel):
        return UP * panel.height
    lines: float = 1 + max((name.count("\n") for name in panel.names), default=0)
    if isinstance(panel, DotPanel):
        lines = max(lines, APART * (1 + len(panel.series)))
    return max(0.6 * UP, LINE * lines * len(panel.names))


def _margins(axes: Any, width: float) -> tuple[Any, tuple[float, ...]]:
    """The legend of axes, and the room about them for it and for words, inches."""
    inches = POINTS * width
    pen: Any = RendererSVG(inches, inches, io.StringIO())  # type: ignore[no-untyped-call]
    words = axes.get_tightbbox(pen, for_layout_only=True)
    left, below = (axes.bbox.p0 - words.p0).clip(0.0) / POINTS + EDGE
    right, above = (words.p1 - axes.bbox.p1).clip(0.0) / POINTS + 2.0 * EDGE
    legend = None
    handles, labels = axes.get_legend_handles_labels()
    for columns in range(min(len(labels), MOST_COLUMNS), 0, -1):
        legend = axes.legend(
            handles, labels, loc="lower center", ncols=columns, borderaxespad=0.2
        )
        size = legend.get_window_extent(pen)
        if size.width <= SLACK * inches:
            break
    if legend is not None:
        below += EDGE + size.height / POINTS
    if axes.get_aspect() == "auto":
        left, right = max(LEFT, left / SLACK), max(RIGHT, right / SLACK)
    return legend, (left, below, right, above)


def broken(text: str, room: float, size: float = SIZE) -> str:
    """Break words into lines of so many inches, or within a word at a seam."""
    most = max(1, int(room * POINTS / (LETTER * size)))
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
        lines = [line for name in changes["names"] for line in name.split("\n")]
        left = max(LEFT, LETTER * SIZE / POINTS * max(map(len, lines), default=0))
    across = width - left - RIGHT
    changes["title"] = broken(panel.title, across, TITLE)
    if isinstance(panel, Panel | BarPanel | DotPanel):
        changes["x_label"] = broken(panel.x_label, across)
    if isinstance(panel, Panel):
        # there is some room above and below the axes
        changes["y_label"] = broken(panel.y_label, _up(panel) + 0.3)
    if isinstance(panel, Panel | DotPanel):
        changes["series"] = [
            replace(s, label=broken(s.label, width - 1.0, SMALL)) for s in panel.series
        ]
    return replace(panel, **changes)
