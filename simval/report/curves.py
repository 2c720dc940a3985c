r"""Curves made of a run's rows: grouped by parameters, sorted along an axis.

With them: what the page says of a point on request; slopes on log-log axes and bands
that hold together; and measured over predicted, on a linear axis where one percent is
seen: on a logarithmic one over four decades points within a percent of a line and
points ten percent off it look the same.

A slope is that of a power law :math:`y = a x^k` fitted by weighted least squares to the
values themselves, not to their logarithms: a value that scatters about zero counts with
its sign, so no point has to be left out, which would bias the slope.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import compress
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.change import EFFORT
from simval.judge.findings import reproduce
from simval.judge.settings import setting_words, varying
from simval.report.formatting import spelled
from simval.report.panels import (
    BOUND,
    COLOURS,
    MARKERS,
    THEORY,
    BarPanel,
    DotPanel,
    Panel,
    Series,
    near,
)
from simval.results import Row
from simval.shapes import Bool, Float
from simval.spelling import measured
from simval.statistics import FAMILIES
from simval.sweep.run import CellResult
from simval.text import number
from simval.units import COUNT, Unit

# ---- points on request


class Measured(NamedTuple):
    """Value of a statistic in a cell."""

    value: float
    error: float  # standard
    prediction: float  # NaN without one
    remainder: float = 0.0  # what the prediction itself may be off by
    n: int = 0  # independent samples; 0 where there are none
    unit: str = ""  # of the numbers
    against: str = "predicted"  # what the prediction is


def note(cell: CellResult, found: Measured, unit: Unit | None = None) -> str:
    """Lines about a point: value and samples, prediction, cell, and its command."""
    factor = 1.0 if unit is None else unit.factor
    name = found.unit if unit is None else unit.name
    behind = f" {name}" if name not in ("", "1") else ""
    samples = f", n = {found.n}" if found.n else ""
    lines = [f"{measured(factor * found.value, factor * found.error)}{behind}{samples}"]
    if isfinite(found.prediction):
        off = factor * found.remainder
        more = f", which leaves out {number(off, 2)}" if off > 0.0 else ""
        words = f"{found.against} {number(factor * found.prediction)}{behind}"
        lines.append(words + more)
    inside = described(cell.study, cell.parameters)
    lines.append(": ".join(filter(None, (spelled(cell.study), inside))))
    lines.append(reproduce(cell.named, cell.run))
    return "\n".join(line for line in lines if line)


def described(
    study: str, parameters: Mapping[str, Any], without: tuple[str, ...] = EFFORT
) -> str:
    """Spell the parameters of a cell."""
    shown = (item for item in parameters.items() if item[0] not in without)
    return ", ".join(setting_words(study, key, value) for key, value in shown)


# ---- slopes


Z95 = float(scipy.special.ndtri(0.975))  # of a two-sided interval of 95 %
STEEPEST = 12.0
"""Slopes are sought between plus and minus this: twice the greatest order
of a formula."""
FINEST = 5e-4
"""Half of the narrowest 95 % interval that is stated with a slope."""
_GRIDS = 7  # the last has a step of 2e-11


@dataclass(frozen=True, slots=True)
class Slope:
    """A fitted slope."""

    value: float  # of log y over log x
    half_width: float  # half of the 95 % interval

    def __str__(self) -> str:
        """The slope ± one standard deviation, which is left out where it is tiny."""
        if self.half_width < FINEST:
            return f"{self.value:.3f}"
        return measured(self.value, self.half_width / Z95)


def fitted_slope(
    x: Float[Array, " n"], y: Float[Array, " n"], error: Float[Array, " n"]
) -> Slope | None:
    """Exponent k of y = a x^k by weighted least squares; None if undetermined."""
    if len(np.unique(x)) < 2 or not (np.all(error > 0) and np.all(np.isfinite(y))):
        return None
    z, weighted = np.log(x) - np.log(x).mean(), y / error
    size = float(np.abs(weighted).max())
    if not np.isfinite(weighted).all() or not size > 0.0:
        return None

    k, half = 0.0, STEEPEST
    for _ in range(_GRIDS):  # each 48 times as fine as the last
        grid = k + np.linspace(-half, half, 97)
        shapes = _shape(grid[:, None], z, error)
        left = weighted - (shapes @ weighted)[:, None] * shapes
        k = float(grid[int(np.argmin(np.vecdot(left, left)))])
        if abs(k) == STEEPEST:
            return None
        half /= 48.0
    shape = _shape(np.array([k]), z, error)
    amplitude = float(weighted @ shape)
    # derivative along k, with the part that the amplitude takes up removed
    slant = amplitude * (z - (z * shape) @ shape) * shape
    length = float(np.linalg.norm(slant))
    if not abs(amplitude) > Z95 or not length > 0.0:
        return None
    return Slope(k, Z95 / length)


def _shape(
    k: Float[Array, "... 1"], z: Float[Array, " n"], error: Float[Array, " n"]
) -> Float[Array, "... n"]:
    """Curves x^k, weighted and scaled to unit length."""
    exponent = k * z - np.log(error)  # errors may be as small or great as floats are
    curve = np.exp(exponent - exponent.max(axis=-1, keepdims=True))
    return curve / np.linalg.norm(curve, axis=-1, keepdims=True)


def order(x: Float[Array, " n"], y: Float[Array, " n"]) -> float | None:
    """Slope between the two smallest x of a curve without chance."""
    good = (x > 0) & (y > 0) & np.isfinite(y)
    xs, first = np.unique(x[good], return_index=True)
    if len(xs) < 2:
        return None
    ys = y[good][first]
    return float(np.log(ys[1] / ys[0]) / np.log(xs[1] / xs[0]))


def simultaneous(count: int, confidence: float = 0.95) -> float:
    """Half width, in standard errors, of bands that hold for all points at once."""
    single = confidence ** (1.0 / max(count, 1))
    return float(scipy.special.ndtri(0.5 + 0.5 * single))


# ---- curves

PREFERRED = ("noise_std", "poses")
"""Parameters that make the best axis, the best one first."""

MAX_GROUPS = 6
"""Curves of one kind in a panel, or figures of one kind in a section."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """A statistic along one axis, with its standard errors and prediction."""

    label: str  # of the group of cells
    x: Float[Array, " n"]  # the axis, ascending
    # statistic, its standard error and its prediction (NaN without one)
    value: Float[Array, " n"]
    error: Float[Array, " n"]
    prediction: Float[Array, " n"]
    # what the prediction itself leaves out; None is nothing
    remainder: Float[Array, " n"] | None = None
    # what was found in which cell, in the rows' units; empty says nothing of a point
    sources: Sequence[tuple[CellResult, Measured]] = ()
    unit: Unit | None = None  # that the numbers are in; None is that of the rows
    names: Sequence[str] = ()  # of the points, where their places do not tell them

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on each point; none if some of the points are not drawn."""
        if len(self.sources) != len(self.x):
            return ()
        return tuple(note(cell, found, self.unit) for cell, found in self.sources)

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
    def scaled(self, unit: Unit) -> "Curve":
        """The curve and its notes in a unit for people."""
        rest = None if self.remainder is None else self.remainder * unit.factor
        return replace(
            self,
            value=self.value * unit.factor,
            error=self.error * unit.factor,
            prediction=self.prediction * unit.factor,
            remainder=rest,
            unit=unit,
        )

    @np.errstate(over="ignore")  # what overflows is not drawn
    def points(self, z: float, place: int = 0, label: str | None = None) -> Series:
        """The measured points, with bands."""
        return Series(
            label=self.label if label is None else label,
            x=self.x,
            y=self.value,
            band=z * self.error,
            colour=COLOURS[place % len(COLOURS)],
            # another marker where the colours come round again
            marker=MARKERS[(place + place // len(COLOURS)) % len(MARKERS)],
            notes=self.notes,
        )

    def predicted(self, line: str = "-", label: str = "") -> Series:
        """The line of the prediction, or a dotted one of the bound."""
        x, first = np.unique(self.x, return_index=True)
        return Series(
            label=label,
            x=x,
            y=self.prediction[first],
            colour=BOUND if line == ":" else THEORY,
            line=line,
        )


def curve(
    label: str,
    cells: Iterable[CellResult],
    axis: str,
    measure: Callable[[CellResult], Row | Measured | None],
) -> Curve | None:
    """A statistic of some cells, sorted along an axis; None if no cell has it."""
    found = [
        (place, cell, read(each) if isinstance(each, Row) else each)
        for cell in cells
        if (place := position(cell, axis)) is not None
        if (each := measure(cell)) is not None
    ]
    return along_axis(label, found) if found else None


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def along_axis(
    label: str, points: Iterable[tuple[float, CellResult, Measured]]
) -> Curve:
    """Sort values by the places of their cells on an axis."""
    points = sorted(points, key=lambda point: (point[0], *point[2][:4]))
    numbers = [(place, *found[:4]) for place, _, found in points]
    x, value, error, prediction, rest = np.array(numbers, dtype=float).T
    return Curve(
        label=label,
        x=x,
        value=value,
        error=error,
        prediction=prediction,
        remainder=rest,
        sources=[(cell, found) for _, cell, found in points],
    )


def bar_width(curves: Iterable[Curve | None]) -> float:
    """Standard errors to which bars extend, to hold for all points at once (95 %)."""
    return simultaneous(sum(len(c.x) for c in curves if c is not None))


def spans(factor: float, values: Sequence[Array]) -> bool:
    """True if positive values span so much that a logarithmic axis is better."""
    every = np.concatenate([np.empty(0), *values])
    if not every.size:
        return False
    return bool(np.all(every > 0.0) and every.max() > factor * every.min())


def position(cell: CellResult, axis: str) -> float | None:
    """Place of a cell on an axis."""
    value = numeric(cell.parameters.get(axis))
    if value is not None:
        return float(value)
    row = cell.row(FAMILIES[axis]()) if axis in FAMILIES else None
    return None if row is None else row.value


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def bars(
    found: Sequence[tuple[CellResult, Row]],
    names: Sequence[str],
    title: str,
    x_label: str,
    unit: Unit = COUNT,
) -> BarPanel:
    """Draw rows as bars, with 95 % intervals that hold for all of them at once."""
    value, error, prediction = np.array([read(row)[:3] for _, row in found]).T
    return BarPanel(
        title=title,
        x_label=x_label,
        names=names,
        measured=unit.factor * value,
        band=unit.factor * simultaneous(len(found)) * error,
        predicted=unit.factor * prediction,
        notes=[note(cell, read(row), unit) for cell, row in found],
    )


def read(row: Row) -> Measured:
    """Value of one row."""
    prediction = np.nan if row.prediction is None else row.prediction
    numbers = (row.value, row.standard_error, prediction, row.remainder)
    return Measured(*numbers, row.n, row.unit)


def grouped(
    cells: Sequence[CellResult], *axes: str
) -> Mapping[str, tuple[CellResult, ...]]:
    """Group cells that differ only along some axes."""
    skipped = {*axes, *EFFORT}
    keys = [k for k in varying(cells) if k not in skipped]
    groups: dict[str, list[CellResult]] = {}
    for cell in cells:
        label = ", ".join(
            setting_words(cell.study, key, cell.parameters.get(key)) for key in keys
        )
        groups.setdefault(label, []).append(cell)
    return {label: tuple(members) for label, members in groups.items()}


def first(
    groups: Mapping[str, tuple[CellResult, ...]], limit: int = MAX_GROUPS
) -> tuple[dict[str, tuple[CellResult, ...]], tuple[str, ...]]:
    """Split off the first few groups, and name the others."""
    labels = list(groups)
    return {k: groups[k] for k in labels[:limit]}, tuple(labels[limit:])


def axis_of(cells: Sequence[CellResult]) -> str:
    """Parameter along which the curves of a study run."""
    keys = [key for key in varying(cells) if _numeric(cells, key)]
    every = {key for cell in cells for key in cell.parameters}
    fixed = sorted(key for key in every if _numeric(cells, key))
    ranked = sorted(
        (key for key in keys if key not in EFFORT),
        key=lambda key: PREFERRED.index(key) if key in PREFERRED else len(PREFERRED),
    )
    return next(iter([*ranked, *(k for k in PREFERRED if k in fixed), *fixed]), "")


def _numeric(cells: Sequence[CellResult], key: str) -> bool:
    return all(numeric(cell.parameters.get(key)) is not None for cell in cells)


def numeric(value: object) -> int | float | None:
    """The value of a parameter if it is a number, else None."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value
    return None


# ---- ratios

SEEN = 1.0
"""Half width of a band beyond which a ratio of 0 and one of 2 are both in it."""
ROOM = 1.1
"""Axis over the farthest end of a band."""
LEAST = 1e-3
"""Least half of an axis: what is nearer to 1 is drawn on it."""
HEIGHT, STRIP = 0.35, 0.2
"""Of the axes of ratios of one curve, and of each of several, in that of values."""
MEASURED_OVER_PREDICTED = "measured / predicted"


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def ratio(c: Curve) -> Curve:
    """Measured value over prediction, where the prediction is not zero."""
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
    """Points of a ratio whose bands are narrow enough to be seen."""
    return kept(c, np.less_equal(z * c.error, SEEN) & near(c.value))


def kept(c: Curve, good: Bool[Array, " n"]) -> Curve:
    """Some points of a curve."""
    changes: dict[str, Any] = {}
    for name in (field.name for field in fields(c)):
        whole = getattr(c, name)
        if isinstance(whole, np.ndarray):
            changes[name] = whole[good]
        elif isinstance(whole, list | tuple) and len(whole) == len(good):
            changes[name] = [*compress(whole, good)]
    return replace(c, **changes)


def ratio_strips(
    panel: Panel,
    theory: str,
    measured: Mapping[int, Curve],
    z: float,
    lines: Sequence[Series] = (),
) -> list[Panel]:
    """Strips below a panel with the ratio of each curve to its prediction.

    Their axes are alike, with bands of z errors. The lines are other predictions over
    the one that the points of a single curve are divided by; they do not widen them.
    """
    points = [
        over.points(z, place)
        for place, c in measured.items()
        if len((over := seen(ratio(c), z)).x)
    ]
    alone = len(points) == 1
    return [
        replace(
            panel,
            title=f"{panel.title}: {s.label or 'measured'} over {theory}",
            y_label="" if i else f"measured over {theory}",
            series=(*(lines if alone else ()), s),
            log_y=False,
            references=((1.0, ""),),
            limits=limits([s.y for s in points], [s.band for s in points]),
            height=HEIGHT if alone else STRIP,
        )
        for i, s in enumerate(points)
    ]


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def limits(
    values: Sequence[Float[Array, " n"]], bands: Sequence[Float[Array, " n"] | None]
) -> tuple[float, float]:
    """Ends of an axis of ratios around 1, no narrower than the bands."""
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
    """Ratios of named parts as points, placed by the order of their names."""
    shown = [(i, seen(ratio(c), z)) for i, c in enumerate(groups)]
    shown = [(i, c) for i, c in shown if len(c.x)]
    if not shown:
        return None
    return DotPanel(
        title=title,
        x_label=MEASURED_OVER_PREDICTED,
        names=names,
        series=[upright(c.points(z, i)) for i, c in shown],
        reference=(1.0, "theory"),
    )


def upright(points: Series) -> Series:
    """Swap the axes of some points."""
    return replace(points, x=points.y, y=points.x)
