"""Cells that come back again and again because whoever had them is lost.

A scheduler that chooses freely knows which task its workers died of. While batches name
their workers it does not: it waits for those, and their batches come back. Such a cell
may kill every worker that tries it, or wait beside one that does, or its workers were
taken away for reasons of their own. So one that has come back too often is computed by
itself, after all others; if it is lost once more, it has failed.
"""

from collections import Counter, deque
from collections.abc import Iterable, Sequence

from simval.sweep.batches import Queue
from simval.sweep.entries import Done
from simval.sweep.executors import failed

RETURNS = 3
"""How often a cell comes back before it is computed by itself: as many losses as dask
allows a task (`allowed-failures`)."""

GIVEN_UP = (
    f"every worker was lost: all that might compute this cell were lost {RETURNS + 1} "
    "times while they had it, the last time with nothing else to do"
)


class Suspects:
    """Counts how often each cell came back."""

    def __init__(self) -> None:
        self._returns: Counter[int] = Counter()
        self._last: deque[int] = deque()

    def __bool__(self) -> bool:
        return bool(self._last)

    def came_back(self, places: Iterable[int], queue: Queue) -> None:
        """Have cells given out alone, or keep them until all others are done."""
        for place in places:
            self._returns[place] += 1
            if self._returns[place] < RETURNS:
                queue.give_back([place])
            else:
                self._last.append(place)

    def next(self, queue: Queue) -> Sequence[Done]:
        """Give out one of those kept, where nothing else is left, or say it failed."""
        place = self._last.popleft()
        if self._returns[place] > RETURNS:
            return [failed(*queue.alone(place).cells[0], GIVEN_UP)]
        queue.give_back([place])
        return []
