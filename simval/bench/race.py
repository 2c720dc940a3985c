"""A race: contenders do the same work in turns, over several rounds."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

ROUNDS = 7
"""Odd, so that the median is a round; chosen for the time that a race takes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contender:
    """One way to do the work.

    Attributes
    ----------
    name : str
        What it is.
    run : callable
        Does the work once and returns how many items that was.
    """

    name: str
    run: Callable[[], int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Race:
    """Contenders that are compared with the first of them.

    Attributes
    ----------
    name : str
        One word, for the command line.
    title : str
        One line for people.
    item : str
        What is counted.
    contenders : callable
        ``contenders() -> list of Contender``; the first is the reference. A peer that
        is not installed is left out.
    clock : str, default "cpu"
        ``cpu`` for processor time, ``wall`` where threads are what is measured.
    """

    name: str
    title: str
    item: str
    contenders: Callable[[], list[Contender]]
    clock: str = "cpu"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """How one contender did.

    Attributes
    ----------
    race, contender, item : str
        Which, and what is counted.
    count : int
        Items of its last run.
    rate : float
        Median items per second.
    ratio : float
        Median over the rounds of its rate by the reference's in the same round.
    low, high : float
        Least and greatest of these ratios.
    clock : str
        ``cpu`` or ``wall``.
    """

    race: str
    contender: str
    item: str
    count: int
    rate: float
    ratio: float
    low: float
    high: float
    clock: str


def run_race(race: Race, rounds: int = ROUNDS) -> list[Result]:
    """Let the contenders of a race take turns.

    Parameters
    ----------
    race : Race
        Who runs.
    rounds : int, default 7
        How often each runs, after one round that is not counted.

    Returns
    -------
    list of Result
        In the order of the contenders.
    """
    clock = time.process_time if race.clock == "cpu" else time.perf_counter
    contenders = race.contenders()
    rates = np.zeros((rounds + 1, len(contenders)))
    counts = [0] * len(contenders)
    for turn in range(rounds + 1):
        for k, contender in enumerate(contenders):
            start = clock()
            counts[k] = contender.run()
            rates[turn, k] = counts[k] / max(clock() - start, 1e-9)
    rates = rates[1:]  # the first round pays for imports and memory
    ratios = rates / rates[:, :1]
    return [
        Result(
            race=race.name,
            contender=contender.name,
            item=race.item,
            count=counts[k],
            rate=float(np.median(rates[:, k])),
            ratio=float(np.median(ratios[:, k])),
            low=float(ratios[:, k].min()),
            high=float(ratios[:, k].max()),
            clock=race.clock,
        )
        for k, contender in enumerate(contenders)
    ]
