"""Drawings as inline SVG or PNG: same data, same bytes; text stays text.

Axes, ticks and labels are drawn in one placeholder colour that becomes
``currentColor`` in SVG, so that the page's own colours, light or dark, apply to them.
"""

import io
import re
from html import escape
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from simval.report import live, named  # noqa: F401  named registers what it draws
from simval.report.axes import legend, paint
from simval.report.layout import RIGHT, SIZE, SMALL, TITLE, Layout, laid_out
from simval.report.palette import GREY, INK
from simval.report.panels import Drawing

DOTS_PER_INCH = 160  # of points drawn as pixels: sharp on a screen at twice its size
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
    return "".join(map(_svg, laid_out(drawing).parts))


def _svg(room: Layout) -> str:
    """Draw as an ``svg`` element with prefixed ids and a text alternative."""
    name = root(room.drawing)
    buffer = io.StringIO()
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    style: Any = {**STYLE, "svg.hashsalt": name}
    with mpl.rc_context(style):
        figure = _figure(room)
        figure.savefig(buffer, format="svg", dpi=DOTS_PER_INCH, metadata=nothing)
        over = live.points(figure, room.drawing.panels)
    text = buffer.getvalue()
    text = live.with_keys(text[text.index("<svg") :], room.drawing.panels)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = _without_idle_ids(text)
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
    label = f'role="img" aria-label="{escape(room.drawing.alternative)}"'
    if not over and "data-key=" not in rest:
        return f'{head} id="{name}" {label}>{rest}'
    image, end = rest.rsplit("</svg>", 1)
    titles = escape("; ".join(panel.title for panel in room.drawing.panels))
    whole = f'{head} id="{name}" role="group" aria-label="{titles}">'
    return f"{whole}\n<g {label}>{image}</g>\n{over}</svg>{end}"


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
    return _svg(laid_out(drawing)).replace(">", ">" + paper, 1) + "\n"


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
        _figure(laid_out(drawing)).savefig(
            buffer, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None}
        )
    return buffer.getvalue()


def _without_idle_ids(text: str) -> str:
    """Drop the ids that nothing refers to, and the indentation."""
    used = set(re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', text))
    kept = {first or second for first, second in used}
    text = re.sub(r' id="([^"]*)"', lambda m: m[0] if m[1] in kept else "", text)
    return re.sub(r">\s+<", ">\n<", text)


def _rounded(tag: re.Match[str]) -> str:
    """Round the coordinates in a tag to a hundredth of a point, which is invisible."""
    return re.sub(r"\d+\.\d{3,}", lambda m: f"{float(m[0]):.2f}", tag[0])


def _figure(room: Layout) -> Figure:
    """The panels of a drawing, side by side."""
    columns = min(len(room.ups), room.drawing.columns)
    tall = room.heights
    rows = [max(tall[i : i + columns]) for i in range(0, len(tall), columns)]
    figure = Figure(figsize=(room.width * columns, sum(rows)))
    for i, height in enumerate(tall):
        row, column = divmod(i, columns)
        below = sum(rows[row:]) - height
        _add(figure, room, i, (column * room.width, below))
    live.name_parts(figure, room.drawing.panels)
    return figure


def _add(
    figure: Figure, room: Layout, number: int, corner: tuple[float, float]
) -> None:
    """Draw a panel with its lower left corner there, in inches."""
    width, height = figure.get_size_inches()
    x, y = corner
    across, up = room.width - room.left - RIGHT, room.ups[number]
    axes = figure.add_axes(
        (
            (x + room.left) / width,
            (y + room.bottoms[number]) / height,
            across / width,
            up / height,
        )
    )
    panel = room.drawing.panels[number]
    paint(panel, axes)
    legend(panel, axes, room.left, room.width)
