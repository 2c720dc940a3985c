"""The time that a sweep still takes, by the cost of its cells and not by their number.

Each cell states a cost (`--dry-run` prints it). What a second of it takes in truth is
the pace: the seconds that the ended cells took over those that they stated, with the
stated costs themselves as `PRIOR` seconds of evidence,

    pace = (PRIOR + sum of taken) / (PRIOR + sum of stated).

Cells begin in their order, as many at a time as there are workers, so those that run
are the first that have not ended. Cells that travel together end together, some of them
before earlier ones; these are passed over when their turn comes. What is left of one is
its cost times the pace, less its age. The time left is what is left of all over the
workers, or of the longest one.
"""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Final

from simval.studies.study import Cell

PRIOR: Final = 5.0
"""Seconds of stated cost that a suite's statement counts for. Chosen: in the smoke
suite the first few cells decide, in the accuracy suite the first of 142."""

LEAST: Final = 1e-3
"""Least cost of a cell, s: none is free."""


@dataclass(frozen=True, slots=True)
class Running:
    """A cell at work, its cost in seconds, and when it began."""

    cell: Cell
    cost: float
    began: float


class TimeLeft:
    """Follows cells that begin in their order and end in any."""

    def __init__(self, cells: Sequence[Cell], workers: int, now: float) -> None:
        self._cells = cells
        stated = (max(cell.parameters.cost().seconds, LEAST) for cell in cells)
        self._costs = array("d", stated)
        # sum and greatest of the costs from each cell on, and of none at the end
        costs = self._costs[::-1]
        self._sums = array("d", accumulate(costs, initial=0.0))[::-1]
        self._greatest = array("d", accumulate(costs, max, initial=0.0))[::-1]
        self._begun = 0
        self._workers = workers
        self._running: dict[str, Running] = {}
        self._early: set[str] = set()  # ended, and not yet taken for begun
        self._taken = self._stated = PRIOR
        self._begin(now)

    def end(self, name: str, now: float) -> None:
        """Note that a cell has ended, and that the next one begins."""
        ended = self._running.pop(name, None)
        if ended is None:
            self._early.add(name)
        else:
            self._taken += now - ended.began
            self._stated += ended.cost
        self._begin(now)

    def running(self) -> tuple[Cell, ...]:
        """The cells at work, the first one first."""
        return tuple(each.cell for each in self._running.values())

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
        while len(self._running) < self._workers and self._begun < len(self._cells):
            cell, cost = self._cells[self._begun], self._costs[self._begun]
            self._begun += 1
            if cell.name in self._early:
                self._early.remove(cell.name)
                self._stated += cost  # its time was that of those taken to run
            else:
                self._running[cell.name] = Running(cell, cost, now)


def told(seconds: float) -> str:
    """A time left in words: rounded, as it is an estimate."""
    if seconds < 10.0:
        return "a few seconds"
    if seconds < 90.0:
        return f"{round(seconds, -1):.0f} s"
    if seconds < 90 * 60.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"
