"""Where cells are computed: in this process, a local pool, or a cluster.

All yield what they are done with in the order in which batches end. A cell that raises
gives its traceback as its result; what is handled here is a worker that dies.

Cells travel in batches, as many as their stated costs fill. A task has a price of its
own (a message there, one back, a transaction), some milliseconds on a cluster. Cells
that cost seconds travel alone; of those that cost milliseconds a batch has so many that
the price is small compared with their work. At most a batch is lost with a worker, or
computed again after a stop.
"""

import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for_any
from threading import Thread
from typing import Any, Protocol, runtime_checkable

from simval.errors import CrashedPluginError, PluginError, UnmeasurableError
from simval.plugins.names import told_anywhere
from simval.results import Outcome
from simval.studies import find_study
from simval.studies.study import Cell
from simval.sweep.cells import (
    REFUSED,
    DamagedError,
    Done,
    cell_entry,
    digest_of_entries,
    row_entries,
)
from simval.sweep.identity import Stated, StrangerError, refusal, require_as_read
from simval.sweep.threads import ONE_THREAD
from simval.text import described, message_of, one_line, printable

PAUSE = 1.0  # s, after which the window is asked for again though nothing has ended

LOST: tuple[type[BaseException], ...] = (BrokenProcessPool, OSError)
"""Errors of a future whose worker is lost, and not of the cell itself."""

DIED = "the worker process died while it computed this cell"
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

RETURNS = 3
"""How often a batch may come back before its cells travel alone, and these before they
are computed by themselves: as many losses as dask allows a task."""

Work = Callable[[Cell], Outcome]
"""Function that computes a cell."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Cells that are computed together, each with its place in the suite."""

    cells: tuple[tuple[int, Cell], ...]
    work: Work | None = None  # None is the study's own
    stated: Stated | None = None  # what whoever computes them must be
    returns: int = 0  # how often it came back

    @property
    def places(self) -> list[int]:
        """Places of the cells in the suite."""
        return [place for place, _ in self.cells]


class Queue:
    """The cells to compute, handed out in order."""

    def __init__(
        self,
        cells: Sequence[Cell],
        pending: Sequence[int],
        work: Work | None = None,
        stated: Stated | None = None,
    ) -> None:
        self._cells, self._pending, self._stated = cells, pending, stated
        self._work = work
        self._next = 0
        self._back: deque[Batch] = deque()  # before all others
        self.suspects: deque[int] = deque()  # cells to be computed by themselves

    def __bool__(self) -> bool:
        return bool(self._back) or self._next < len(self._pending)

    def take(self, at_once: int) -> Batch:
        """Take the next batch, given how many are computed at once."""
        if self._back:
            return self._back.popleft()
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
        return Batch(tuple(batch), self._work, self._stated)

    def alone(self, place: int) -> Batch:
        """A batch of a single cell."""
        return Batch((self._cell(place),), self._work, self._stated)

    def put_back(self, batch: Batch) -> None:
        """Put a batch back, to be computed first."""
        self._back.append(batch)

    def give_back(self, places: Iterable[int]) -> None:
        """Put cells back, each to be computed alone, and first."""
        self._back.extend(map(self.alone, places))

    def came_back(self, batch: Batch) -> None:
        """Put a batch back, or split it into its cells if it came back before."""
        if batch.returns < RETURNS:
            self.put_back(replace(batch, returns=batch.returns + 1))
        else:
            self.was_lost(batch)

    def was_lost(self, batch: Batch) -> None:
        """Split a batch whose workers were lost into its cells.

        One that was alone is kept until nothing else is left.
        """
        if len(batch.cells) > 1:
            self.give_back(batch.places)
        else:
            self.suspects.extend(batch.places)

    def _cell(self, place: int) -> tuple[int, Cell]:
        return place, self._cells[place]


Compute = Callable[[Queue], Iterator[Sequence[Done]]]
"""From the cells to compute to what they leave, some at a time."""


def execute(cell: Cell) -> Outcome:
    """Compute one cell."""
    return find_study(cell.study).run(cell.parameters, cell.streams)


def attempt(
    position: int, cell: Cell, work: Work | None = None
) -> tuple[int, Outcome | str, float]:
    """Compute a cell, or say why it failed; with the CPU time taken, s."""
    start = time.process_time()
    try:
        with ONE_THREAD:
            outcome: Outcome | str = (work or execute)(cell)
    except (PluginError, UnmeasurableError) as error:
        crashed = isinstance(error, CrashedPluginError)
        words = described(error) if crashed else f"{REFUSED}{error}\n"
        outcome = told_anywhere(words, cell.parameters.files)
    except (Exception, SystemExit) as error:  # the other cells are computed in any case
        outcome = told_anywhere(described(error), cell.parameters.files)
    return position, outcome, time.process_time() - start


def computed(batch: Batch) -> list[Done]:
    """Compute the cells of a batch, and make their stored entries."""
    machine = "" if batch.stated is None else batch.stated.require()
    work = () if batch.work is None else (batch.work,)
    with ONE_THREAD:
        done = [
            _done(cell, *attempt(position, cell, *work))
            for position, cell in batch.cells
        ]
    if batch.stated is not None:
        require_as_read()
    return [each._replace(machine=machine) for each in done]


