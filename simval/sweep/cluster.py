"""Cells on a running dask.distributed cluster, whose workers may join and leave.

Each batch carries what the driver states of itself, and a worker that differs answers
with the reason in words (`simval.sweep.identity`). It gets no further batch, and what
it was given goes to another one. Batch and statement travel as bytes, and the function
that looks at them as code: what travels by its name makes a worker without that module
break its connection and end.
"""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from simval.errors import InputError, LostClusterError
from simval.sweep.cells import Done
from simval.sweep.executors import Batch, Compute, Flying, Queue, failed, windowed
from simval.sweep.identity import Stated, StrangerError, refusal

CONNECT_TIMEOUT = 10.0  # s

WAIT = 60.0
"""Time that a sweep waits for a worker while there is none, s."""

ANSWER = 60.0
"""Time that a worker may take to identify itself, s: it imports simval first,
from a file system that may be slow."""

PAUSE = 0.1
"""Between two looks for a worker while there is none, s."""

AGE = 1.0
"""Greatest age of the list of workers, s."""

AHEAD = 2
"""Batches in flight for each thread: one at work, one that waits for it."""

GIVEN_UP = (
    "every worker was lost that had this cell, the last time with nothing else to do"
)

Tell = Callable[[str], None]
"""Says to the user what becomes of the workers."""


