"""How often sound rows look unsound, in the studies that draw samples.

Each run is one cell on a fresh seed, at a setting of its own that is drawn from that
seed (`power.random_settings`). At most the stated share of the p-values may be below a
level, row by row; and the gate, which judges all rows of a run together, may fail at
most the stated share of the runs. The rows of a run depend on each other, so how far
the first count may be off is found from the spread between the runs.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from power.random_settings import compute, setting
from simval.errors import PluginError, UnmeasurableError
from simval.results import CellName, Row
from simval.streams import Streams, cell_key
from simval.verdict import WEIGHTS, judge, overall, p_values

LEVELS = (1e-2, 1e-3, 1e-4)
"""Shares of the p-values that are counted."""

ALPHAS = (0.05, 0.01, 0.001)
"""Rates at which runs are judged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """How often something happened, with a 95 % interval."""

    name: str  # what was counted
    # the stated rate: at most this for false alarms, at least this for power
    nominal: float
    # how often, out of how many
    count: int
    runs: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of 95 %."""
        rate = scipy.stats.binomtest(self.count, self.runs)
        low, high = rate.proportion_ci(0.95, "wilson")
        return float(low), float(high)


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


def drawn_cells(study: str, seeds: range) -> Iterator[list[tuple[CellName, Row]]]:
    """Rows of a cell of a study for each seed; none of one that is refused in words."""
    for seed in seeds:
        parameters = setting(study, np.random.default_rng([seed, 1]))
        name = CellName(study, f"{parameters!r}@{seed}")
        try:
            outcome = compute(study, parameters, Streams(seed, cell_key(study)))
        except (UnmeasurableError, PluginError):
            continue
        yield [(name, row) for row in outcome.rows]


def tails(study: str, runs: int, seed: int) -> tuple[list[Tail], list[Rate]]:
    """Rows of fresh runs one by one, without Holm's limits, and each run as a whole."""
    found: dict[str, list[list[float]]] = {}
    alarms, measured = dict.fromkeys(ALPHAS, 0), 0
    for members in drawn_cells(study, range(seed, seed + runs)):
        measured += 1
        for alpha in ALPHAS:
            alarms[alpha] += overall(judge(members, alpha)) == "fail"
        for check in WEIGHTS:
            own = [row for _, row in members if row.check == check]
            if own:
                found.setdefault(check, []).append(p_values(own).tolist())
    rates = [
        Rate(name=study, nominal=alpha, count=count, runs=measured)
        for alpha, count in alarms.items()
        if measured
    ]
    each = found.items()
    return [_tail(study, *pair, level) for pair in each for level in LEVELS], rates


def together(rates: list[Rate]) -> list[Rate]:
    """Rates of all studies together."""
    return [
        Rate(
            name="all studies",
            nominal=alpha,
            count=sum(r.count for r in rates if r.nominal == alpha),
            runs=sum(r.runs for r in rates if r.nominal == alpha),
        )
        for alpha in dict.fromkeys(r.nominal for r in rates)
    ]


def _tail(study: str, check: str, lists: list[list[float]], level: float) -> Tail:
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
