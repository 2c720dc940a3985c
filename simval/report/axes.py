"""Panels drawn on the axes of a figure."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import singledispatch
from itertools import compress
from typing import Any

import numpy as np
from matplotlib.ticker import LogFormatter

from simval.arrays import Array
from simval.report.layout import LINE, legend_below
from simval.report.panels import COLOURS, GREY, Panel, Series, SpherePanel

INK = "#010203"
# label minor ticks only where an axis has less than one decade, and then only some
MINOR_THRESHOLDS = (1.0, 0.4)
TICK_LABELS = 0.25  # their height and the space about them, inches
FARTHEST = 1e290  # an axis multiplies its ends by some factors of ten
MANY = 1500
"""Points of a series beyond which it is drawn as pixels: as vectors 20 000 with their
bars take 8.8 MB of the page, as pixels 0.1 MB; the words stay text (measured:
docs/decisions/0068)."""
STEP = 0.012  # of the axis, between points that are set side by side
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Decades(LogFormatter):
    """Labels of a logarithmic axis in plain text: 0.1, 10⁻⁵, 3×10⁻⁵."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Spell a tick, or leave it empty where the axis has enough without it."""
        mantissa = f"{x:.0e}"[0]
        if not super().__call__(x, pos) or mantissa not in "125":
            return ""  # labels at 1, 2 and 5 never touch
        if 1e-3 <= x < 1e5:
            return f"{x:g}"
        head, _, power = f"{x:.0e}".partition("e")
        raised = f"10{str(int(power)).translate(SUPERSCRIPTS)}"
        return raised if head == "1" else f"{head}×{raised}"


@singledispatch
def paint(panel: object, axes: Any) -> None:
    """Draw a panel."""
    raise TypeError(type(panel))


@contextmanager
def tagged(axes: Any, place: int) -> Iterator[None]:
    """Name what is drawn meanwhile as parts of the series of this place."""
    before = set(axes.get_children())
    yield
    for artist in axes.get_children():
        if artist not in before:
            artist.set_gid(f"series-{place}")


@singledispatch
def placed(panel: object) -> Sequence[Series]:
    """Series of a panel with their points where they are drawn."""
    return ()


@placed.register
def _(panel: Panel) -> Sequence[Series]:
    panel = _dodged(_drawable(panel))
    series = []
    for s in panel.series:
        limits = ~_whole(s, upper_limits=panel.log_y and not s.line)
        shift = 0.0 if s.band is None else np.where(limits, s.band, 0.0)
        series.append(replace(s, y=s.y + shift))
    return series


@paint.register
def _(panel: Panel, axes: Any) -> None:
    panel = _dodged(_drawable(panel))
    for start, stop in panel.spans:
        axes.axvspan(start, stop, color=COLOURS[2], alpha=0.18, linewidth=0)
    for i, series in enumerate(panel.series):
        with tagged(axes, i):
            if series.line:
                _line(series, axes)
            else:
                _points(series, axes, upper_limits=panel.log_y)
    _references(panel, axes)
    _scales(panel, axes)
    if panel.log_y:
        _limit(panel, axes)
    axes.set_title(panel.title, y=1.0)  # an automatic place takes a third longer
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    _legend(panel, axes)


def _legend(panel: Panel, axes: Any) -> None:
    """Place the legend among the curves, or below the axes if it would hide them."""
    if not any(series.label for series in panel.series):
        return
    if not legend_below(panel):
        # finding the best place among many points takes seconds
        many = any(len(s.x) > MANY for s in panel.series)
        axes.legend(loc="upper right" if many else "best")
        return
    legend_under(panel.x_label, axes)


def legend_under(x_label: str, axes: Any, columns: int = 1) -> None:
    """Place the legend below the words of the axis."""
    words = LINE * (x_label.count("\n") + 1) + TICK_LABELS
    height = axes.get_position().height * axes.figure.get_figheight()
    axes.legend(
        loc="upper center",
        bbox_to_anchor=(0.5, -words / height),
        borderaxespad=0.0,
        ncols=columns,
    )


def near(values: Array) -> Any:
    """Whether values can be on an axis: finite, and not near overflow."""
    return np.abs(values) < FARTHEST  # NaN is not


def _drawable(panel: Panel) -> Panel:
    """Leave out points that cannot be on the axes; without data axes are linear."""
    series = []
    for s in panel.series:
        top = s.y if s.line or s.band is None else s.y + s.band  # of an upper limit
        good = near(s.x) & near(s.y) & near(top)
        good &= (s.x > 0.0) | (not panel.log_x)
        good &= (top > 0.0) | (not panel.log_y)
        band = None if s.band is None else np.where(near(s.band), s.band, 0.0)[good]
        notes = tuple(compress(s.notes, good))
        series.append(replace(s, x=s.x[good], y=s.y[good], band=band, notes=notes))
    any_left = any(len(s.x) for s in series)
    return replace(
        panel,
        series=tuple(series),
        log_x=panel.log_x and any_left,
        log_y=panel.log_y and any_left,
    )


def _dodged(panel: Panel) -> Panel:
    """Shift the points of each series a little, by a fraction of the axis."""
    points = [s for s in panel.series if not s.line and len(s.x)]
    if not panel.dodge or len(points) < 2:
        return panel
    places = np.concatenate([s.x for s in points])
    low, high = float(places.min()), float(places.max())
    steps = iter(STEP * (np.arange(len(points)) - (len(points) - 1) / 2.0))
    series = []
    for s in panel.series:
        x = s.x
        if not s.line and len(x):
            step = next(steps)
            x = x * (high / low) ** step if panel.log_x else x + step * (high - low)
        series.append(replace(s, x=x))
    return replace(panel, series=tuple(series))


def _references(panel: Panel, axes: Any) -> None:
    for height, label in panel.references:
        axes.axhline(height, color=GREY, linewidth=1.0, linestyle=(0, (1, 1)))
        axes.annotate(
            label,
            (1.0, height),
            xycoords=("axes fraction", "data"),
            xytext=(-2, 2),
            textcoords="offset points",
            ha="right",
            fontsize=8.5,
        )


def _scales(panel: Panel, axes: Any) -> None:
    for logarithmic, scale, axis in (
        (panel.log_x, axes.set_xscale, axes.xaxis),
        (panel.log_y, axes.set_yscale, axes.yaxis),
    ):
        if logarithmic:
            scale("log", nonpositive="mask" if axis is axes.xaxis else "clip")
            axis.set_major_formatter(Decades())
            axis.set_minor_formatter(Decades(minor_thresholds=MINOR_THRESHOLDS))


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
        markersize=4,
        capsize=2,
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
        (panel.directions, "o", COLOURS[0]),
        (panel.wanted, "D", COLOURS[1]),
    ):
        half = directions[panel.sign * directions[:, 2] >= 0.0]
        # Lambert's azimuthal equal-area projection about the pole
        scale = np.sqrt(2.0 / (1.0 + np.abs(half[:, 2])))
        axes.plot(half[:, 0] * scale, half[:, 1] * scale, mark, color=colour, ms=5)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for degrees in (30, 60, 90):
        radius = 2.0 * np.sin(np.radians(degrees) / 2.0)
        axes.plot(radius * np.cos(angle), radius * np.sin(angle), color=GREY, lw=0.6)
    axes.set_aspect("equal")
    axes.grid(False)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_title(panel.title, y=1.0)  # an automatic place takes a third longer