@contextmanager
def clustered(
    address: str, stated: Stated, wait: float, tell: Tell
) -> Iterator[Compute]:
    """Connect to a dask.distributed cluster that is running.

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
            connect = type("Connected", (Client,), {"__del__": _end})
            client = connect(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError, TypeError, TimeoutError) as error:
            msg = f"there is no scheduler at {address}: {error}; start `dask scheduler`"
            raise InputError(msg) from None
        with client:
            cluster = Cluster(client, address, stated, wait, tell)
            cluster.begin()
            yield partial(_by_cluster, cluster)


def answering() -> Callable[[bytes, bytes], Any]:
    """Make the function that a worker runs on a batch, or on none to be checked.

    A worker that differs answers with its address and why: lines, or the words of an
    error.
    """

    def answer(stated: bytes, batch: bytes) -> Any:
        import pickle

        from distributed import get_worker

        try:
            pickle.loads(stated).require()
            from simval.sweep.executors import computed
            from simval.sweep.identity import StrangerError
        except Exception as error:
            words = f"{type(error).__name__}: {error}"
            return get_worker().address, getattr(error, "lines", words)
        try:
            return computed(pickle.loads(batch)) if batch else []
        except StrangerError as error:
            return get_worker().address, error.lines

    return answer


class Cluster:
    """Workers of a scheduler, to which batches are handed."""

    def __init__(
        self, client: Any, address: str, stated: Stated, wait: float, tell: Tell
    ) -> None:
        from distributed.protocol.pickle import dumps

        self.client, self.address = client, address
        self._wait, self._tell, self._dumps = wait, tell, dumps
        self._stated = dumps(stated)
        self._executor = client.get_executor(pure=False)
        self._seen = -AGE
        self._threads: dict[str, int] = {}  # of the workers that may compute
        self._refused: dict[str, tuple[str, ...]] = {}  # of those there, why not

    def begin(self) -> None:
        """Wait for the first worker that may compute; each is checked."""
        try:
            self._await(self._answered({}), at_start=True)
        except (OSError, CancelledError) as error:
            raise self.lost(error) from None

    def submit(self, function: Any, batch: Batch) -> Future[list[Done]]:
        """Hand a batch to workers that may compute.

        Of several that join or leave just now the scheduler may choose another one,
        which then answers for itself.
        """
        errand = answering(), self._stated, self._dumps(batch)
        if not self._refused:
            return self._executor.submit(*errand)
        fit = {"workers": sorted(self._threads), "allow_other_workers": True}
        return self._executor.submit(*errand, **fit)

    def window(self) -> int:
        """Number of batches to keep in flight."""
        self._look()
        if not self._threads:
            self._await(lambda: bool(self._threads))
        return AHEAD * sum(self._threads.values())

    def refuse(self, address: str, lines: tuple[str, ...]) -> None:
        """Use a worker no more, and say why, once for workers that are alike."""
        known = self._refused.values()
        if lines not in known:
            self._tell(f"worker {address} computes nothing: {'; '.join(lines)}")
        self._threads.pop(address, None)
        self._refused[address] = lines
        self._seen = -AGE  # it may have been the last one

    def lost(self, error: BaseException) -> LostClusterError:
        """Raise the error that the scheduler is gone."""
        reason = str(error) or "it ended, or the connection broke"
        return LostClusterError(f"lost the scheduler at {self.address}: {reason}")

    def _look(self) -> None:
        """Check the workers, unless that was done just now."""
        now = time.monotonic()
        if now - self._seen < AGE and self._threads:
            return
        self._seen = now
        if self.client.status != "running":
            msg = "it does not answer"
            raise OSError(msg)
        there = dict(self.client.nthreads())
        self._refused = {a: why for a, why in self._refused.items() if a in there}
        self._threads = {a: n for a, n in there.items() if a not in self._refused}

    def _answered(self, asked: dict[str, Any]) -> Callable[[], bool]:
        """Check every worker; return whether one may compute."""

        def somebody() -> bool:
            for address in self._threads.keys() - asked.keys():
                question = (answering(), self._stated, b"")
                options = {"workers": [address], "pure": False, "priority": 1}
                asked[address] = self.client.submit(*question, **options)
            for address in [a for a in self._threads if asked[a].done()]:
                answer = asked[address]
                if answer.status != "finished":
                    self.refuse(address, (f"it does not answer ({answer.status})",))
                    continue
                error = refusal(answer.result())
                if error is None:
                    return True
                self.refuse(address, error.lines)
            return False

        return somebody

    def _await(self, somebody: Callable[[], bool], at_start: bool = False) -> None:
        """Wait until some worker may compute.

        While there is none, a question to any is open, so that a cluster that grows on
        demand sees a demand.
        """
        start = time.monotonic()
        demand = self.client.submit(answering(), self._stated, b"", pure=False)
        said = False
        try:
            while True:
                self._look()
                if somebody():
                    return
                patience = max(self._wait, ANSWER) if self._threads else self._wait
                late = time.monotonic() - start >= patience
                if late or (at_start and self._refused and not self._threads):
                    raise self._nobody(at_start)
                if not (said or self._threads):
                    self._tell(
                        f"the scheduler at {self.address} has no worker that may "
                        f"compute; waiting {self._wait:g} s for one"
                    )
                    said = True
                time.sleep(PAUSE)
        finally:
            with suppress(Exception):  # the scheduler may be what is lost
                demand.cancel()

    def _nobody(self, at_start: bool) -> InputError | LostClusterError:
        refused = self._refused
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
                + (" that answers" if self._threads else "")
                + f", and none joined within {self._wait:g} s; "
                f"start `dask worker {self.address}`, or wait longer with --wait"
            )
        return InputError(msg) if at_start else LostClusterError(msg)


def _by_cluster(cluster: Cluster, queue: Queue) -> Iterator[Sequence[Done]]:
    """Compute on a cluster, and name the cell that kills workers.

    The scheduler gives up a batch after it has lost so many workers (dask's
    `allowed-failures`) that had it, at work or waiting. Its cells are then given out
    alone, those that are lost so after all others, each by itself; one that is lost
    even then has failed. Where only workers are left that were refused, the batch
    comes back instead, and is counted here.
    """
    from distributed.scheduler import KilledWorker

    flying: Flying = {}
    tried: set[int] = set()  # suspects that were given out by themselves
    while queue or flying or queue.suspects:
        if not (queue or flying):
            yield _suspected(queue, tried)
        try:
            yield from windowed(cluster, queue, flying, cluster.window, (KilledWorker,))
        except KilledWorker:
            for future in [future for future in flying if future.done()]:
                if isinstance(future.exception(), KilledWorker):
                    queue.was_lost(flying.pop(future))
        except StrangerError as error:
            cluster.refuse(error.worker, error.lines)
        except (CancelledError, OSError) as error:
            raise cluster.lost(error) from None


def _suspected(queue: Queue, tried: set[int]) -> Sequence[Done]:
    """Give a suspected cell out alone, or report that it kills workers so, too."""
    place = queue.suspects.popleft()
    if place in tried:
        return [failed(*queue.alone(place).cells[0], GIVEN_UP)]
    tried.add(place)
    queue.give_back([place])
    return []


def _end(client: Any) -> None:
    # one that has never connected would wait for 20 s, and complain
    if client.status == "running":
        client.close()


@contextmanager
def _own_words() -> Iterator[None]:
    """Silence messages of `distributed` about lost connections."""
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
