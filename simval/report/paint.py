"""Drawings as inline SVG or PNG: same data, same bytes; text stays text.

Every panel has axes of a fixed size. What is about them (title, labels, names, legend)
is measured with the metrics of DejaVu Sans, and the margins are made for it; long words
are broken into lines before. Axes, ticks and labels are drawn in one placeholder colour
that becomes ``currentColor`` in SVG, so that the page's own colours, light or dark,
apply to them.
"""

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import singledispatch
from html import escape
from itertools import compress
from textwrap import wrap
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullLocator

from simval.arrays import Array
from simval.report import interactivity
from simval.report.panels import (
    GREY,
    INK,
    MANY,
    SHARE,
    SIMULATED,
    THEORY,
    AnyPanel,
    BarPanel,
    DotPanel,
    Drawing,
    HeatPanel,
    Panel,
    Series,
    SpherePanel,
    near,
    told,
)
from simval.shapes import Float

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
SIZE, TITLE, SMALL = 10.0, 11.0, 8.5  # of labels, titles and legends, points
LETTER = 0.6  # mean width of a letter over its height
SLACK = 0.92  # share of the room that is used, for a reader with a wider font
SLANT = 50.0  # of the names below a map of shares, degrees
SEAMS = re.compile(r"(?<=[_:,=/])")
"""After these letters a word that is longer than a line is broken."""

STEP, SIDE = 0.02, 0.1  # of the axis: between points set side by side, and all of them
SPREAD = 2.0 / 3.0  # of a row, over which the dots of a name are spread
APART = 0.45  # of a line, between the dots of a name
WIDEST = 10.0
"""Greatest value over the least up to which an axis of ratios is linear."""
FAINT, FULL = 0.12, 0.6
"""Opacity of the least and of the whole share: words on it keep a contrast of 5."""

MANTISSAS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
"""Ticks within a decade of a logarithmic axis, the fewest first."""
ENOUGH, PLACES = 3, 6
"""Labels that an axis has where it can; places of data that are named one by one."""
GAP = 0.15
"""Least distance of two labels along an axis, as a share of it: five digits."""
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

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


@contextmanager
def tagged(axes: Any, place: int) -> Iterator[None]:
    """Name what is drawn meanwhile as parts of the series of this place."""
    before = set(axes.get_children())
    yield
    for artist in axes.get_children():
        if artist not in before:
            artist.set_gid(f"series-{place}")


@singledispatch
def paint(panel: object, axes: Any) -> None:
    """Draw a panel."""
    raise TypeError(type(panel))


@singledispatch
def placed(panel: object) -> Sequence[Series]:
    """Series of a panel with their points where they are drawn."""
    return ()


@paint.register
def _(panel: Panel, axes: Any) -> None:
    panel = _drawable(panel)
    for start, stop in panel.spans:
        axes.axvspan(start, stop, color=GREY, alpha=0.25, linewidth=0)
    for i, series in enumerate(_dodged(panel)):
        with tagged(axes, i):
            if series.line:
                _line(series, axes)
            else:
                _points(series, axes, upper_limits=panel.log_y)
    named = any(label for _, label in panel.references)
    for i, (height, label) in enumerate(panel.references):
        axes.axhline(  # of one style where none has a label, else in turn
            height,
            color=GREY,
            linewidth=1.2,
            linestyle=(0, (4, 2)) if i % 2 == 0 or not named else (0, (1, 1)),
            label=label or "_nolegend_",
            zorder=1.5,
        )
    _scales(panel, axes)
    axes.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label)


def _scales(panel: Panel, axes: Any) -> None:
    """Axes that are linear or logarithmic, their limits and labels."""
    places = [s.x for s in panel.series]
    if panel.log_x:
        axes.set_xscale("log", nonpositive="mask")
        found = np.unique(np.concatenate(places))
        if len(found) == 1:  # a single place gets the middle
            axes.set_xlim(float(found[0]) / 2.2, float(found[0]) * 2.2)
        label_decades(axes.xaxis, found)
    elif places and all(np.array_equal(x, np.rint(x)) for x in places):
        axes.locator_params(axis="x", integer=True)  # half an iteration is none
    if panel.log_y:
        axes.set_yscale("log", nonpositive="clip")
    if panel.limits is not None:
        axes.set_ylim(*panel.limits)
    elif panel.log_y:
        _limit(panel, axes)
    if panel.log_y:
        label_decades(axes.yaxis)


