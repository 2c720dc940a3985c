"""The time that a sweep still takes, by the cost of its cells and not by their number.

Each cell states a cost (`--dry-run` prints it). What a second of it takes in truth is
the pace: the seconds that the ended cells took over those that they stated, with the
stated costs themselves as `PRIOR` seconds of evidence,

    pace = (PRIOR + sum of taken) / (PRIOR + sum of stated).

Cells begin in their order, as many at a time as there are workers, so those that run
are the first that have not ended. What is left of one is its cost times the pace, less
its age. The time left is what is left of all over the workers, or of the longest one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Final

PRIOR: Final = 5.0
"""Seconds of stated cost that a suite's statement counts for. Chosen: in the smoke
suite the first few cells decide, in the accuracy suite the first of 142."""

LEAST: Final = 1e-3
"""Least cost of a cell, s: none is free."""


@dataclass(frozen=True, slots=True)
class Running:
    """A cell at work: what it is called, its cost in seconds, and when it began."""

    name: str
    cost: float
    began: float


class TimeLeft:
    """Follows cells that begin in their order and end in any."""

    def __init__(
        self, cells: Sequence[tuple[str, float]], workers: int, now: float
    ) -> None:
        self._cells = [(name, max(cost, LEAST)) for name, cost in cells]
        costs = [cost for _, cost in reversed(self._cells)]
        # sum and greatest of the costs from each cell on, and of none at the end
        self._sums = [*accumulate(costs, initial=0.0)][::-1]
        self._greatest = [*accumulate(costs, max, initial=0.0)][::-1]
        self._begun = 0
        self._workers = workers
        self._running: dict[str, Running] = {}
        self._taken = self._stated = PRIOR
        self._begin(now)

    def end(self, name: str, now: float) -> None:
        """Note that a cell has ended, and that the next one begins."""
        ended = self._running.pop(name, None)
        if ended is not None:
            self._taken += now - ended.began
            self._stated += ended.cost
        self._begin(now)

    def running(self) -> tuple[str, ...]:
        """Names of the cells at work, the first one first."""
        return tuple(self._running)

    def seconds(self, now: float) -> float:
        """Time until the last cell ends, s; 0 or more."""
        pace = self._taken / self._stated
        parts = [
            max(pace * each.cost - (now - each.began), 0.0)
            for each in self._running.values()
        ]
        whole = (sum(parts) + pace * self._sums[self._begun]) / self._workers
        return max(whole, pace * self._greatest[self._begun], *parts)

    def _begin(self, now: float) -> None:
        free = self._workers - len(self._running)
        for name, cost in self._cells[self._begun : self._begun + free]:
            self._begun += 1
            self._running[name] = Running(name, cost, now)


def told(seconds: float) -> str:
    """A time left in words: rounded, as it is an estimate."""
    if seconds < 10.0:
        return "a few seconds"
    if seconds < 90.0:
        return f"{round(seconds, -1):.0f} s"
    if seconds < 90 * 60.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
