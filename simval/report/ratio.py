"""Measured over predicted, on a linear axis where one percent is seen.

On a logarithmic axis over four decades points within a percent of a line and points ten
percent off it look the same. These panels stand below such figures.
"""

from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import compress
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.report.curves import Curve
from simval.report.panels import DotPanel, Panel, Series, near
from simval.shapes import Bool, Float

SEEN = 1.0
"""Half width of a band beyond which a ratio of 0 and one of 2 are both in it."""
ROOM = 1.1
"""Axis over the farthest end of a band."""
LEAST = 1e-3
"""Least half of an axis: what is nearer to 1 is drawn on it."""
HEIGHT = 0.75
MEASURED_OVER_PREDICTED = "measured / predicted"


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def ratio(c: Curve) -> Curve:
    """Measured over predicted, where there is a prediction other than zero."""
    good = np.isfinite(c.prediction) & (c.prediction != 0.0)
    good &= np.isfinite(c.value) & np.isfinite(c.error)
    some = kept(c, good)
    size = np.abs(some.prediction)
    return replace(
        some,
        value=some.value / some.prediction,
        error=some.error / size,
        prediction=np.ones(len(some.x)),
        remainder=None if some.remainder is None else some.remainder / size,
    )


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def seen(c: Curve, z: float) -> Curve:
    """The points of a ratio whose bands tell it from 0 and from 2."""
    return kept(c, np.less_equal(z * c.error, SEEN) & near(c.value))


def kept(c: Curve, good: Bool[Array, " n"]) -> Curve:
    """Some points of a curve, with all that it has of each point."""
    changes: dict[str, Any] = {}
    for name in (field.name for field in fields(c)):
        whole = getattr(c, name)
        if isinstance(whole, np.ndarray):
            changes[name] = whole[good]
        elif isinstance(whole, list | tuple) and len(whole) == len(good):
            changes[name] = [*compress(whole, good)]
    return replace(c, **changes)


def ratio_panel(
    title: str,
    x_label: str,
    measured: Sequence[Curve],
    z: float,
    lines: Sequence[Series] = (),
    *,
    log_x: bool = True,
) -> Panel | None:
    """Panel of the ratios that can be seen with bands of z errors; None if none can.

    The lines are other predictions over the one that the points are divided by; they
    do not widen the axis.
    """
    shown = [(i, seen(ratio(c), z)) for i, c in enumerate(measured)]
    shown = [(i, c) for i, c in shown if len(c.x)]
    if not shown:
        return None
    several = len(measured) > 1
    points = [c.points(z, i, None if several else "") for i, c in shown]
    return Panel(
        title=title,
        x_label=x_label,
        y_label=MEASURED_OVER_PREDICTED,
        series=(*lines, *points),
        log_x=log_x,
        log_y=False,
        references=((1.0, ""),),
        dodge=True,
        limits=limits([s.y for s in points], [s.band for s in points]),
        height=HEIGHT,
    )


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def limits(
    values: Sequence[Float[Array, " n"]], bands: Sequence[Float[Array, " n"] | None]
) -> tuple[float, float]:
    """Ends of an axis of ratios: about 1, and never narrower than the bands."""
    half, lowest = LEAST, 0.0
    for value, band in zip(values, bands, strict=True):
        width = 0.0 if band is None else band
        reach = np.abs(value - 1.0) + width
        half = max(half, ROOM * float(np.max(reach, initial=0.0)))
        lowest = min(lowest, float(np.min(value - width, initial=0.0)))
    # an axis that reaches far above 1 has nothing to show below zero
    return max(1.0 - half, ROOM * lowest), 1.0 + half


def ratio_bars(
    title: str, names: Sequence[str], groups: Sequence[Curve], z: float
) -> DotPanel | None:
    """The same of named parts, whose x is their place among the names."""
    shown = [(i, seen(ratio(c), z)) for i, c in enumerate(groups)]
    shown = [(i, c) for i, c in shown if len(c.x)]
    if not shown:
        return None
    dots = []
    for i, c in shown:
        points = c.points(z, i)
        dots.append(replace(points, x=points.y, y=points.x))
    return DotPanel(
        title=title,
        x_label=MEASURED_OVER_PREDICTED,
        names=names,
        series=dots,
        reference=(1.0, "theory"),
    )