@placed.register
def _(panel: Panel) -> Sequence[Series]:
    panel = _drawable(panel)
    series = []
    for s in _dodged(panel):
        limits = ~_whole(s, upper_limits=panel.log_y and not s.line)
        shift = 0.0 if s.band is None else np.where(limits, s.band, 0.0)
        series.append(replace(s, y=s.y + shift))
    return series


def _drawable(panel: Panel) -> Panel:
    """Leave out points that cannot be on the axes; without data axes are linear."""
    series = []
    for s in panel.series:
        with np.errstate(over="ignore", invalid="ignore"):  # such are left out
            top = s.y if s.line or s.band is None else s.y + s.band  # an upper limit
        good = near(s.x) & near(s.y) & near(top)
        good &= (s.x > 0.0) | (not panel.log_x)
        good &= (top > 0.0) | (not panel.log_y)
        band = None if s.band is None else np.where(near(s.band), s.band, 0.0)[good]
        notes = tuple(compress(s.notes, good))
        series.append(replace(s, x=s.x[good], y=s.y[good], band=band, notes=notes))
    any_left = any(len(s.x) for s in series)
    return replace(
        panel,
        series=series,
        log_x=panel.log_x and any_left,
        log_y=panel.log_y and any_left,
    )


def _dodged(panel: Panel) -> Sequence[Series]:
    """The series, the points of each shifted a little, by a fraction of the axis."""
    points = [s for s in panel.series if not s.line and len(s.x)]
    if not panel.dodge or len(points) < 2:
        return panel.series
    places = np.concatenate([s.x for s in points])
    low, high = float(places.min()), float(places.max())
    step = min(STEP, SIDE / (len(points) - 1))
    steps = iter(step * (np.arange(len(points)) - (len(points) - 1) / 2.0))
    series = []
    for s in panel.series:
        x = s.x
        if not s.line and len(x):
            shift = next(steps)
            x = x * (high / low) ** shift if panel.log_x else x + shift * (high - low)
        series.append(replace(s, x=x))
    return series


def _line(series: Series, axes: Any) -> None:
    pixels = len(series.x) > MANY
    axes.plot(
        series.x,
        series.y,
        linestyle=series.line,
        color=series.colour,
        label=series.label or "_nolegend_",
        linewidth=1.4,
        rasterized=pixels,
    )
    if series.band is not None:
        axes.fill_between(
            series.x,
            series.y - series.band,
            series.y + series.band,
            color=series.colour,
            alpha=0.2,
            linewidth=0,
            rasterized=pixels,
        )


def _points(series: Series, axes: Any, *, upper_limits: bool) -> None:
    """Points with bars; on a logarithmic axis an upper limit if the bar reaches 0."""
    band, pixels = series.band, len(series.x) > MANY
    whole = _whole(series, upper_limits=upper_limits)
    if upper_limits and band is not None:
        axes.plot(
            series.x[~whole],
            (series.y + band)[~whole],
            marker="v",
            markersize=5,
            markerfacecolor="none",
            color=series.colour,
            linestyle="none",
            rasterized=pixels,
        )
    axes.errorbar(
        series.x[whole],
        series.y[whole],
        yerr=None if band is None else band[whole],
        linestyle="none",
        marker=series.marker,
        color=series.colour,
        label=series.label or "_nolegend_",
        rasterized=pixels,
    )


def _whole(series: Series, *, upper_limits: bool) -> Any:
    """Which points are no upper limits: those whose bar does not reach 0."""
    if not upper_limits or series.band is None:
        return np.ones(len(series.x), dtype=bool)
    return ~(series.y - series.band <= 0.0)


