"""The workers of a cluster: which may compute, which differ from the driver, and why.

A worker is asked what it is before it gets a cell, and so is one that joins later. The
question is a task of its own for that worker alone, so that one that cannot even load
this version, or does not answer, keeps nobody waiting.
"""

import time
from collections.abc import Callable
from typing import Any

from simval.sweep.identity import Identity, Stated, differing, unable
from simval.text import message_of

ASKED = 1.0
"""How old the list of workers may be, s."""

FETCH = 5.0
"""How long an answer that is there may travel, s: it is lost with its worker."""

Tell = Callable[[str], None]
"""Says to the user what becomes of the workers."""


def question() -> Callable[[], Any]:
    """What a worker is asked; it travels as code, so that any worker can answer.

    A function of a module travels by its name, and a worker without that module breaks
    its connection and ends.
    """

    def answer() -> Any:
        try:
            from simval.sweep.identity import here
        except Exception as error:
            return f"{type(error).__name__}: {error}"
        return here()

    return answer


class Roster:
    """Workers of a cluster by their addresses."""

    def __init__(self, client: Any, stated: Stated, tell: Tell) -> None:
        self._client, self._stated, self._tell = client, stated, tell
        self._at = -ASKED
        self._answers: dict[str, Any] = {}  # futures, of those that are asked
        self.threads: dict[str, int] = {}  # of those that may compute
        self.refused: dict[str, tuple[str, ...]] = {}  # those there, and why not
        self._told: set[tuple[str, ...]] = set()

    @property
    def asked(self) -> bool:
        """Whether a worker has yet to say what it is."""
        return bool(self._answers)

    def look(self) -> None:
        """See who is there, if the last look is old enough.

        Raises
        ------
        OSError
            If the scheduler is lost.
        """
        now = time.monotonic()
        if now - self._at < ASKED and not self.asked:
            return
        self._at = now
        if self._client.status != "running":
            msg = "it does not answer"
            raise OSError(msg)
        there = dict(self._client.nthreads())
        for known in (self._answers, self.threads, self.refused):
            for gone in known.keys() - there.keys():
                known.pop(gone)
        for address, threads in there.items():
            if address in self.refused:
                continue
            if address in self.threads:
                self.threads[address] = threads
            else:
                self._ask(address, threads)

    def refuse(self, address: str, lines: tuple[str, ...]) -> None:
        """Give a worker nothing more."""
        self.threads.pop(address, None)
        self._answers.pop(address, None)  # a batch may have been answered first
        self.refused[address] = lines
        if lines not in self._told:  # not once more for each of a hundred
            self._told.add(lines)
            self._tell(f"worker {address} computes nothing: {'; '.join(lines)}")

    def _ask(self, address: str, threads: int) -> None:
        answer = self._answers.get(address)
        if answer is None:
            self._answers[address] = self._client.submit(
                question(), workers=[address], pure=False, priority=1
            )
        elif answer.done():
            del self._answers[address]
            try:
                lines = self._lines(answer)
            except TimeoutError:  # lost when it had answered: if it is back, ask again
                return
            if lines:
                self.refuse(address, lines)
            else:
                self.threads[address] = threads

    def _lines(self, answer: Any) -> tuple[str, ...]:
        if answer.status != "finished":
            failed = answer.status == "error"
            error = answer.exception(timeout=FETCH) if failed else answer.status
            there = message_of(error) if isinstance(error, BaseException) else error
        else:
            there = answer.result(timeout=FETCH)
        if not isinstance(there, Identity):
            return unable(str(there))
        return differing(self._stated.driver, there, mixed=self._stated.mixed)
