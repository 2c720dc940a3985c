"""A series of runs: what became better or worse, since which commit, by how much.

Each statistic is a line over the runs, constant but for steps (`simval.compare.levels`,
eq. (D4)); without chance, every change beyond rounding is one. The lines share the
false-alarm rate by Holm's rule; a second step in a line needs its even share. A step is
better or worse as between two runs, eq. (D3).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

import numpy as np
import scipy

from simval.change import holm
from simval.compare.levels import Series, least_p, steps_in
from simval.compare.moves import (
    Move,
    Standing,
    Step,
    loss,
    moved,
    rounding_of,
    standing,
)
from simval.compare.origin import Origin, origin_of
from simval.compare.series import Line, lines_of
from simval.sweep.run import Run
from simval.verdict import ALPHA

WAYS: tuple[Standing, ...] = ("worse", "better", "neither")
"""The order in which a person wants to know."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Break:
    """A step of one line.

    Attributes
    ----------
    run : int
        Place of the first run after it.
    line : int
        Place of the line.
    step : Step
        The levels before and after, and which way.
    """

    run: int
    line: int
    step: Step


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """A series of runs and the steps in it.

    Attributes
    ----------
    origins : tuple of Origin
        The runs in their order.
    lines : tuple of Line
        Each statistic over the runs that have it.
    breaks : tuple of Break
        All steps, by line and place.
    within : tuple of int
        Of each run, how many values moved within their uncertainty though the noise
        was that of the run before: the algorithm or its environment changed.
    alpha : float
        False-alarm rate that all lines share.
    """

    origins: tuple[Origin, ...]
    lines: tuple[Line, ...]
    breaks: tuple[Break, ...]
    within: tuple[int, ...]
    alpha: float

    @property
    def changed(self) -> int:
        """How many lines have a step."""
        return len({each.line for each in self.breaks})

    def count(self, run: int, way: Standing) -> int:
        """How many lines have a step at a run, this way.

        Parameters
        ----------
        run : int
            Place of the run.
        way : {"better", "worse", "neither"}
            Which way.

        Returns
        -------
        int
            Their number.
        """
        return sum(b.run == run and b.step.standing == way for b in self.breaks)

    @property
    def moves(self) -> tuple[tuple[int, Move], ...]:
        """What moved at which run, the largest first."""
        found = [
            (run, move)
            for run in sorted({each.run for each in self.breaks})
            for move in moved(self._steps_at(run))
        ]
        return tuple(sorted(found, key=lambda pair: (-pair[1].worst.weight, pair[0])))

    def _steps_at(self, run: int) -> Iterator[Step]:
        """Steps of all lines at a run; of those without one, one that did not move."""
        at = {each.line: each.step for each in self.breaks if each.run == run}
        for number, line in enumerate(self.lines):
            yield at.get(number) or Step(
                study=line.study, cell=line.cell, statistic=line.statistic,
                before=0.0, after=0.0, error=0.0, moved=False,
            )  # fmt: skip


def trend_of(runs: Sequence[Run], alpha: float = ALPHA) -> Trend:
    """Find the steps in a series of runs.

    Parameters
    ----------
    runs : sequence of Run
        In their order, as from `read_runs`.
    alpha : float, default ALPHA
        False-alarm rate of all lines together.

    Returns
    -------
    Trend
        The lines and their steps.
    """
    lines = lines_of(runs)
    known = [_series(line) for line in lines]
    values = np.array([1.0 if s is None else least_p(s) for s in known])
    sampled = np.array([s is not None for s in known], dtype=bool)
    limits = np.zeros(len(lines))
    limits[sampled] = holm(values[sampled], alpha)
    even = alpha / max(int(sampled.sum()), 1)
    breaks = [
        each
        for number, (line, series) in enumerate(zip(lines, known, strict=True))
        for each in (
            *_crossings(number, line),
            *_found(number, line, series, limits[number], even, values[number]),
        )
    ]
    return Trend(
        origins=tuple(map(origin_of, runs)),
        lines=lines,
        breaks=tuple(sorted(breaks, key=lambda each: (each.line, each.run))),
        within=_within(len(runs), lines, breaks),
        alpha=alpha,
    )


def _finite(line: Line) -> list[int]:
    """Places of the points that are numbers."""
    return [i for i, point in enumerate(line.points) if isfinite(point.value)]


def _series(line: Line) -> Series | None:
    """Values with chance; None of a line without."""
    points = [line.points[i] for i in _finite(line)]
    errors = np.array([point.row.standard_error for point in points])
    known = errors[np.isfinite(errors) & (errors > 0.0)]
    if len(points) < 2 or not len(known):
        return None
    # a share that was 0 or 1 in all trials has no spread of its own to tell its error
    good = np.isfinite(errors) & (errors > 0.0)
    seeds = list(dict.fromkeys(point.seed for point in points))  # of any size
    return Series(
        values=np.array([point.value for point in points]),
        errors=np.where(good, errors, known.max()),
        seeds=np.array([seeds.index(point.seed) for point in points]),
    )


def _crossings(number: int, line: Line) -> Iterator[Break]:
    """Where a number became none, or none a number."""
    for old, new in pairwise(line.points):
        if isfinite(old.value) != isfinite(new.value):
            yield _break(number, line, new.run, (old.value, new.value, 0.0), 0.0)


def _found(
    number: int,
    line: Line,
    series: Series | None,
    limit: float,
    even: float,
    value: float,
) -> Iterator[Break]:
    points = [line.points[i] for i in _finite(line)]
    if series is not None and value > limit:
        return
    if series is not None:
        quantile = -float(scipy.special.ndtri(limit / series.comparisons / 2.0))
        for found in steps_in(series, limit, min(even, limit)):
            levels = found.before, found.after, found.error
            least = quantile * found.error
            yield _break(number, line, points[found.place].run, levels, least)
        return
    for old, new in pairwise(points):
        bound = rounding_of(old.row, 0.0)
        if abs(new.value - old.value) > bound:
            levels = old.value, new.value, 0.0
            yield _break(number, line, new.run, levels, bound)


def _break(
    number: int,
    line: Line,
    run: int,
    levels: tuple[float, float, float],
    least: float,
) -> Break:
    """A step of a line at a run, with its direction."""
    at = next(i for i, point in enumerate(line.points) if point.run == run)
    theory = line.points[at - 1].row.prediction, line.points[at].row.prediction
    before, after, error = levels
    change = loss(line.statistic, after, theory[1]) - loss(
        line.statistic, before, theory[0]
    )
    step = Step(
        study=line.study,
        cell=line.cell,
        statistic=line.statistic,
        before=before,
        after=after,
        error=error,
        moved=True,
        standing=standing(change, least),
        predictions=theory,
    )
    return Break(run=run, line=number, step=step)


def _within(
    runs: int, lines: Sequence[Line], breaks: Sequence[Break]
) -> tuple[int, ...]:
    """Count the values that moved on the same noise without being a step."""
    steps = {(each.line, each.run) for each in breaks}
    counts = [0] * runs
    for number, line in enumerate(lines):
        for old, new in pairwise(line.points):
            error = max(old.row.standard_error, new.row.standard_error)
            same = old.cell == new.cell and old.row.n == new.row.n
            bound = rounding_of(old.row, error)
            far = error > 0.0 and abs(new.value - old.value) > bound
            if same and far and (number, new.run) not in steps:
                counts[new.run] += 1
    return tuple(counts)