def _limit(panel: Panel, axes: Any) -> None:
    """Fit a logarithmic axis to what is positive on it, references included."""
    heights = [np.array([height for height, _ in panel.references], dtype=float)]
    for series in panel.series:
        heights.append(np.asarray(series.y, dtype=float))
        if series.band is not None:
            heights.append(series.y + series.band)
    values = np.concatenate(heights)
    values = values[np.isfinite(values) & (values > 0.0)]
    if values.size:
        axes.set_ylim(values.min() / 1.5, values.max() * 1.5)


@paint.register
def _(panel: SpherePanel, axes: Any) -> None:
    for directions, mark, colour in (
        (panel.directions, "o", SIMULATED),
        (panel.wanted, "D", THEORY),
    ):
        half = directions[panel.sign * directions[:, 2] >= 0.0]
        # Lambert's azimuthal equal-area projection about the pole
        scale = np.sqrt(2.0 / (1.0 + np.abs(half[:, 2])))
        axes.plot(half[:, 0] * scale, half[:, 1] * scale, mark, color=colour, ms=5)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for degrees in (30, 60, 90):
        radius = 2.0 * np.sin(np.radians(degrees) / 2.0)
        axes.plot(radius * np.cos(angle), radius * np.sin(angle), color=GREY, lw=0.6)
    rim = 1.1 * radius
    for x, y, words in ((rim, 0.0, "x"), (0.0, rim, "y")):
        axes.text(x, y, words, ha="center", va="center", fontsize=SMALL)
    axes.set(title=panel.title, aspect="equal", xlim=(-1.7, 1.7), ylim=(-1.7, 1.7))
    axes.set_axis_off()


@paint.register
def _(panel: BarPanel, axes: Any) -> None:
    places = np.arange(len(panel.names))[::-1]
    measured, band, predicted = (
        np.where(near(values), values, np.nan)
        for values in (panel.measured, panel.band, panel.predicted)
    )
    axes.barh(
        places, measured, height=0.6, color=SIMULATED, label="measured", alpha=0.5
    )
    axes.errorbar(measured, places, xerr=band, linestyle="none", color=INK)
    axes.plot(predicted, places, "D", color=THEORY, ms=5, label="predicted", ls="none")
    axes.set_yticks(places, panel.names)
    axes.grid(visible=False, axis="y")
    axes.set(title=panel.title, xlabel=panel.x_label)


@placed.register
def _(panel: BarPanel) -> Sequence[Series]:
    """The ends of the bars, where the page says their values."""
    good = near(panel.measured)
    places = np.arange(float(len(panel.names)))[::-1]
    notes = tuple(compress(panel.notes, good))
    return [
        Series(label="measured", x=panel.measured[good], y=places[good], notes=notes)
    ]


@placed.register
def _(panel: DotPanel) -> Sequence[Series]:
    count, series = len(panel.series), []
    for i, s in enumerate(panel.series):
        shift = 0.0 if count == 1 else (i / (count - 1) - 0.5) * SPREAD
        good = near(s.x)
        y = len(panel.names) - 1 - s.y[good] - shift
        band = None if s.band is None else s.band[good]
        notes = tuple(compress(s.notes, good))
        series.append(replace(s, x=s.x[good], y=y, band=band, notes=notes))
    return series


@paint.register
def _(panel: DotPanel, axes: Any) -> None:
    rows = len(panel.names)
    place, _ = panel.reference
    for low in range(1, rows, 2):  # every second row is shaded
        axes.axhspan(low - 0.5, low + 0.5, color=GREY, alpha=0.12, linewidth=0)
    axes.axvline(place, color=GREY, linewidth=1.2, linestyle=(0, (4, 2)))
    for i, series in enumerate(placed(panel)):
        with tagged(axes, i):
            axes.errorbar(
                series.x,
                series.y,
                xerr=series.band,
                linestyle="none",
                marker=series.marker,
                color=series.colour,
                label=series.label or "_nolegend_",
            )
    axes.set_ylim(-0.5, rows - 0.5)
    axes.set_yticks(np.arange(rows)[::-1], panel.names)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set(title=panel.title, xlabel=panel.x_label)
    # a linear axis with the reference on it, or a logarithmic one for many tens
    values = np.concatenate([s.x[near(s.x)] for s in panel.series])
    every = np.append(values, place)
    if np.all(every > 0.0) and every.max() > WIDEST * every.min():
        axes.set_xscale("log", nonpositive="mask")
        label_decades(axes.xaxis)
        return
    axes.locator_params(axis="x", nbins=5)
    low, high = axes.get_xlim()
    if not high - low >= 0.02 * abs(place):  # nothing but the reference
        axes.set_xlim(place - 0.01, place + 0.01)


