"""Leave out of a figure what cannot be seen in it, and count it.

Points: of those that fall in the same small cell of the axes, the one with the widest
band is kept. Lines: more points than columns of the figure become the least and the
greatest value of each column.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from simval.arrays import Array
from simval.report.panels import AnyPanel, Drawing, Panel, Series

MAX_POINTS = 1500
"""Points of one series that a figure draws at most."""

CELLS = 256
"""Cells of the axes in each direction: a marker is wider than one of them."""

COLUMNS = 800
"""Columns of a line: about the pixels of a panel."""


def thinned(drawing: Drawing) -> tuple[Drawing, int, int]:
    """Thin the series of a drawing."""
    panels = [_thinned_panel(panel) for panel in drawing.panels]
    return (
        replace(drawing, panels=tuple(panels)),
        sum(_count(panel) for panel in panels),
        sum(_count(panel) for panel in drawing.panels),
    )


def _count(panel: AnyPanel) -> int:
    return sum(len(s.x) for s in panel.series) if isinstance(panel, Panel) else 0


def _thinned_panel(panel: AnyPanel) -> AnyPanel:
    if not isinstance(panel, Panel):
        return panel
    series = [
        _extremes(s) if s.line else _spread(s, log_x=panel.log_x, log_y=panel.log_y)
        for s in panel.series
    ]
    return replace(panel, series=tuple(series))


def _spread(series: Series, *, log_x: bool, log_y: bool) -> Series:
    """At most one point in each cell of a grid, the grid coarse enough."""
    if len(series.x) <= MAX_POINTS:
        return series
    x, y = _drawable(series.x, log_x), _drawable(series.y, log_y)
    places = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    band = np.zeros(len(x)) if series.band is None else series.band
    places = places[np.argsort(-band[places], kind="stable")]  # widest band first
    cells, kept = CELLS, places
    while len(kept) > MAX_POINTS or cells == CELLS:
        cell = _cell(x[places], cells) * (cells + 1) + _cell(y[places], cells)
        kept = np.sort(places[np.unique(cell, return_index=True)[1]])
        cells //= 2
    return replace(
        series,
        x=series.x[kept],
        y=series.y[kept],
        band=None if series.band is None else series.band[kept],
    )


def _extremes(series: Series) -> Series:
    """Least and greatest point of a line in each column, in the order of x."""
    count = len(series.x)
    if count <= 2 * COLUMNS:
        return series
    edges = np.linspace(0, count, COLUMNS + 1).astype(int)
    finite = np.isfinite(series.y)
    low = np.where(finite, series.y, np.inf)
    high = np.where(finite, series.y, -np.inf)
    kept = np.unique(
        [
            start + int(pick(values[start:stop]))
            for start, stop in pairwise(edges)
            for pick, values in ((np.argmin, low), (np.argmax, high))
        ]
    )
    return replace(
        series,
        x=series.x[kept],
        y=series.y[kept],
        band=None if series.band is None else series.band[kept],
    )


def _drawable(values: Float[Array, " n"], logarithmic: bool) -> Float[Array, " n"]:
    if not logarithmic:
        return values
    return np.log(np.where(values > 0.0, values, np.nan))


def _cell(values: Float[Array, " n"], cells: int) -> Int[NDArray[np.intp], " n"]:
    low, high = values.min(initial=np.inf), values.max(initial=-np.inf)
    width = high - low if high > low else 1.0
    return np.floor((values - low) / width * cells).astype(np.int64)
