"""How often the p-values of sound rows are small, in the studies that draw samples.

Each run is one cell on a fresh seed, at a setting of its own that is drawn from that
seed (`power.random_settings`). At most the stated share of the
p-values may be below a level. The rows of a run depend on each other, so how far the
count may be off is found from the spread between the runs.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from power.random_settings import SETTINGS
from simval.streams import Streams, cell_key
from simval.verdict import WEIGHTS, p_values

LEVELS = (1e-2, 1e-3, 1e-4)
"""Shares of the p-values that are counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tail:
    """How many p-values of the checks of a study are below a level."""

    study: str
    check: str
    level: float
    rows: int
    seen: int  # below the level
    runs: int
    error: float  # standard error of `seen`

    @property
    def expected(self) -> float:
        """How many of them would be, if all p-values were uniform."""
        return self.level * self.rows

    @property
    def too_many(self) -> bool:
        """Whether more are below than chance explains in 999 of 1000 looks."""
        return self.seen - self.expected > 3.1 * self.error


def tails(study: str, runs: int, seed: int) -> Iterator[Tail]:
    """Judge the rows of fresh runs of a study one by one, without Holm's limits."""
    run, setting = SETTINGS[study]
    found: dict[str, list[list[float]]] = {}
    for number in range(seed, seed + runs):
        parameters = setting(np.random.default_rng([number, 1]))
        outcome = run(parameters, Streams(number, cell_key(study)))
        for check in WEIGHTS:
            own = [row for row in outcome.rows if row.check == check]
            if own:
                found.setdefault(check, []).append(p_values(own).tolist())
    for check, lists in found.items():
        for level in LEVELS:
            yield _tail(study, check, level, lists)


def _tail(study: str, check: str, level: float, lists: list[list[float]]) -> Tail:
    counts = np.array([sum(p < level for p in values) for values in lists])
    rows = sum(map(len, lists))
    # beside the spread between runs that of as many independent rows is allowed: few
    # runs with none below the level have no spread
    spread = np.sqrt(len(counts)) * np.std(counts, ddof=1) if len(counts) > 1 else 0.0
    return Tail(
        study=study,
        check=check,
        level=level,
        rows=rows,
        seen=int(counts.sum()),
        runs=len(lists),
        error=float(max(spread, np.sqrt(level * rows), 1.0)),
    )
