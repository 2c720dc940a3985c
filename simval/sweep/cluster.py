"""Cells on a running dask.distributed cluster, whose workers may come and go."""

import logging
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from simval.errors import InputError, LostClusterError
from simval.sweep.cells import Done
from simval.sweep.errand import errand
from simval.sweep.executors import Batch, Compute, Flying, Queue, windowed
from simval.sweep.identity import Stated, StrangerError
from simval.sweep.roster import Roster, Tell, question
from simval.sweep.suspects import Suspects

CONNECT_TIMEOUT = 10.0  # s

WAIT = 60.0
"""How long a sweep waits for a worker while there is none, s."""

ANSWER = 60.0
"""How long a worker that is there may take to say what it is, s: it imports simval
first, from a file system that may be slow."""

PAUSE = 0.1
"""Between two looks for a worker while there is none, s."""

AHEAD = 2
"""Batches in flight for each thread: one at work, one that waits for it."""


@contextmanager
def clustered(
    address: str, stated: Stated, wait: float, tell: Tell
) -> Iterator[Compute]:
    """Connect to a running dask.distributed cluster.

    The scheduler gives a batch whose worker is lost to another one. If it loses worker
    after worker, its cells are given out alone, those that go on so by themselves at
    the end, and one that still does is stored as failed.

    Raises
    ------
    InputError
        If the extra is not installed, there is no scheduler at the address, no worker
        joins it in time, or every worker differs from this process.
    """
    try:
        from distributed import Client
    except ImportError:
        from simval.extras import refuse_without

        refuse_without("cluster", "a scheduler")
    with _own_words():
        try:
            connect: Any = type("Connected", (Client,), {"__del__": _end})
            client = connect(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError, TypeError, TimeoutError) as error:
            msg = f"there is no scheduler at {address}: {error}; start `dask scheduler`"
            raise InputError(msg) from None
        with client:
            crowd = Crowd(client, Roster(client, stated, tell), address, wait, tell)
            crowd.begin()
            yield partial(_by_cluster, crowd)


class Crowd:
    """Whoever computes on a cluster: it hands out batches, and waits for workers."""

    def __init__(
        self, client: Any, roster: Roster, address: str, wait: float, tell: Tell
    ) -> None:
        self.client, self.roster, self.address = client, roster, address
        self._wait, self._tell = wait, tell
        self._executor = client.get_executor(pure=False)
        self._errand = errand()
        self.suspects = Suspects()
        self._given: dict[Future[list[Done]], frozenset[str]] = {}

    def begin(self) -> None:
        """Wait for the first worker that may compute."""
        try:
            self._await_one(at_start=True)
        except (OSError, CancelledError) as error:
            raise self.lost(error) from None

    def submit(self, function: Any, batch: Batch) -> Future[list[Done]]:
        """Hand a batch to the workers that may compute it, and to no other.

        Where all may, the scheduler is left to choose: it then knows which batch a
        worker died of. One that joins just now may get the batch before it is asked
        what it is; the errand asks it.
        """
        from distributed.protocol.pickle import dumps

        errand = self._errand, dumps(batch.stated), dumps(batch)
        if not (self.roster.refused or self.roster.asked):
            return self._executor.submit(*errand)
        fit = sorted(self.roster.threads)
        future = self._executor.submit(*errand, workers=fit)
        self._given[future] = frozenset(fit)
        return future

    def window(self, flying: Flying, queue: Queue) -> int:
        """How many batches to keep in flight: twice the number of threads.

        It follows the workers that join and leave. A batch all of whose workers have
        left comes back.
        """
        self.roster.look()
        self._given = {f: fit for f, fit in self._given.items() if f in flying}
        for future, fit in self._given.items():
            if not (future.done() or fit & self.roster.threads.keys()):
                self.suspects.came_back(flying.pop(future).places, queue)
                future.cancel()
        if not self.roster.threads:
            self._await_one()
        return AHEAD * sum(self.roster.threads.values())

    def lost(self, error: BaseException) -> LostClusterError:
        """Say that the scheduler is gone."""
        reason = str(error) or "it ended, or the connection broke"
        return LostClusterError(f"lost the scheduler at {self.address}: {reason}")

    def _await_one(self, at_start: bool = False) -> None:
        """Wait until a worker may compute.

        While there is none, a question to any is open, so that a cluster that grows on
        demand sees a demand.
        """
        start = time.monotonic()
        demand = self.client.submit(question(), pure=False)
        said = False
        try:
            while not self._somebody():
                patience = max(self._wait, ANSWER) if self.roster.asked else self._wait
                late = time.monotonic() - start >= patience
                if late or (at_start and self._all_differ()):
                    raise self._nobody(at_start)
                if not (said or self.roster.asked):
                    self._tell(
                        f"the scheduler at {self.address} has no worker that may "
                        f"compute; waiting {self._wait:g} s for one"
                    )
                    said = True
                time.sleep(PAUSE)
        finally:
            with suppress(Exception):  # the scheduler may be what is lost
                demand.cancel()

    def _somebody(self) -> bool:
        self.roster.look()
        return bool(self.roster.threads)

    def _all_differ(self) -> bool:
        return bool(self.roster.refused) and not self.roster.asked

    def _nobody(self, at_start: bool) -> InputError | LostClusterError:
        refused = self.roster.refused
        if refused:
            lines = dict.fromkeys(line for each in refused.values() for line in each)
            msg = (
                f"every worker at {self.address} would give other numbers than the "
                f"driver ({len(refused)} of {len(refused)}): {'; '.join(lines)}; "
                "install the same there and start the workers again"
            )
        else:
            msg = (
                f"the scheduler at {self.address} has no worker"
                + (" that answers" if self.roster.asked else "")
                + f", and none joined within {self._wait:g} s; "
                f"start `dask worker {self.address}`, or wait longer with --wait"
            )
        return InputError(msg) if at_start else LostClusterError(msg)


def _by_cluster(crowd: Crowd, queue: Queue) -> Iterator[Sequence[Done]]:
    from distributed.scheduler import KilledWorker

    flying: Flying = {}
    window = partial(crowd.window, flying, queue)
    while queue or flying or crowd.suspects:
        if not (queue or flying):
            yield crowd.suspects.next(queue)
        try:
            yield from windowed(crowd, queue, flying, window, (KilledWorker,))
        except KilledWorker:
            _killed(crowd, flying, queue, KilledWorker)
        except StrangerError as error:
            crowd.roster.refuse(error.worker, error.lines)
        except (CancelledError, OSError) as error:
            raise crowd.lost(error) from None


def _killed(
    crowd: Crowd, flying: Flying, queue: Queue, kind: type[BaseException]
) -> None:
    """Give out the cells of batches that lose their workers alone, then one by one."""
    for future in [future for future in flying if future.done()]:
        error = future.exception()
        if isinstance(error, kind):
            places = flying.pop(future).places
            if len(places) > 1:
                queue.give_back(places)
            else:
                crowd.suspects.keep(places[0], f"every worker was lost: {error}")


def _end(client: Any) -> None:
    # one that has never connected would wait for 20 s, and complain
    if client.status == "running":
        client.close()


@contextmanager
def _own_words() -> Iterator[None]:
    """Keep what `distributed` logs about lost connections: we say it ourselves."""
    known = ("distributed", "tornado", *logging.root.manager.loggerDict)
    loggers = [
        logging.getLogger(name)
        for name in dict.fromkeys(known)
        if name.partition(".")[0] in ("distributed", "tornado")
    ]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
