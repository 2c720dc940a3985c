"""Cells in batches, as many as their stated costs fill: cheap ones share a task.

A task has a price of its own (a message there, one back, a transaction), some
milliseconds on a cluster. Cells that cost seconds travel alone; of those that cost
milliseconds a batch has so many that the price is small beside their work. What is
lost with a worker is at most a batch, and so is what a stopped driver computes again.
"""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from simval.results import Outcome
from simval.studies.study import Cell
from simval.sweep.identity import Stated

SECONDS = 1.0
"""Stated cost at which a batch is full, s. Chosen: a hundred times the price of a task
on a cluster, and no more than a person waits for a sweep that is stopped."""

CELLS = 500
"""Most cells in a batch, whatever they say they cost."""

ROWS = 20_000
"""Stated rows at which a batch is full: 2 MB on the way, 10 MB where it is read."""

SHARES = 4
"""Least number of batches that are left for each that is at work. Chosen: at the end
of a sweep no worker waits for longer than a quarter of what the others have done."""

Work = Callable[[Cell], Outcome]
"""What computes a cell."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Cells that are computed together, each with its place in the suite."""

    cells: tuple[tuple[int, Cell], ...]
    alpha: float  # the part of the false-alarm rate of each
    work: Work | None = None  # None is the study's own
    stated: Stated | None = None  # what whoever computes them must be

    @property
    def places(self) -> list[int]:
        """Places of its cells."""
        return [place for place, _ in self.cells]


class Queue:
    """The cells to compute, made and handed out in their order."""

    def __init__(
        self,
        cells: Sequence[Cell],
        pending: Sequence[int],
        alpha: float,
        work: Work | None = None,
        stated: Stated | None = None,
    ) -> None:
        self._cells, self._pending, self._stated = cells, pending, stated
        self._alpha, self._work = alpha / max(len(cells), 1), work
        self._next = 0
        self._alone: deque[int] = deque()

    def __bool__(self) -> bool:
        return bool(self._alone) or self._next < len(self._pending)

    def take(self, at_once: int) -> Batch:
        """The next batch, where so many are at work at once."""
        if self._alone:
            return self.alone(self._alone.popleft())
        left = len(self._pending) - self._next
        most = min(CELLS, max(1, left // (SHARES * at_once)))
        batch: list[tuple[int, Cell]] = []
        seconds, rows = 0.0, 0
        while len(batch) < most and self._next < len(self._pending):
            place, cell = self._cell(self._pending[self._next])
            cost = cell.parameters.cost()
            seconds, rows = seconds + cost.seconds, rows + cost.rows
            if batch and (seconds > SECONDS or rows > ROWS):
                break
            self._next += 1
            batch.append((place, cell))
        return Batch(tuple(batch), self._alpha, self._work, self._stated)

    def alone(self, place: int) -> Batch:
        """A batch of one cell."""
        return Batch((self._cell(place),), self._alpha, self._work, self._stated)

    def give_back(self, places: Iterable[int]) -> None:
        """Have some cells computed alone, before all others."""
        self._alone.extend(places)

    def _cell(self, place: int) -> tuple[int, Cell]:
        return place, self._cells[place]
