"""Labels of a logarithmic axis: at the data's own few places, or at round numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.lines import TICKDOWN, TICKLEFT, Line2D  # type: ignore[attr-defined]
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullLocator

from simval.arrays import Array
from simval.report.palette import INK
from simval.report.panels import Panel
from simval.shapes import Float

MANTISSAS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
"""Ticks within a decade, the fewest first."""
ENOUGH = 3
"""Labels that an axis has where it can."""
PLACES = 6
"""Places of data that are named one by one, if they stand apart."""
GAP = 0.15
"""Least distance of two labels along an axis, as a share of it: five digits."""
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def label_ticks(panel: Panel, axes: Any, places: list[Array]) -> None:
    """Label axes that are logarithmic, or on which only whole numbers stand."""
    if panel.log_x:
        label_decades(axes.xaxis, places)
    elif places and all(np.array_equal(x, np.rint(x)) for x in places):
        whole = MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True)
        axes.xaxis.set_major_locator(whole)  # half an iteration is none
    if panel.log_y:
        label_decades(axes.yaxis)


SHORT = 100.0
"""Two decades: a longer axis has no small ticks."""


def label_decades(axis: Any, places: Any = ()) -> None:
    """Label a logarithmic axis: at least two ticks, at its few places or at decades."""
    low, high = sorted(axis.get_view_interval())
    found = np.unique(np.concatenate([*places, np.empty(0)]))
    ticks, labels = log_ticks(float(low), float(high), found)
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FixedFormatter(labels))
    if high <= SHORT * low:
        small_ticks(axis, [x for x in axis.get_minorticklocs() if low <= x <= high])
    axis.set_minor_locator(NullLocator())


def log_ticks(
    low: float, high: float, places: Float[Array, " n"]
) -> tuple[list[float], list[str]]:
    """Ticks of an axis from low to high with their labels; two at least."""
    if not 0.0 < low < high < np.inf:
        return [], []
    if len(places) == 1 and low <= places[0] <= high:
        ticks = _about(float(places[0]), _round(low, high), high / low)
    else:
        ticks = _places(low, high, places) or _round(low, high)
    return ticks, [spelled(tick) for tick in ticks]


def spelled(x: float) -> str:
    """Spell a number of an axis: 0.1, 10⁻⁵, 3×10⁻⁵."""
    if 1e-3 <= x < 1e5:
        return f"{x:.6g}"
    head, _, power = f"{x:.2e}".partition("e")
    raised = f"10{str(int(power)).translate(SUPERSCRIPTS)}"
    head = head.rstrip("0").rstrip(".")
    return raised if head == "1" else f"{head}×{raised}"


def small_ticks(axis: Any, places: Sequence[float]) -> None:
    """Draw small ticks as the marks of one line: each as a tick takes 2 ms."""
    at, zeros, axes = np.array(places), np.zeros(len(places)), axis.axes
    if axis.axis_name == "x":
        x, y, mark, scale = at, zeros, TICKDOWN, axes.get_xaxis_transform()
    else:
        x, y, mark, scale = zeros, at, TICKLEFT, axes.get_yaxis_transform()
    marks = Line2D(
        x,
        y,
        transform=scale,
        linestyle="none",
        marker=mark,
        markersize=rcParams["xtick.minor.size"],  # of both axes
        markeredgewidth=rcParams["xtick.minor.width"],
        color=INK,
        clip_on=False,
    )
    axes.add_artist(marks)  # which leaves the limits alone


def _places(low: float, high: float, places: Float[Array, " n"]) -> list[float]:
    """The places of the data, where they are few, short and apart."""
    inside = [float(x) for x in places if low <= x <= high]
    if not 2 <= len(inside) <= PLACES or len(inside) < len(places):
        return []
    if any(len(spelled(x)) > 5 for x in inside):
        return []
    apart = np.diff(np.log(inside)) / np.log(high / low)
    return inside if np.all(apart >= GAP) else []


def _about(place: float, ticks: list[float], whole: float) -> list[float]:
    """The only place of the data, and the round numbers apart from it."""
    apart = np.abs(np.log(np.array(ticks) / place)) / np.log(whole) >= GAP
    return sorted([place, *np.array(ticks)[apart].tolist()])


def _round(low: float, high: float) -> list[float]:
    """Decades, thinned where they are many; parts of them where they are few."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for mantissas in MANTISSAS:
        every = [float(f"{m:g}e{power}") for power in powers for m in mantissas]
        ticks = [tick for tick in every if low <= tick <= high]
        if len(ticks) >= ENOUGH:
            step = -(-len(ticks) // 6) if mantissas == (1.0,) else 1
            return ticks[::step]
    even = MaxNLocator(4).tick_values(low, high)
    return [float(tick) for tick in even if low <= tick <= high]
