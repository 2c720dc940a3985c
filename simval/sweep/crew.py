"""Who computes the cells of a sweep, what they must be, and what becomes of them."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Protocol, runtime_checkable

from simval.sweep.cluster import clustered
from simval.sweep.executors import Compute, pooled, serial
from simval.sweep.identity import Stated, here


@runtime_checkable
class Teller(Protocol):
    """A progress that is told too what becomes of the workers."""

    def tell(self, words: str) -> None:
        """Say it."""


@dataclass(frozen=True, slots=True, eq=False)
class Crew:
    """Who computes."""

    where: int | str  # local processes, or the address of a scheduler
    stated: Stated
    compute: Compute
    told: list[str]  # what became of the workers, in words; it grows


@contextmanager
def gathered(
    workers: int, scheduler: str | None, wait: float, mixed: bool, progress: object
) -> Iterator[Crew]:
    """Find who computes."""
    told: list[str] = []

    def tell(words: str) -> None:
        told.append(words)
        if isinstance(progress, Teller):
            progress.tell(words)

    stated = Stated(driver=here(), mixed=mixed)
    if scheduler is not None:
        with clustered(scheduler, stated, wait, tell) as compute:
            yield Crew(scheduler, stated, compute, told)
    else:
        compute = serial if workers == 1 else partial(pooled, workers=workers)
        yield Crew(workers, stated, compute, told)
