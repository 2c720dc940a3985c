"""Curves made of the rows of a run: grouped by what varies, sorted along an axis."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simval.arrays import Array
from simval.change import EFFORT
from simval.report.notes import Measured, note
from simval.report.palette import BOUND, THEORY
from simval.report.panels import COLOURS, MARKERS, BarPanel, Series
from simval.report.parameters import setting_words
from simval.report.slope import simultaneous
from simval.results import Row
from simval.shapes import Float
from simval.statistics import FAMILIES, Statistic
from simval.sweep.run import CellResult
from simval.units import COUNT, Unit

PREFERRED = ("noise_std", "poses")
"""Parameters that make the best axis, the best one first."""

MAX_GROUPS = 6
"""Curves of one kind in a panel, or figures of one kind in a section."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """A statistic along one axis."""

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
        """What the page says of each point on request; nothing if some are left out."""
        if len(self.sources) != len(self.x):
            return ()
        return tuple(note(cell, found, self.unit) for cell, found in self.sources)

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
    def scaled(self, unit: Unit) -> "Curve":
        """The curve in a unit that a person reads, its notes as well."""
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
        """Measured points with bands."""
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
        """Line of the prediction, or dotted of the bound."""
        x, first = np.unique(self.x, return_index=True)
        return Series(
            label=label,
            x=x,
            y=self.prediction[first],
            colour=BOUND if line == ":" else THEORY,
            line=line,
        )


Groups = Mapping[str, Sequence[CellResult]]
"""Cells that differ only along an axis, by what the group has in common."""

Measure = Callable[[CellResult], Measured | tuple[float, ...] | None]
"""What is measured in one cell, or the first of its fields; None where it has none."""


def curve(
    label: str, cells: Sequence[CellResult], axis: str, measure: Measure
) -> Curve | None:
    """Measure each cell and sort along an axis."""
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is not drawn
        points = [
            (place, cell, Measured(*values))
            for cell in cells
            if (place := position(cell, axis)) is not None
            if (values := measure(cell)) is not None
        ]
    if not points:
        return None
    points.sort(key=lambda point: (point[0], *point[2][:4]))
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


def curves(groups: Groups, measure: Measure, axis: str = "noise_std") -> list[Curve]:
    """One curve for each group that has the statistic."""
    drawn = [curve(label, cells, axis, measure) for label, cells in groups.items()]
    return [c for c in drawn if c is not None]


def bar_width(curves: Iterable[Curve | None]) -> float:
    """Standard errors that the bars need to hold for all points together (95 %)."""
    return simultaneous(sum(len(c.x) for c in curves if c is not None))


def spans(factor: float, values: Sequence[Array]) -> bool:
    """Whether values are positive and span more than a factor: for a logarithm."""
    every = np.concatenate(values)
    return bool(np.all(every > 0.0) and every.max() > factor * every.min())


def position(cell: CellResult, axis: str) -> float | None:
    """Place of a cell along an axis."""
    value = numeric(cell.parameters.get(axis))
    if value is not None:
        return float(value)
    row = cell.row(FAMILIES[axis]()) if axis in FAMILIES else None
    return None if row is None else row.value


def statistic(name: Statistic, predictor: str = "") -> Measure:
    """Measure that reads one row."""

    def measure(cell: CellResult) -> Measured | None:
        row = cell.row(name, predictor)
        return None if row is None else read(row)

    return measure


def triple(row: Row) -> tuple[float, float, float]:
    """Value, standard error and prediction of a row."""
    return (
        row.value,
        row.standard_error,
        np.nan if row.prediction is None else row.prediction,
    )


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def bars(
    found: Sequence[tuple[CellResult, Row]],
    names: Sequence[str],
    title: str,
    x_label: str,
    unit: Unit = COUNT,
) -> BarPanel:
    """Rows as bars, with 95 % intervals that hold for all of them together."""
    rows = [row for _, row in found]
    value, error, prediction = np.array([triple(row) for row in rows]).T
    return BarPanel(
        title=title,
        x_label=x_label,
        names=names,
        measured=unit.factor * value,
        band=unit.factor * simultaneous(len(rows)) * error,
        predicted=unit.factor * prediction,
        notes=[note(cell, read(row), unit) for cell, row in found],
    )


def read(row: Row) -> Measured:
    """What one row says."""
    return Measured(*triple(row), row.remainder, row.n, row.unit)


def grouped(
    cells: Sequence[CellResult], *axes: str
) -> Mapping[str, tuple[CellResult, ...]]:
    """Group cells that differ only along some axes (and in effort and seed)."""
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
    """Split groups into the first ones and the names of the others."""
    labels = list(groups)
    return {k: groups[k] for k in labels[:limit]}, tuple(labels[limit:])


def varying(cells: Sequence[CellResult]) -> list[str]:
    """Parameters that are not the same in all cells."""
    keys = sorted({key for cell in cells for key in cell.parameters})
    return [k for k in keys if len({repr(c.parameters.get(k)) for c in cells}) > 1]


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
    """The value of a parameter if it is a number."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value
    return None
