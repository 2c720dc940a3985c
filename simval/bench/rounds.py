"""Rounds of a race: each contender twice, so that a drift of the machine cancels.

A round is an order drawn at random and then the same order backwards (A B C C B A), and
a contender's time in it the mean of its two. A machine that becomes slower at an even
pace slows all contenders of a round alike, so their ratios do not see it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from simval.arrays import Array
from simval.bench.interval import median_interval
from simval.bench.race import (
    ROUNDS,
    Contender,
    Race,
    clock_of,
    require_agreement,
)
from simval.shapes import Float
from simval.streams import cell_key, stream

TICK = 1e-9  # s, least time: a clock that did not move divides nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class Rated:
    """How one contender did, as it is printed, written and read."""

    race: str
    contender: str
    item: str
    rate: float
    ratio: float
    low: float
    high: float
    confidence: float
    clock: str
    ours: bool
    other: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Result(Rated):
    """How one contender did.

    Attributes
    ----------
    race, contender, item : str
        Which, and what is counted.
    count : int
        Items of one run.
    rate : float
        Median items per second.
    ratio : float
        Median over the rounds of its rate by the reference's in the same round.
    low, high, confidence : float
        Interval of this median and how sure it is, eq. (B1).
    clock : str
        ``cpu``, ``children`` or ``wall``.
    ours : bool
        Whether the time is that of simval's own code.
    other : str
        How its work differs from that of the others, if it does.
    seconds : tuple of float
        Its time in each round, s.
    ratios : tuple of float
        Its rate by the reference's in each round.
    """

    count: int
    seconds: tuple[float, ...]
    ratios: tuple[float, ...]


def run_race(
    race: Race,
    rounds: int = ROUNDS,
    *,
    seed: int = 0,
    clock: Callable[[], float] | None = None,
) -> list[Result]:
    """Let the contenders of a race take turns.

    Parameters
    ----------
    race : Race
        Who runs.
    rounds : int, default 7
        How often each runs, twice in each; after a run that is not timed and whose
        answers are compared.
    seed : int, default 0
        Of the order.
    clock : callable, optional
        Gives the time, s; else that of the race.

    Returns
    -------
    list of Result
        In the order of the contenders.

    Raises
    ------
    RefusedError
        If the answers of two contenders differ.
    """
    contenders = race.contenders()
    found = [each.once() for each in contenders]  # pays for imports and memory too
    require_agreement(
        race.name,
        {c.name: done for c, done in zip(contenders, found, strict=True)},
        {c.name for c in contenders if c.other},
    )
    order = stream(seed, cell_key(f"bench {race.name}"), 0)
    seconds = np.array(
        [
            _round(contenders, order, clock if clock is not None else clock_of(race))
            for _ in range(rounds)
        ]
    )
    counts = [done.items for done in found]
    return [
        _result(race, contender, counts, seconds, k)
        for k, contender in enumerate(contenders)
    ]


def joined(first: Sequence[Result], more: Sequence[Result]) -> list[Result]:
    """The results of all rounds of both."""
    return [
        _summed(replace(a, seconds=a.seconds + b.seconds, ratios=a.ratios + b.ratios))
        for a, b in zip(first, more, strict=True)
    ]


def _round(
    contenders: Sequence[Contender],
    order: np.random.Generator,
    clock: Callable[[], float],
) -> Float[Array, " n"]:
    # times of one round, s
    times = np.zeros(len(contenders))
    turns = order.permutation(len(contenders))
    for k in (*turns, *turns[::-1]):
        start = clock()
        contenders[k].run()
        times[k] += 0.5 * max(clock() - start, TICK)
    return times


def _result(
    race: Race,
    contender: Contender,
    counts: Sequence[int],
    seconds: Float[Array, "rounds n"],
    k: int,
) -> Result:
    ratios = (counts[k] / counts[0]) * seconds[:, 0] / seconds[:, k]
    return _summed(
        Result(
            race=race.name, contender=contender.name, item=race.item, count=counts[k],
            rate=0.0, ratio=0.0, low=0.0, high=0.0, confidence=0.0, clock=race.clock,
            ours=contender.ours, other=contender.other,
            seconds=tuple(seconds[:, k].tolist()), ratios=tuple(ratios.tolist()),
        )
    )  # fmt: skip


def _summed(result: Result) -> Result:
    # the medians and the interval of all its rounds
    interval = median_interval(result.ratios)
    return replace(
        result,
        rate=result.count / median(result.seconds),
        ratio=median(result.ratios),
        low=interval.low,
        high=interval.high,
        confidence=interval.confidence,
    )
