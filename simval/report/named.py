"""Panels with a name for each row, drawn on the axes of a figure: bars, dots, a map."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from typing import Any

import numpy as np
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from simval.report.axes import near, paint, placed, tagged
from simval.report.layout import SLANT, SMALL
from simval.report.palette import GREY, INK, SHARE, SIMULATED, THEORY
from simval.report.panels import BarPanel, DotPanel, HeatPanel, Series
from simval.report.ticks import label_decades

WIDEST = 10.0
"""Greatest value over the least up to which an axis of ratios is linear."""
FAINT, FULL = 0.12, 0.6
"""Opacity of the least and of the whole share: words on it keep a contrast of 5."""
SPREAD = 2.0 / 3.0
"""Part of a row over which the dots of a name are spread."""


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
    axes.errorbar(measured, places, xerr=band, linestyle="none", color=INK, capsize=2)
    axes.plot(predicted, places, "D", color=THEORY, ms=5, label="predicted", ls="none")
    axes.set_yticks(places, panel.names)
    axes.grid(visible=False, axis="y")
    axes.set_title(panel.title, y=1.0)  # an automatic place takes a third longer
    axes.set_xlabel(panel.x_label)


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
                markersize=4,
                capsize=2,
                color=series.colour,
                label=series.label or "_nolegend_",
            )
    axes.set_ylim(-0.5, rows - 0.5)
    axes.set_yticks(np.arange(rows)[::-1], panel.names)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    _ratio_axis(panel, axes)
    axes.set_title(panel.title, y=1.0)
    axes.set_xlabel(panel.x_label)


def _ratio_axis(panel: DotPanel, axes: Any) -> None:
    """A linear axis with the reference on it, or a logarithmic one for many tens."""
    values = np.concatenate([s.x[near(s.x)] for s in panel.series])
    every = np.append(values, panel.reference[0])
    if np.all(every > 0.0) and every.max() > WIDEST * every.min():
        axes.set_xscale("log", nonpositive="mask")
        label_decades(axes.xaxis)
        return
    axes.xaxis.set_major_locator(MaxNLocator(5))
    low, high = axes.get_xlim()
    if not high - low >= 0.02 * abs(panel.reference[0]):  # nothing but the reference
        axes.set_xlim(panel.reference[0] - 0.01, panel.reference[0] + 0.01)


@paint.register
def _(panel: HeatPanel, axes: Any) -> None:
    rows, columns = panel.shares.shape
    for i, j in np.ndindex(rows, columns):
        share, y = float(panel.shares[i, j]), rows - 1 - i
        if not share > 0.0:
            words = "" if share == 0.0 else "?"
        else:
            words = _percent(share)
            axes.add_patch(
                Rectangle(
                    (j - 0.5, y - 0.5), 1.0, 1.0,
                    color=SHARE, linewidth=0,
                    alpha=FAINT + (FULL - FAINT) * share,
                )
            )  # fmt: skip
        if panel.expected[i, j] and words:
            words = f"({words})"
        axes.text(j, y, words, ha="center", va="center", fontsize=SMALL)
    axes.set_xlim(-0.5, columns - 0.5)
    axes.set_ylim(-0.5, rows - 0.5)
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
    axes.set_title(panel.title, y=1.0)


def _percent(share: float) -> str:
    """A share in percent: never 0 where some fail, never 100 where some do not."""
    if share < 0.01:
        return "<1"
    return ">99" if 0.99 < share < 1.0 else f"{100.0 * share:.0f}"
