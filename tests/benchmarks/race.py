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
from itertools import combinations
from statistics import median
from typing import Any, NamedTuple

import numpy as np

ROUNDS = 7
"""Odd, so that the median is a round; the least and the greatest of seven ratios hold
the true median between them in 98.4 % of races."""
FALL = 0.1
"""Of a ratio since the last release; what is more is printed."""
TICK = 1e-9  # s, least time: a clock that did not move divides nothing

Answers = Mapping[str, tuple[Any, Any]]
"""Numbers found, by name, and how far each may be from the right one.

Items are on the first axis: who does fewer is compared over these.
"""


class Contender(NamedTuple):
    """One way to do the work: `run` is timed, `seen(result of run)` is not.

    `other` says how its work differs from that of the others; empty says that it is
    the same, and then its answers must agree with theirs.
    """

    name: str
    items: int  # in one run
    run: Callable[[], Any]
    seen: Callable[[Any], Answers] = lambda found: {}
    other: str = ""


class Race(NamedTuple):
    """Contenders, compared with the first of them, which is not simval's own code."""

    title: str
    item: str
    contenders: Callable[[], list[Contender]]


class Result(NamedTuple):
    """Items a second, and in each round the rate by that of the first contender."""

    contender: Contender
    rate: float
    ratios: tuple[float, ...]


RACES: dict[str, Race] = {}


def race(name: str, title: str, item: str) -> Callable[[Any], Any]:
    """Enter a function that lists contenders as a race of this name."""

    def entered(contenders: Any) -> Any:
        RACES[name] = Race(title, item, contenders)
        return contenders

    return entered


def run_race(
    contenders: Sequence[Contender],
    rounds: int = ROUNDS,
    clock: Callable[[], float] = time.process_time,
) -> list[Result]:
    """Let the contenders take turns, after a run that is compared and not timed."""
    require_agreement([(each, each.seen(each.run())) for each in contenders])
    rng = np.random.default_rng(0)
    seconds = np.zeros((rounds, len(contenders)))
    for times in seconds:
        turns = rng.permutation(len(contenders))
        for k in (*turns, *turns[::-1]):
            start = clock()
            contenders[k].run()
            times[k] += 0.5 * max(clock() - start, TICK)
    items = np.array([each.items for each in contenders])
    ratios = (items / items[0]) * seconds[:, :1] / seconds
    return [
        Result(each, each.items / median(seconds[:, k]), tuple(ratios[:, k].tolist()))
        for k, each in enumerate(contenders)
    ]


def beside_release(ratios: Sequence[float], released: float | None) -> str:
    """Say the last release's ratio, and a fall of more than a tenth from it."""
    if released is None:
        return "not in the last release"
    words, fall = f"released {released:.4g}", 1.0 - median(ratios) / released
    if not fall > FALL:
        return words
    room = "" if max(ratios) < (1.0 - FALL) * released else ", not in every round"
    return f"{words}: fell by {fall:.0%}{room}"


def require_agreement(found: Sequence[tuple[Contender, Answers]]) -> None:
    """Fail where two answers differ by more than both may be wrong, or are alone.

    Who does other work, `other`, may have no answer in common with anybody.
    """
    shared = {each.name for each, _ in found if each.other}
    for (one, first), (two, second) in combinations(found, 2):
        for key in first.keys() & second.keys():
            shared |= {one.name, two.name}
            count = min(len(answers[key][0]) for answers in (first, second))
            (x, a), (y, b) = (
                (np.asarray(v)[:count], np.broadcast_to(within, np.shape(v))[:count])
                for v, within in (first[key], second[key])
            )
            off = np.abs(x - y)
            if not np.all(off <= a + b):  # true for NaN
                msg = f"{key}: {one.name} and {two.name} differ by up to "
                msg += f"{np.max(off):.1e}: find out which is wrong"
                raise AssertionError(msg)
    if alone := {each.name for each, _ in found} - shared:
        msg = f"nothing shows that {alone} do the same work as another"
        raise AssertionError(msg)
