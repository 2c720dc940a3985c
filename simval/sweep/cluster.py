"""Cells on a running dask.distributed cluster, whose workers may come and go."""

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from functools import partial
from typing import Any

from simval.errors import InputError
from simval.sweep import provenance
from simval.sweep.batches import Queue
from simval.sweep.entries import Done
from simval.sweep.executors import Compute, Flying, failed, windowed

CONNECT_TIMEOUT = 10.0  # s

ASKED = 1.0
"""How old the number of threads may be, s."""

AHEAD = 2
"""Batches in flight for each thread: one at work, one that waits for it."""


@contextmanager
def clustered(address: str) -> Iterator[Compute]:
    """Connect to a running dask.distributed cluster.

    The scheduler gives a batch whose worker is lost to another one. If it loses worker
    after worker, its cells are given out alone, and one that goes on so is stored as
    failed.

    Raises
    ------
    InputError
        If the extra is not installed, there is no scheduler at the address, it has no
        worker, or a worker has other versions than this process.
    """
    try:
        from distributed import Client
    except ImportError:
        from simval.extras import refuse_without

        refuse_without("cluster", "a scheduler")
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        msg = f"there is no scheduler at {address}: {error}; start `dask scheduler`"
        raise InputError(msg) from None
    with client:
        _check_workers(client, address)
        executor = client.get_executor(pure=False)
        yield partial(_by_cluster, executor, Window(client), address)


class Window:
    """How many batches to keep in flight: it follows the workers that join and leave.

    Where all have left, as many as there were stay in flight, so that a cluster that
    grows on demand sees the demand.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._asked = -ASKED
        self._size = AHEAD

    def __call__(self) -> int:
        """Twice the number of threads."""
        now = time.monotonic()
        if now - self._asked >= ASKED:
            self._asked = now
            threads = sum(self._client.nthreads().values())
            self._size = AHEAD * threads or self._size
        return self._size


def _by_cluster(
    executor: Executor, window: Window, address: str, queue: Queue
) -> Iterator[Sequence[Done]]:
    from distributed.scheduler import KilledWorker

    flying: Flying = {}
    while queue or flying:
        try:
            yield from windowed(executor, queue, flying, window, (KilledWorker,))
        except KilledWorker as error:
            yield _killed(flying, queue, error)
        except (CancelledError, OSError) as error:
            msg = (
                f"lost the scheduler at {address}: {error}; finished cells are "
                "kept, so continue with --resume"
            )
            raise InputError(msg) from None


def _killed(flying: Flying, queue: Queue, error: BaseException) -> Sequence[Done]:
    """Say of single cells that they lose their workers; give out the others alone."""
    gone = []
    for future in [f for f in flying if f.done() and f.exception()]:
        batch = flying.pop(future)
        if len(batch.cells) > 1:
            queue.give_back(batch.places)
        else:
            gone.append(failed(*batch.cells[0], f"every worker was lost: {error}"))
    return gone


def _check_workers(client: Any, address: str) -> None:
    """Check that there are workers, whose versions must be the same as here."""
    if not client.nthreads():
        msg = f"the scheduler at {address} has no worker; start `dask worker {address}`"
        raise InputError(msg)
    here = provenance.versions()
    for worker, there in client.run(provenance.versions).items():
        changed = provenance.differences(here, there)
        if changed:
            msg = (
                f"worker {worker} has other versions, so its numbers would differ: "
                f"{'; '.join(changed)}; install the same ones there"
            )
            raise InputError(msg)
