"""Panels drawn on the axes of a figure."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import singledispatch
from itertools import compress
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.report.layout import LINE, RIGHT, SMALL, legend_rows
from simval.report.palette import GREY, SIMULATED, THEORY
from simval.report.panels import AnyPanel, Panel, Series, SpherePanel
from simval.report.ticks import label_ticks

TICK_LABELS = 0.32  # their height and the space about them, inches
FARTHEST = 1e290  # an axis multiplies its ends by some factors of ten
MANY = 1500
"""Points of a series beyond which it is drawn as pixels: as vectors 20 000 with their
bars take 8.8 MB of the page, as pixels 0.1 MB; the words stay text."""
HALF, RIM = (
    1.75,
    1.56,
)  # of its axes, and just outside of a half sphere, whose radius is the root of 2
STEP, SIDE = 0.02, 0.1  # of the axis: between points set side by side, and all of them


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
    panel = _drawable(panel)
    places = [s.x for s in panel.series]
    panel = _dodged(panel)
    for start, stop in panel.spans:
        axes.axvspan(start, stop, color=GREY, alpha=0.25, linewidth=0)
    for i, series in enumerate(panel.series):
        with tagged(axes, i):
            if series.line:
                _line(series, axes)
            else:
                _points(series, axes, upper_limits=panel.log_y)
    _references(panel, axes)
    _scales(panel, axes)
    if panel.limits is not None:
        axes.set_ylim(*panel.limits)
    elif panel.log_y:
        _limit(panel, axes)
    _one_place(panel, axes)
    label_ticks(panel, axes, places)
    axes.set_title(panel.title, y=1.0)  # an automatic place takes a third longer
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)


def legend(panel: AnyPanel, axes: Any, left: float, width: float) -> None:
    """Place the legend below the words of the axis, across the panel."""
    columns, lines = legend_rows(panel, width)
    if not lines:
        return
    x_label = getattr(panel, "x_label", "")
    words = LINE * (x_label.count("\n") + 1) + TICK_LABELS
    height = axes.get_position().height * axes.figure.get_figheight()
    axes.legend(
        loc="upper center",
        bbox_to_anchor=((width / 2.0 - left) / (width - left - RIGHT), -words / height),
        borderaxespad=0.0,
        borderpad=0.2,
        ncols=columns,
    )


def _one_place(panel: Panel, axes: Any) -> None:
    """Give a single x the middle of an axis of its own size."""
    found = np.unique(np.concatenate([s.x for s in panel.series] or [np.empty(0)]))
    if len(found) == 1 and panel.log_x:
        axes.set_xlim(float(found[0]) / 2.2, float(found[0]) * 2.2)


def near(values: Array) -> Any:
    """Whether values can be on an axis: finite, and not near overflow."""
    return np.abs(values) < FARTHEST  # NaN is not


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
    step = min(STEP, SIDE / (len(points) - 1))
    steps = iter(step * (np.arange(len(points)) - (len(points) - 1) / 2.0))
    series = []
    for s in panel.series:
        x = s.x
        if not s.line and len(x):
            shift = next(steps)
            x = x * (high / low) ** shift if panel.log_x else x + shift * (high - low)
        series.append(replace(s, x=x))
    return replace(panel, series=tuple(series))


def _references(panel: Panel, axes: Any) -> None:
    """Lines across: of one style where none has a label, else in turn."""
    named = any(label for _, label in panel.references)
    for i, (height, label) in enumerate(panel.references):
        axes.axhline(
            height,
            color=GREY,
            linewidth=1.2,
            linestyle=(0, (4, 2)) if i % 2 == 0 or not named else (0, (1, 1)),
            label=label or "_nolegend_",
            zorder=1.5,
        )


def _scales(panel: Panel, axes: Any) -> None:
    if panel.log_x:
        axes.set_xscale("log", nonpositive="mask")
    if panel.log_y:
        axes.set_yscale("log", nonpositive="clip")


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
    for x, y, words in ((RIM, 0.0, "x"), (0.0, RIM, "y")):
        axes.text(x, y, words, ha="center", va="center", fontsize=SMALL)
    axes.set_aspect("equal")
    axes.set(xlim=(-HALF, HALF), ylim=(-HALF, HALF))
    axes.grid(False)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_title(panel.title, y=1.0)  # an automatic place takes a third longer
