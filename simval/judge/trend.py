"""Series of runs: what became better or worse, by how much, since which commit.

The runs of a folder are in the order of their commits. A statistic is a line over them,
followed by its study, its parameters (without seed and samples), its place among equal
cells of a run in the order of their seeds, and its name. Values of a row that a limit
judges are rounding noise below it, so they count as the limit there.

A line is constant but for steps (`simval.judge.levels`, eq. (D4)); without chance,
every change beyond rounding is one, of a value of one draw only on the same seed.
The lines share the false-alarm rate by Holm's rule; a second step in a line needs its
even share. A step is better or worse as between two runs, eq. (D3).
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from math import isfinite
from pathlib import Path

import numpy as np
import scipy

from simval.arguments import file_path
from simval.change import holm, question
from simval.errors import InputError
from simval.judge.levels import Series, least_p, steps_in
from simval.judge.runs import Origin, origin_of
from simval.judge.steps import (
    Move,
    Standing,
    Step,
    loss_change,
    moved,
    rounding_of,
    short_names,
    standing,
)
from simval.results import Row
from simval.statistics import Statistic
from simval.sweep import load_run
from simval.sweep.run import CellResult, Run
from simval.verdict import ALPHA

WAYS: tuple[Standing, ...] = ("worse", "better", "neither")
"""The order in which a person wants to know."""


Question = tuple[str, str, int]
"""Study, parameters, and place among the cells of a run that are equal in both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A statistic in one of the runs."""

    run: int  # place of the run in the series
    cell: str
    seed: int
    row: Row

    @property
    def value(self) -> float:
        """The value, or the limit where the value is below it."""
        row = self.row
        below = row.check == "limit" and row.prediction is not None
        return max(row.value, row.prediction or 0.0) if below else row.value


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A statistic followed over the runs that have it."""

    study: str
    statistic: Statistic
    points: tuple[Point, ...]

    @property
    def cell(self) -> str:
        """Name of its cell in the newest run."""
        return self.points[-1].cell


def read_runs(folder: str | Path) -> tuple[Run, ...]:
    """Read the run folders in a folder, oldest commit first.

    Parameters
    ----------
    folder : str or Path
        A folder with the run folders in it.

    Returns
    -------
    tuple of Run
        The runs, by the date of their commits; by their own where one has none.

    Raises
    ------
    InputError
        If there are fewer than two, they are of several suites, or one has no date.
    """
    folder = file_path("folder", folder)
    places = sorted(path.parent for path in folder.glob("*/run.sqlite"))
    if len(places) < 2:
        number = "1 run folder" if places else "no run folder"
        msg = (
            f"{folder} holds {number}; a series needs at least two, each a folder of "
            "its own in it: `simval sweep SUITE --out FOLDER/NAME`"
        )
        raise InputError(msg)
    runs = [load_run(place) for place in places]
    _require_one_suite(runs)
    origins = [origin_of(run) for run in runs]
    by_commit = all(origin.committed for origin in origins)
    dates = [_date(origin, by_commit) for origin in origins]
    order = sorted(range(len(runs)), key=lambda i: (*dates[i], origins[i].name))
    return tuple(runs[i] for i in order)


def ordered_by(origins: Sequence[Origin]) -> str:
    """Say by which date the runs are ordered."""
    known = all(origin.committed for origin in origins)
    return "the date of their commits" if known else "the date of their runs"


def _date(origin: Origin, by_commit: bool) -> tuple[datetime, datetime]:
    texts = (origin.committed if by_commit else origin.started, origin.started)
    try:
        dates = [datetime.fromisoformat(text) for text in texts]
    except ValueError:
        msg = (
            f"the run {origin.name} has no date (it is unfinished), so it has "
            "no place in a series; finish it with `simval sweep SUITE "
            "--resume`, or move it elsewhere"
        )
        raise InputError(msg) from None
    known = [d if d.tzinfo else d.replace(tzinfo=UTC) for d in dates]
    return known[0], known[1]


def _require_one_suite(runs: Sequence[Run]) -> None:
    names = Counter(str(run.manifest.get("suite")) for run in runs)
    if len(names) == 1:
        return
    asked = [{key for key, _ in _cells(run)} for run in runs]
    shared = len(set.intersection(*asked))
    listed = ", ".join(f"{name} ({count})" for name, count in names.most_common())
    msg = (
        f"the {len(runs)} runs are of {len(names)} suites: {listed}; they "
        f"share {shared} of {len(set.union(*asked))} cells. Give each suite "
        "a folder of its own, or use `simval compare A B`, which compares "
        "two runs in what they share"
    )
    raise InputError(msg)


def _cells(run: Run) -> Iterator[tuple[Question, CellResult]]:
    """Finished cells of a run, each with what it measures."""
    seen: Counter[tuple[str, str]] = Counter()
    for cell in sorted(run.cells, key=lambda cell: cell.seed):
        asked = cell.study, str(question(cell.parameters))
        if cell.status == "done":
            yield (*asked, seen[asked]), cell
        seen[asked] += 1


def lines_of(runs: Sequence[Run]) -> tuple[Line, ...]:
    """Follow each statistic that at least two runs have."""
    found: dict[tuple[Question, Statistic, str], list[Point]] = {}
    for i, run in enumerate(runs):
        for asked, cell in _cells(run):
            for predictor, row in _rows(cell):
                point = Point(run=i, cell=cell.name, seed=cell.seed, row=row)
                found.setdefault((asked, row.statistic, predictor), []).append(point)
    return tuple(
        Line(study=asked[0], statistic=statistic, points=tuple(points))
        for (asked, statistic, _), points in found.items()
        if len(points) > 1
    )