@paint.register
def _(panel: HeatPanel, axes: Any) -> None:
    rows, columns = panel.shares.shape
    for i, j in np.ndindex(rows, columns):
        share, y = float(panel.shares[i, j]), rows - 1 - i
        if not share > 0.0:
            words = "" if share == 0.0 else "?"
        else:
            words = percent(share)
            alpha = FAINT + (FULL - FAINT) * share
            axes.add_patch(
                Rectangle((j - 0.5, y - 0.5), 1, 1, color=SHARE, lw=0, alpha=alpha)
            )
        if panel.expected[i, j] and words:
            words = f"({words})"
        axes.text(j, y, words, ha="center", va="center", fontsize=SMALL)
    axes.set(title=panel.title, xlim=(-0.5, columns - 0.5), ylim=(-0.5, rows - 0.5))
    axes.set_yticks(np.arange(rows)[::-1], panel.names)
    axes.set_xticks(
        np.arange(columns), panel.columns, rotation=SLANT, ha="right",
        rotation_mode="anchor", fontsize=SMALL,
    )  # fmt: skip
    axes.grid(visible=False)
    axes.set_xticks(np.arange(columns - 1) + 0.5, minor=True)
    axes.set_yticks(np.arange(rows - 1) + 0.5, minor=True)
    axes.grid(visible=True, which="minor")
    axes.tick_params(which="both", length=0)


def percent(share: float) -> str:
    """A share in percent: never 0 where some fail, never 100 where some do not."""
    if share < 0.01:
        return "<1"
    return ">99" if 0.99 < share < 1.0 else f"{100.0 * share:.0f}"


def label_decades(axis: Any, places: Float[Array, " n"] | None = None) -> None:
    """Label a logarithmic axis: at the few places of its data, or at round numbers."""
    low, high = sorted(axis.get_view_interval())
    ticks = log_ticks(
        float(low), float(high), np.empty(0) if places is None else places
    )
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FixedFormatter([spelled(tick) for tick in ticks]))
    axis.set_minor_locator(NullLocator())


def log_ticks(low: float, high: float, places: Float[Array, " n"]) -> list[float]:
    """Ticks of an axis from low to high: two at least."""
    if not 0.0 < low < high < np.inf:
        return []
    inside = [float(x) for x in places if low <= x <= high]
    if 2 <= len(inside) <= PLACES and len(inside) == len(places):
        apart = np.diff(np.log(inside)) / np.log(high / low)
        if np.all(apart >= GAP) and all(len(spelled(x)) <= 5 for x in inside):
            return inside
    # decades, thinned where they are many; parts of them where they are few
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for mantissas in MANTISSAS:
        every = [float(f"{m:g}e{power}") for power in powers for m in mantissas]
        ticks = [tick for tick in every if low <= tick <= high]
        if len(ticks) >= ENOUGH:
            step = -(-len(ticks) // PLACES) if mantissas == (1.0,) else 1
            return ticks[::step]
    even = MaxNLocator(4).tick_values(low, high)
    return [float(tick) for tick in even if low <= tick <= high]


def spelled(x: float) -> str:
    """Spell a number of an axis: 0.1, 10⁻⁵, 3×10⁻⁵."""
    if 1e-3 <= x < 1e5:
        return f"{x:.6g}"
    head, _, power = f"{x:.2e}".partition("e")
    raised = f"10{str(int(power)).translate(SUPERSCRIPTS)}"
    head = head.rstrip("0").rstrip(".")
    return raised if head == "1" else f"{head}×{raised}"
