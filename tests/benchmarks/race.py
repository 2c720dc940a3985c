"""A race: contenders do the same work in turns, and the ratios within a round count.

Machines are shared and noisy, so nothing is compared that was not run side by side. A
round is an order drawn at random and then the same order backwards (A B C C B A), and a
contender's time in it the mean of its two: a machine that becomes slower at an even
pace slows all contenders of a round alike. Neither pytest-benchmark nor asv does that:
both time one function after the other, and give no ratio of a round.

Before anything is timed, the answers are compared.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np

ROUNDS = 7
"""Odd, so that the median is a round; the least and the greatest of seven ratios hold
the true median between them in 98.4 % of races."""
TICK = 1e-9  # s, least time: a clock that did not move divides nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """Numbers that a contender found, and how far each may be from the right one.

    The items are on the first axis: who does fewer is compared over these.
    """

    values: Any
    within: Any


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Done:
    """What a contender did in one run: how many items, and its answers by name."""

    items: int
    answers: Mapping[str, Answer] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contender:
    """One way to do the work: `run` is timed, `seen(result of run)` is not.

    `other` says how its work differs from that of the others; empty says that it is
    the same, and then its answers must agree with theirs.
    """

    name: str
    run: Callable[[], Any]
    seen: Callable[[Any], Done]
    other: str = ""

    def once(self) -> Done:
        """Do the work once, and see what it was."""
        return self.seen(self.run())


@dataclass(frozen=True, slots=True, kw_only=True)
class Race:
    """Contenders, compared with the first of them, which is not simval's own code."""

    name: str
    title: str
    item: str
    contenders: Callable[[], list[Contender]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Items a second, and in each round the rate by that of the first contender."""

    contender: Contender
    rate: float
    ratios: tuple[float, ...]


def run_race(
    race: Race, rounds: int = ROUNDS, clock: Callable[[], float] = time.process_time
) -> list[Result]:
    """Let the contenders take turns, after a run that is compared and not timed."""
    contenders = race.contenders()
    found = {each.name: each.once() for each in contenders}
    require_agreement(race.name, found, {c.name for c in contenders if c.other})
    rng = np.random.default_rng(0)
    seconds = np.array([_round(contenders, rng, clock) for _ in range(rounds)])
    counts = np.array([found[each.name].items for each in contenders])
    ratios = (counts / counts[0]) * seconds[:, :1] / seconds
    return [
        Result(
            contender=each,
            rate=counts[k] / median(seconds[:, k]),
            ratios=tuple(ratios[:, k].tolist()),
        )
        for k, each in enumerate(contenders)
    ]


def _round(
    contenders: Sequence[Contender],
    rng: np.random.Generator,
    clock: Callable[[], float],
) -> list[float]:
    # times of one round, s
    times, turns = [0.0] * len(contenders), rng.permutation(len(contenders))
    for k in (*turns, *turns[::-1]):
        start = clock()
        contenders[k].run()
        times[k] += 0.5 * max(clock() - start, TICK)
    return times


def require_agreement(race: str, found: Mapping[str, Done], other: set[str]) -> None:
    """Fail where two answers differ by more than both may be wrong, or are alone.

    Who does other work, `other`, may have no answer in common with anybody.
    """
    names = list(found)
    for k, name in enumerate(names):
        for before in names[:k]:
            for key in found[name].answers.keys() & found[before].answers.keys():
                pair = found[before].answers[key], found[name].answers[key]
                _require_equal(f"{race}, {key}: {before} and {name}", pair)
    for name in names:
        others = [d.answers.keys() for n, d in found.items() if n != name]
        shared = any(found[name].answers.keys() & keys for keys in others)
        if name not in other and not shared:
            msg = f"{race}: nothing shows that {name} does the same work as another"
            raise AssertionError(msg)


def _require_equal(where: str, pair: tuple[Answer, Answer]) -> None:
    count = min(np.shape(a.values)[0] for a in pair)
    x, y = (np.asarray(a.values)[:count] for a in pair)
    allowed = sum(np.broadcast_to(a.within, np.shape(a.values))[:count] for a in pair)
    off = np.abs(x - y)
    if not np.all(off <= allowed):  # true for NaN
        msg = f"{where} differ by up to {np.max(off):.1e}: find out which is wrong"
        raise AssertionError(msg)
