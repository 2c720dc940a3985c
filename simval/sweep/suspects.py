"""Cells whose workers are lost again and again.

A scheduler that chooses freely counts the workers that died while they had a task, and
gives it up. While batches name their workers it waits for those, and their batches come
back. In both cases the cell may be deadly, or wait beside one that is, or its workers
were taken away for reasons of their own. So it is computed by itself, after all others;
if it is lost once more, it has failed.
"""

from collections import Counter, deque
from collections.abc import Iterable, Sequence

from simval.sweep.cells import Done
from simval.sweep.executors import Queue, failed

RETURNS = 3
"""How often a cell comes back before it is computed by itself: as many losses as dask
allows a task (`allowed-failures`)."""

GIVEN_UP = (
    f"every worker was lost: all that might compute this cell were lost {RETURNS + 1} "
    "times while they had it, the last time with nothing else to do"
)


class Suspects:
    """Counts how often each cell came back, and keeps some for the end."""

    def __init__(self) -> None:
        self._returns: Counter[int] = Counter()
        self._last: deque[tuple[int, str]] = deque()  # and why it was lost
        self._tried: set[int] = set()  # those computed by themselves

    def __bool__(self) -> bool:
        return bool(self._last)

    def came_back(self, places: Iterable[int], queue: Queue) -> None:
        """Have cells given out alone, or keep them until all others are done."""
        for place in places:
            self._returns[place] += 1
            if self._returns[place] < RETURNS and place not in self._tried:
                queue.give_back([place])
            else:
                self.keep(place, GIVEN_UP)

    def keep(self, place: int, why: str) -> None:
        """Keep a cell until all others are done."""
        self._last.append((place, why))

    def next(self, queue: Queue) -> Sequence[Done]:
        """Give out one of those kept, where nothing else is left, or say it failed."""
        place, why = self._last.popleft()
        if place in self._tried:
            return [failed(*queue.alone(place).cells[0], why)]
        self._tried.add(place)
        queue.give_back([place])
        return []
