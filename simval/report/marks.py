"""What a panel shows, drawn on its axes: points, lines, bars, shares, ticks and labels.

`paint` draws a panel of any kind, and `placed` says where its points are then, for
the values that the page gives on demand.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import singledispatch
from itertools import compress
from typing import Any

import numpy as np
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullLocator

from simval.arrays import Array
from simval.report.panels import (
    GREY,
    INK,
    MANY,
    SHARE,
    SIMULATED,
    THEORY,
    BarPanel,
    DotPanel,
    HeatPanel,
    Panel,
    Series,
    SpherePanel,
    near,
)
from simval.shapes import Float

SMALL = 8.5  # of words on a panel and of a legend, points
SLANT = 50.0  # of the names below a map of shares, degrees
STEP, SIDE = 0.02, 0.1  # of the axis: between points set side by side, and all of them
SPREAD = 2.0 / 3.0  # of a row, over which the dots of a name are spread
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