def _done(cell: Cell, position: int, outcome: Outcome | str, seconds: float) -> Done:
    if isinstance(outcome, str):
        return failed(position, cell, outcome, seconds)
    try:
        rows = row_entries(position, outcome.rows)
    except DamagedError as error:
        return failed(position, cell, f"a result that cannot be: {error}", seconds)
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        return failed(position, cell, described(error), seconds)
    entry = cell_entry(position, cell, "done", "", seconds, outcome.times)
    return Done(entry, rows, digest_of_entries(entry, rows), outcome.artifacts)


def failed(position: int, cell: Cell, error: str, seconds: float = 0.0) -> Done:
    """Entry of a cell that failed, with the reason."""
    entry = cell_entry(position, cell, "failed", printable(error), seconds)
    return Done(entry, (), digest_of_entries(entry, ()))


def serial(queue: Queue) -> Iterator[Sequence[Done]]:
    """Compute cells one after the other in this process."""
    with ONE_THREAD:
        while queue:
            yield computed(queue.take(1))


def pooled(queue: Queue, workers: int) -> Iterator[Sequence[Done]]:
    """Compute cells in a pool of local processes.

    When a worker dies, the cells that were in flight are computed one at a time, so
    that only the cell that kills its worker fails; then a new pool goes on.
    """
    while queue:
        flying: Flying = {}
        try:
            with _pool(workers) as pool:
                yield from windowed(pool, queue, flying, lambda: workers)
        except BrokenProcessPool:
            suspects = sorted(
                place for each in flying.values() for place in each.places
            )
            yield from _alone(map(queue.alone, suspects))


Flying = dict[Future[list[Done]], Batch]
"""The batches in flight."""


@runtime_checkable
class Submits(Protocol):
    """Anything that takes batches: a pool or a cluster."""

    def submit(
        self, function: Callable[[Batch], list[Done]], batch: Batch, /
    ) -> Future[list[Done]]:
        """Start the computation of a batch."""


def windowed(
    executor: Submits,
    queue: Queue,
    flying: Flying,
    window: Callable[[], int],
    lost_as: tuple[type[BaseException], ...] = (),
) -> Iterator[Sequence[Done]]:
    """Keep some batches in flight until the queue is empty; raise if one is lost.

    What could not be handed out goes back into the queue.
    """
    try:
        while queue or flying:
            at_once = window()
            while queue and len(flying) < at_once:
                batch = queue.take(at_once)
                try:
                    flying[_submitted(executor, batch)] = batch
                except BaseException:
                    queue.put_back(batch)
                    raise
            ended = wait(flying, timeout=PAUSE, return_when=FIRST_COMPLETED).done
            lost = [future for future in ended if _is_lost(future, lost_as)]
            for future in ended.difference(lost):
                yield _landed(future, flying.pop(future), queue)
            if lost:
                lost[0].result()
    except GeneratorExit:  # the driver stopped: start nothing more
        for future in flying:
            future.cancel()
        raise


def _submitted(executor: Submits, batch: Batch) -> Future[list[Done]]:
    # A worker that starts now inherits the blocked signal: only the driver gets
    # Ctrl-C, and it ends the workers.
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return executor.submit(computed, batch)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


def _is_lost(
    future: Future[list[Done]], lost_as: tuple[type[BaseException], ...]
) -> bool:
    return future.cancelled() or isinstance(future.exception(), (*LOST, *lost_as))


def _landed(future: Future[list[Done]], batch: Batch, queue: Queue) -> Sequence[Done]:
    """Result of a batch; if that could not be sent, its cells run one by one."""
    error = future.exception() or refusal(future.result())
    if error is None:
        return future.result()
    if isinstance(error, StrangerError):
        queue.came_back(batch)
        raise error
    if len(batch.cells) > 1:
        queue.give_back(batch.places)
        return []
    return [failed(*batch.cells[0], one_line(message_of(error)))]


def _alone(cells: Iterable[Batch]) -> Iterator[Sequence[Done]]:
    """Compute cells one at a time, and name one that kills its worker."""
    left = deque(cells)
    while left:
        try:
            with _pool(1) as pool:
                while left:
                    future = _submitted(pool, left[0])
                    error = future.exception()
                    if isinstance(error, BrokenProcessPool | StrangerError):
                        raise error
                    position, cell = left.popleft().cells[0]
                    yield (
                        future.result()
                        if error is None
                        else [failed(position, cell, one_line(message_of(error)))]
                    )
        except BrokenProcessPool:
            yield [failed(*left.popleft().cells[0], DIED)]


@contextmanager
def _pool(workers: int) -> Iterator[Executor]:
    """Pool of processes that end with it, or with the process that made it."""
    context = get_context("spawn")  # a fork would inherit locks of other threads
    receiver, sender = context.Pipe(duplex=False)
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=_begin_worker, initargs=(receiver,)
    ) as pool:
        try:
            yield pool
        except BaseException:
            sender.close()  # what stops the driver stops the cells in flight too
            raise
    sender.close()


def _begin_worker(receiver: Connection) -> None:
    """In a worker: end when the driver ends or closes the pipe."""
    ONE_THREAD.__enter__()  # as long as it lives
    parent = parent_process()
    assert parent is not None  # this is a child
    Thread(target=_follow, args=([parent.sentinel, receiver],), daemon=True).start()


def _follow(ends: list[Any]) -> None:
    wait_for_any(ends)
    os._exit(1)  # nobody is left to take the result
