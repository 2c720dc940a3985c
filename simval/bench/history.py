r"""Runs of the races over commits: which ratios have a step, and since when.

A contender keeps its level until the interval of a run has no point in common with
that of the run where the level began; so a slow change is seen too. Two runs of seven
rounds each that do not differ are as far apart with a chance of
:math:`2 \cdot 7!\,7!/14!`, one in 1716. What differs between runs and not within one
(the machine, its other work, where the memory lies) is not in the intervals.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from simval.bench.interval import CONFIDENCE
from simval.bench.record import Kept, Record, read_record
from simval.errors import InputError

MOST = 10_000  # files in a folder


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """The ratios of one contender over the runs."""

    race: str
    contender: str
    reference: str
    points: tuple[tuple[int, Kept], ...]  # by the place of their run


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A ratio that left its level."""

    line: Line
    since: int  # place of the run
    before: Kept  # of the run where the level before began
    after: Kept

    @property
    def time(self) -> float:
        """Time after it, in the time before."""
        return self.before.ratio / self.after.ratio


def read_history(folder: Path) -> tuple[Record, ...]:
    """Read the runs in a folder, in the order of their commits.

    Raises
    ------
    InputError
        If there is none, or one cannot be read.
    """
    files = sorted(folder.glob("*.json")) if folder.is_dir() else []
    if not files or len(files) > MOST:
        msg = (
            f"{folder} has {len(files)} JSON files, where 1 to {MOST} are needed; give "
            "a folder with files of `simval bench --json FILE`"
        )
        raise InputError(msg)
    records = [read_record(file) for file in files]
    return tuple(sorted(records, key=lambda record: (_moment(record), record.name)))


def _moment(record: Record) -> float:
    # s; a run whose commit has no date comes first
    try:
        return datetime.fromisoformat(record.committed).timestamp()
    except (ValueError, OverflowError, OSError):
        return float("-inf")


def lines_of(records: Sequence[Record], races: Iterable[str] = ()) -> tuple[Line, ...]:
    """The ratios by contender, and by the reference that they are to."""
    wanted = set(races)
    found: dict[tuple[str, str, str], list[tuple[int, Kept]]] = {}
    for place, record in enumerate(records):
        for kept in record.kept:
            if kept.contender == kept.reference or (wanted and kept.race not in wanted):
                continue
            key = (kept.race, kept.contender, kept.reference)
            found.setdefault(key, []).append((place, kept))
    return tuple(
        Line(race=race, contender=name, reference=reference, points=tuple(points))
        for (race, name, reference), points in found.items()
    )


def steps_of(line: Line) -> tuple[Step, ...]:
    """Where the ratio left its level; none for times on the wall."""
    judged = [
        (place, kept)
        for place, kept in line.points
        if kept.clock != "wall" and kept.confidence >= CONFIDENCE
    ]
    steps: list[Step] = []
    for place, kept in judged[1:]:
        level = steps[-1].after if steps else judged[0][1]
        if kept.low > level.high or kept.high < level.low:
            steps.append(Step(line=line, since=place, before=level, after=kept))
    return tuple(steps)
