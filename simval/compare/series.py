"""The runs of a folder in the order of their commits, and a line for each statistic.

A statistic is followed by its study, its parameters (without seed and samples), its
place among equal cells of a run in the order of their seeds, and its name. Values of a
row that a limit judges are rounding noise below it, so they count as the limit there.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from simval.arguments import file_path
from simval.change import question
from simval.compare.origin import Origin, origin_of
from simval.errors import InputError
from simval.results import Row
from simval.statistics import Statistic
from simval.sweep import load_run
from simval.sweep.run import CellResult, Run

Question = tuple[str, str, int]
"""Study, parameters, and place among the cells of a run that are equal in both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A statistic in one run."""

    run: int  # place of the run in the series
    cell: str
    seed: int
    row: Row

    @property
    def value(self) -> float:
        """The value; the limit where it is below one."""
        row = self.row
        below = row.check == "limit" and row.prediction is not None
        return max(row.value, row.prediction or 0.0) if below else row.value


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One statistic over the runs that have it."""

    study: str
    statistic: Statistic
    points: tuple[Point, ...]

    @property
    def cell(self) -> str:
        """Its cell, as the newest run names it."""
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
    """What the order of the runs is by, in words."""
    known = all(origin.committed for origin in origins)
    return "the date of their commits" if known else "the date of their runs"


def _date(origin: Origin, by_commit: bool) -> tuple[datetime, datetime]:
    texts = (origin.committed if by_commit else origin.started, origin.started)
    try:
        dates = [datetime.fromisoformat(text) for text in texts]
    except ValueError:
        msg = (
            f"the run {origin.name} has no date, so it has no place in a series; "
            "finish it with `simval sweep SUITE --resume`, or move it elsewhere"
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
        f"the {len(runs)} runs are of {len(names)} suites: {listed}; they share "
        f"{shared} of {len(set.union(*asked))} cells. Give each suite a folder of its "
        "own; `simval compare A B` compares two runs in what they share"
    )
    raise InputError(msg)


def _cells(run: Run) -> Iterator[tuple[Question, CellResult]]:
    """Finished cells of a run by what they ask."""
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
    """Each value once, whatever theories it is beside."""
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
