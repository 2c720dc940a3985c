"""Figures as inline SVG: same data, same bytes; text stays text; light and dark.

Axes, ticks and labels are drawn in one placeholder colour that becomes
``currentColor``, so that the page's own colours apply to them.
"""

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation

from simval.arrays import Array

INK = "#010203"
# Okabe and Ito's palette: told apart with every kind of colour vision
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
# label minor ticks only where an axis has less than one decade, and then only some
MINOR_THRESHOLDS = (1.0, 0.4)
STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 10,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 11,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": "#8c8c8c",
    "grid.alpha": 0.35,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """One curve of a panel.

    Attributes
    ----------
    label : str
        For the legend; empty leaves it out.
    x, y : Array
        Points, (n,).
    band : Array or None
        Half width of the confidence band about each y, (n,).
    colour : str
        A colour.
    line : str
        Matplotlib line style; empty draws points.
    """

    label: str
    x: Array
    y: Array
    band: Array | None = None
    colour: str = COLOURS[0]
    line: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panel:
    """One set of axes.

    Attributes
    ----------
    title, x_label, y_label : str
        Words, with units.
    series : sequence of Series
        Curves, drawn in order.
    log_x, log_y : bool
        Logarithmic axes.
    """

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series] = field(default_factory=tuple)
    log_x: bool = True
    log_y: bool = True


def style(name: str) -> Any:
    """Drawing parameters of a figure, for ``matplotlib.rc_context``.

    Parameters
    ----------
    name : str
        The figure's name, the salt of its ids.

    Returns
    -------
    dict
        Parameters.
    """
    return {**STYLE, "svg.hashsalt": name}


def draw(panels: Sequence[Panel], name: str, alternative: str) -> str:
    """Draw panels side by side.

    Parameters
    ----------
    panels : sequence of Panel
        One or more.
    name : str
        Prefix of every id in the figure; unique on the page.
    alternative : str
        What the figure shows, for those who cannot see it.

    Returns
    -------
    str
        An ``svg`` element.
    """
    with mpl.rc_context(style(name)):
        columns = min(len(panels), 3)
        rows = -(-len(panels) // columns)
        figure = Figure(figsize=(4.3 * columns, 3.6 * rows), layout="constrained")
        for i, panel in enumerate(panels):
            _panel(figure.add_subplot(rows, columns, i + 1), panel)
        return svg(figure, name, alternative)


def svg(figure: Figure, name: str, alternative: str) -> str:
    """Serialise a figure with prefixed ids, no date and a text alternative.

    Parameters
    ----------
    figure : Figure
        What to serialise.
    name : str
        Prefix of every id.
    alternative : str
        Text alternative.

    Returns
    -------
    str
        An ``svg`` element.
    """
    buffer = io.StringIO()
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    figure.savefig(buffer, format="svg", metadata=nothing)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(xlink:href="#|url\(#)', rf"\g<1>{name}-", text)
    text = text.replace(INK, "currentColor")
    # the size comes from the view box, so the figure can shrink with the page
    head, rest = text.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]*"', "", head)
    label = (
        alternative.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    )
    return f'{head} role="img" aria-label="{label}">{rest}'


def _panel(axes: Any, panel: Panel) -> None:
    for series in panel.series:
        style = {"color": series.colour, "label": series.label or "_nolegend_"}
        if series.line:
            axes.plot(series.x, series.y, linestyle=series.line, **style)
            if series.band is not None:
                axes.fill_between(
                    series.x,
                    series.y - series.band,
                    series.y + series.band,
                    color=series.colour,
                    alpha=0.2,
                    linewidth=0,
                )
        else:
            axes.errorbar(
                series.x,
                series.y,
                yerr=series.band,
                linestyle="none",
                marker="o",
                markersize=4,
                capsize=2,
                **style,
            )
    if panel.log_x:
        axes.set_xscale("log")
        axes.xaxis.set_minor_formatter(_sparse())
    if panel.log_y:
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(_sparse())
    axes.set_title(panel.title)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if any(series.label for series in panel.series):
        axes.legend()


def _sparse() -> LogFormatterSciNotation:
    return LogFormatterSciNotation(minor_thresholds=MINOR_THRESHOLDS)
