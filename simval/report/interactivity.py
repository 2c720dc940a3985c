"""Interactive figures: data of their points, and legends that select series.

The figure is one image for a screen reader. Over it lie its points, each an invisible
disc with a title, which every browser shows where the pointer rests. The page's script
makes a box of text of them, lets the keyboard reach them and makes buttons of the
entries of a legend; without it nothing is lost but these. Points that are drawn as
pixels (`MANY` and more) have neither.
"""

import re
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from simval.report.panels import MANY, AnyPanel, DotPanel, Drawing, Panel, Series

DISC = 5.0
"""Radius within which a point is met, points: somewhat more than its mark."""


def name_parts(figure: Figure, panels: Sequence[AnyPanel]) -> None:
    """Give the series and the entries of the legends names that are unique."""
    for i, (panel, axes) in enumerate(zip(panels, figure.axes, strict=True)):
        for artist in axes.get_children():
            if str(artist.get_gid()).startswith("series-"):
                artist.set_gid(f"{artist.get_gid()}-{i}")
        legend = axes.get_legend()
        # in lines, which may end within a word
        labels = ["".join(label.split()) for label in _labels(panel)]
        if legend is None:
            continue
        entries = zip(legend.legend_handles, legend.get_texts(), strict=True)
        for handle, text in entries:
            words = "".join(text.get_text().split())
            if handle is not None and words in labels:
                name = f"key-{labels.index(words)}-{i}"
                handle.set_gid(name)
                text.set_gid(name)


def with_keys(text: str, panels: Sequence[AnyPanel]) -> str:
    """Turn the names of series and legends in an SVG into attributes for the script."""
    keys = [_keys(panel) for panel in panels]

    def of_series(match: re.Match[str]) -> str:
        place, panel = int(match[1]), int(match[2])
        return f'<g data-keys="{_names(keys[panel][place], panel)}"'

    text = re.sub(r'<g id="series-(\d+)-(\d+)"', of_series, text)
    drawn = {k for n in re.findall(r'data-keys="([^"]*)"', text) for k in n.split()}

    def of_entry(match: re.Match[str]) -> str:
        name = f"{match[1]}-{match[2]}"
        return f'<g data-key="{name}"' if name in drawn else "<g"

    return re.sub(r'<g id="key-(\d+)-(\d+)"', of_entry, text)


def points(
    figure: Figure, panels: Sequence[AnyPanel], placed: Sequence[Sequence[Series]]
) -> str:
    """Discs with titles over the points of a figure that has been drawn."""
    height = figure.bbox.height  # a pixel is a point
    groups = []
    for i, (panel, axes) in enumerate(zip(panels, figure.axes, strict=True)):
        drawn = placed[i]
        keys = _keys(panel) or [[] for _ in drawn]  # those of bars are not switched
        for series, own in zip(drawn, keys, strict=True):
            discs = _discs(series, axes, height)
            if not discs:
                continue
            label = " ".join(f"{panel.title}, {series.label}".strip(", ").split())
            groups.append(
                f'<g class="points" data-keys="{_names(own, i)}" role="group" '
                f'aria-label="{escape(label)}">\n{discs}</g>\n'
            )
    if not groups:
        return ""
    return f'<g fill="none" pointer-events="all">\n{"".join(groups)}</g>\n'


def silent(drawing: Drawing) -> bool:
    """Whether it has points that would say something, were they not pixels."""
    every = [series for panel in drawing.panels for series in _series(panel)]
    return any(len(series.notes) > MANY for series in every)


def _discs(series: Series, axes: Any, height: float) -> str:
    """The points of a series that are within its axes."""
    if not len(series.notes) == len(series.x) <= MANY:
        return ""
    pixels = axes.transData.transform(np.column_stack([series.x, series.y]))
    low, high = axes.bbox.padded(1.0).get_points()
    inside = np.all((pixels >= low) & (pixels <= high), axis=1)
    return "".join(
        f'<circle cx="{x:.1f}" cy="{height - y:.1f}" r="{DISC:g}" '
        f'role="img"><title>{escape(words, quote=False)}</title></circle>\n'
        for (x, y), words, within in zip(pixels, series.notes, inside, strict=True)
        if within
    )


def _series(panel: AnyPanel) -> Sequence[Series]:
    return panel.series if isinstance(panel, Panel | DotPanel) else ()


def _labels(panel: AnyPanel) -> list[str]:
    """Entries of the legend of a panel."""
    return list(dict.fromkeys(s.label for s in _series(panel) if s.label))


def _names(keys: Sequence[int], panel: int) -> str:
    return " ".join(f"{key}-{panel}" for key in keys)


def _keys(panel: AnyPanel) -> list[list[int]]:
    """Entries of the legend that show and hide each series."""
    series, labels = _series(panel), _labels(panel)
    return [
        sorted(
            {labels.index(o.label) for o in series if o.label and _holds(o, s, series)}
        )
        for s in series
    ]


def _holds(entry: Series, s: Series, series: Sequence[Series]) -> bool:
    """True if a legend entry shows and hides a series.

    Its own does. A line without one, and the line that stands in the legend for such
    lines of its style, belongs to the marks of its colour as well.
    """
    if entry.label == s.label:
        return True
    alike = bool(s.line) and any(not o.label and o.line == s.line for o in series)
    if s.label and not alike:
        return False
    beside = entry.colour == s.colour and bool(entry.line) != bool(s.line)
    return beside or (not s.label and bool(s.line) and entry.line == s.line)
