"""Where cells are computed: in this process, in a local pool, or on a cluster.

All yield `Done` in the order in which cells end. A cell that raises gives its traceback
as its result; what is handled here is a worker that dies.
"""

import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for_any
from threading import Thread
from typing import Any

from simval.errors import (
    CrashedPluginError,
    InputError,
    PluginError,
    UnmeasurableError,
)
from simval.plugins.names import told_anywhere
from simval.results import Outcome
from simval.startup import load_lightly
from simval.studies import find_study
from simval.studies.study import Cell
from simval.sweep import provenance
from simval.sweep.cells import REFUSED
from simval.text import described, message_of, one_line

CONNECT_TIMEOUT = 10.0  # s

LOST: tuple[type[BaseException], ...] = (BrokenProcessPool, OSError)
"""Errors of a future whose worker is lost, and not of the cell itself."""

Done = tuple[int, Outcome | str, float]
"""Place of the cell, its outcome or the traceback of its failure, CPU seconds."""

Compute = Callable[[Sequence[Cell], Sequence[int]], Iterator[Done]]
"""From the cells of a suite, and the places of those to compute, to their results."""


def execute(cell: Cell) -> Outcome:
    """Compute one cell."""
    return find_study(cell.study).run(cell.parameters, cell.streams)


def attempt(position: int, cell: Cell) -> Done:
    """Compute one cell, or say why that failed."""
    start = time.process_time()
    try:
        outcome: Outcome | str = execute(cell)
    except (PluginError, UnmeasurableError) as error:
        crashed = isinstance(error, CrashedPluginError)
        words = described(error) if crashed else f"{REFUSED}{error}\n"
        outcome = told_anywhere(words, cell.parameters.files)
    except (Exception, SystemExit) as error:  # the other cells are computed in any case
        outcome = told_anywhere(described(error), cell.parameters.files)
    return position, outcome, time.process_time() - start


def serial(cells: Sequence[Cell], pending: Sequence[int]) -> Iterator[Done]:
    """Compute cells one after the other in this process."""
    for position in pending:
        yield attempt(position, cells[position])


def pooled(
    cells: Sequence[Cell], pending: Sequence[int], workers: int
) -> Iterator[Done]:
    """Compute cells in a pool of local processes.

    When a worker dies, a new pool is made and the cells that were in flight are
    computed one at a time, so that only the cell that kills its worker fails.
    """
    queue = deque(pending)
    while queue:
        flying: dict[Future[Done], int] = {}
        try:
            with _pool(workers) as pool:
                yield from _windowed(pool, cells, queue, flying, workers)
        except BrokenProcessPool:
            for position in sorted(flying.values()):
                yield _alone(position, cells[position])


@contextmanager
def clustered(address: str) -> Iterator[Compute]:
    """Connect to a running dask.distributed cluster.

    The scheduler gives a cell whose worker is lost to another one; a cell that loses
    worker after worker is stored as failed.

    Raises
    ------
    InputError
        If the extra is not installed, there is no scheduler at the address, it has no
        worker, or a worker has other versions than this process.
    """
    try:
        from distributed import Client
    except ImportError:
        msg = "a scheduler needs the extra `cluster`: pip install 'simval[cluster]'"
        raise InputError(msg) from None
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        msg = f"there is no scheduler at {address}: {error}; start `dask scheduler`"
        raise InputError(msg) from None
    with client:
        threads = _checked_workers(client, address)
        executor = client.get_executor(pure=False)
        yield partial(_by_cluster, executor, 2 * threads, address)


def _by_cluster(
    executor: Executor,
    window: int,
    address: str,
    cells: Sequence[Cell],
    pending: Sequence[int],
) -> Iterator[Done]:
    from distributed.scheduler import KilledWorker

    flying: dict[Future[Done], int] = {}
    queue = deque(pending)
    while queue or flying:
        try:
            yield from _windowed(
                executor, cells, queue, flying, window, (KilledWorker,)
            )
        except KilledWorker as error:
            for future in [f for f in flying if f.done() and f.exception()]:
                yield flying.pop(future), f"every worker was lost: {error}", 0.0
        except (CancelledError, OSError) as error:
            msg = (
                f"lost the scheduler at {address}: {error}; finished cells are "
                "kept, so continue with --resume"
            )
            raise InputError(msg) from None


def _checked_workers(client: object, address: str) -> int:
    """Count the threads of the cluster, whose versions must be the same as here."""
    workers: dict[str, int] = client.nthreads()  # type: ignore[attr-defined]
    if not workers:
        msg = f"the scheduler at {address} has no worker; start `dask worker {address}`"
        raise InputError(msg)
    here = provenance.versions()
    for worker, there in client.run(provenance.versions).items():  # type: ignore[attr-defined]
        changed = provenance.differences(here, there)
        if changed:
            msg = (
                f"worker {worker} has other versions, so its numbers would differ: "
                f"{'; '.join(changed)}; install the same ones there"
            )
            raise InputError(msg)
    return sum(workers.values())


def _windowed(
    executor: Executor,
    cells: Sequence[Cell],
    queue: deque[int],
    flying: dict[Future[Done], int],
    window: int,
    lost_as: tuple[type[BaseException], ...] = (),
) -> Iterator[Done]:
    """Keep `window` cells in flight until the queue is empty; raise if one is lost."""
    try:
        while queue or flying:
            while queue and len(flying) < window:
                position = queue[0]  # it leaves the queue once it is in flight
                flying[_submitted(executor, position, cells[position])] = position
                queue.popleft()
            ended = wait(flying, return_when=FIRST_COMPLETED).done
            lost = [future for future in ended if _is_lost(future, lost_as)]
            for future in ended.difference(lost):
                yield _landed(future, flying.pop(future))
            if lost:
                lost[0].result()
    except GeneratorExit:  # the driver stopped: start nothing more
        for future in flying:
            future.cancel()
        raise


def _submitted(executor: Executor, position: int, cell: Cell) -> Future[Done]:
    # A worker that starts now inherits the blocked signal: only the driver gets
    # Ctrl-C, and it ends the workers.
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return executor.submit(attempt, position, cell)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


def _is_lost(future: Future[Done], lost_as: tuple[type[BaseException], ...]) -> bool:
    return future.cancelled() or isinstance(future.exception(), (*LOST, *lost_as))


def _landed(future: Future[Done], position: int) -> Done:
    error = future.exception()
    if error is None:
        return future.result()
    # the cell was computed, but its outcome could not travel
    return position, one_line(message_of(error)), 0.0


def _alone(position: int, cell: Cell) -> Done:
    try:
        with _pool(1) as pool:
            return _submitted(pool, position, cell).result()
    except BrokenProcessPool:
        return position, "the worker process died while it computed this cell", 0.0


@contextmanager
def _pool(workers: int) -> Iterator[Executor]:
    """Pool of processes that end with the pool, and when its driver ends or stops."""
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
    """Let a worker start quickly, and end when its driver ends or closes the pipe."""
    load_lightly()
    parent = parent_process()
    assert parent is not None  # this is a child
    Thread(target=_follow, args=([parent.sentinel, receiver],), daemon=True).start()


def _follow(ends: list[Any]) -> None:
    wait_for_any(ends)
    os._exit(1)  # nobody is left to take the result