def _rows(cell: CellResult) -> Iterator[tuple[str, Row]]:
    """Rows of a cell, each value once, even if several theories judge it."""
    groups: dict[Statistic, list[Row]] = {}
    for row in cell.rows:
        groups.setdefault(row.statistic, []).append(row)
    for rows in groups.values():
        alike = len({(row.value, row.standard_error) for row in rows}) == 1
        limited = any(row.check == "limit" for row in rows)
        if alike and not limited:
            known = (row for row in rows if row.prediction is not None)
            yield "", next(known, rows[0])
        else:
            yield from ((row.predictor, row) for row in rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Break:
    """A step in one line."""

    run: int  # place of the first run after it
    line: int  # place of the line
    step: Step  # the levels before and after, and which way


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """A series of runs, and the steps found in it."""

    origins: tuple[Origin, ...]  # the runs in their order
    lines: tuple[Line, ...]  # each statistic over the runs that have it
    breaks: tuple[Break, ...]  # all steps, by line and place
    # of each run, how many values moved within their uncertainty though the noise was
    # that of the run before: the algorithm or its environment changed
    within: tuple[int, ...]
    settings: Mapping[str, str]  # what sets each cell apart from its study's others
    alpha: float  # false-alarm rate that all lines share

    @property
    def changed(self) -> int:
        """Number of lines with a step."""
        return len({each.line for each in self.breaks})

    def count(self, run: int, way: Standing) -> int:
        """Number of lines with a step at a run in this direction.

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
        """Groups of changes, each with the run where they begin, largest first."""
        found = [
            (run, move)
            for run in sorted({each.run for each in self.breaks})
            for move in moved(self._steps_at(run))
        ]
        return tuple(sorted(found, key=lambda pair: (-pair[1].worst.weight, pair[0])))

    def _steps_at(self, run: int) -> Iterator[Step]:
        """One step for each line at a run; lines without one did not move."""
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
    breaks: list[Break] = []
    for number, (line, series) in enumerate(zip(lines, known, strict=True)):
        points = [point for point in line.points if isfinite(point.value)]
        steps = [
            (new.run, (old.value, new.value, 0.0), 0.0)
            for old, new in pairwise(line.points)
            if isfinite(old.value) != isfinite(new.value)  # a number became none
        ]
        if series is None:
            pairs = list(_neighbours(points))
            bounds = rounding_of([old.row for old, _ in pairs], 0.0)
            steps += [
                (new.run, (old.value, new.value, 0.0), float(bound))
                for (old, new), bound in zip(pairs, bounds, strict=True)
                if abs(new.value - old.value) > bound
            ]
        else:
            limit = float(limits[number])
            quantile = -float(scipy.special.ndtri(limit / series.comparisons / 2.0))
            steps += [
                (
                    points[found.place].run,
                    (found.before, found.after, found.error),
                    quantile * found.error,
                )
                for found in steps_in(series, limit, min(even, limit))
            ]
        breaks += (
            Break(run=run, line=number, step=_step(line, run, levels, least))
            for run, levels, least in steps
        )
    return Trend(
        origins=tuple(map(origin_of, runs)),
        lines=lines,
        breaks=tuple(sorted(breaks, key=lambda each: (each.line, each.run))),
        within=_within(len(runs), lines, breaks),
        settings={k: v for run in runs for k, v in short_names(run.cells).items()},
        alpha=alpha,
    )


def _neighbours(points: Sequence[Point]) -> Iterator[tuple[Point, Point]]:
    """Pairs of points without chance that may be compared, each with the one before.

    What is of one draw of the noise is compared with the last of the same seed: another
    seed is no change of code.
    """
    last: dict[int, Point] = {}
    for point in points:
        of = point.seed if point.row.statistic.family.one_draw else -1
        if of in last:
            yield last[of], point
        last[of] = point


def _series(line: Line) -> Series | None:
    """The line's values that involve chance; None if there are none."""
    points = [point for point in line.points if isfinite(point.value)]
    errors = np.array([point.row.standard_error for point in points])
    # a share that was 0 or 1 in all trials has no spread of its own to tell its error
    good = np.isfinite(errors) & (errors > 0.0)
    if len(points) < 2 or not good.any():
        return None
    seeds = list(dict.fromkeys(point.seed for point in points))  # of any size
    return Series(
        values=np.array([point.value for point in points]),
        errors=np.where(good, errors, errors[good].max()),
        seeds=np.array([seeds.index(point.seed) for point in points]),
    )


def _step(
    line: Line, run: int, levels: tuple[float, float, float], least: float
) -> Step:
    """The step of a line at a run, with its direction."""
    at = next(i for i, point in enumerate(line.points) if point.run == run)
    theory = line.points[at - 1].row.prediction, line.points[at].row.prediction
    before, after, error = levels
    change = loss_change(line.statistic, (before, after), theory)
    return Step(
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


def _within(
    runs: int, lines: Sequence[Line], breaks: Sequence[Break]
) -> tuple[int, ...]:
    """Count for each run the values that moved on the same noise without a step."""
    steps = {(each.line, each.run) for each in breaks}
    pairs = [
        (old, new)
        for number, line in enumerate(lines)
        for old, new in pairwise(line.points)
        if old.cell == new.cell
        and old.row.n == new.row.n
        and (number, new.run) not in steps
    ]
    errors = [max(o.row.standard_error, n.row.standard_error) for o, n in pairs]
    bounds = rounding_of([old.row for old, _ in pairs], errors)
    counts = [0] * runs
    for (old, new), error, bound in zip(pairs, errors, bounds, strict=True):
        if error > 0.0 and abs(new.value - old.value) > bound:
            counts[new.run] += 1
    return tuple(counts)
