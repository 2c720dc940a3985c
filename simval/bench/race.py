"""A race: contenders do the same work in turns, over several rounds."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.errors import RefusedError
from simval.shapes import Float

ROUNDS: Final = 7
"""Odd, so that the median is a round; chosen for the time that a race takes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """Numbers that a contender found, for the comparison with the others.

    Attributes
    ----------
    values : numpy.ndarray
        The items are on the first axis, so that who does fewer is compared over these.
    within : float or numpy.ndarray
        How far each may be from the right one, in its unit.
    """

    values: Float[Array, "..."]
    within: float | Float[Array, "..."]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Done:
    """What a contender did in one run.

    Attributes
    ----------
    items : int
        How much that was, in the race's item.
    answers : mapping
        What it found, by a name for people.
    """

    items: int
    answers: Mapping[str, Answer] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contender:
    """One way to do the work.

    Attributes
    ----------
    name : str
        What it is.
    run : callable
        Does the work once; this is what is timed.
    seen : callable
        ``seen(result of run) -> Done``, outside of the time.
    ours : bool, default True
        Whether the time is that of simval's own code.
    other : str, default ""
        How its work differs from that of the others. Empty says that it is the same,
        and then its answers must agree with theirs.
    """

    name: str
    run: Callable[[], Any]
    seen: Callable[[Any], Done]
    ours: bool = True
    other: str = ""

    def once(self) -> Done:
        """Do the work once, and see what it was."""
        return self.seen(self.run())


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
        ``contenders() -> list of Contender``; the first is the reference, which is not
        simval's own code. A peer that is not installed is left out.
    clock : str, default "cpu"
        ``cpu`` for processor time, ``children`` for that of the processes that a
        contender starts, ``wall`` where threads are what is measured.
    """

    name: str
    title: str
    item: str
    contenders: Callable[[], list[Contender]]
    clock: str = "cpu"


def require_agreement(race: str, found: Mapping[str, Done], other: set[str]) -> None:
    """Refuse contenders whose answers differ by more than both may be wrong.

    Parameters
    ----------
    race : str
        Its name.
    found : mapping
        What each contender found.
    other : set of str
        Names of those that do other work: they may have no answer in common.

    Raises
    ------
    RefusedError
        If two answers differ, one is not finite, or there is none to compare with.
    """
    names = list(found)
    for k, name in enumerate(names):
        for before in names[:k]:
            both = found[name].answers.keys() & found[before].answers.keys()
            for key in sorted(both):
                pair = found[before].answers[key], found[name].answers[key]
                _require_equal(f"race `{race}`, {key}", (before, name), pair)
    for name in names:
        others = [d.answers.keys() for n, d in found.items() if n != name]
        shared = any(found[name].answers.keys() & keys for keys in others)
        if name not in other and not shared:
            msg = (
                f"race `{race}`: {name} has no answer in common with another "
                "contender, so nothing shows that it does the same work; it was not "
                "timed: state how its work differs"
            )
            raise RefusedError(msg)


def _require_equal(
    where: str, names: tuple[str, str], pair: tuple[Answer, Answer]
) -> None:
    shortest = min(np.shape(a.values)[0] for a in pair)
    x, y = (np.asarray(a.values)[:shortest] for a in pair)
    allowed = sum(_cut(a.within, a.values, shortest) for a in pair)
    off, wide = np.abs(x - y), np.broadcast_to(allowed, np.shape(x))
    if np.all(off <= wide):  # false for NaN
        return
    worst = np.unravel_index(np.argmax(np.where(off <= wide, -1.0, 1.0)), off.shape)
    msg = (
        f"{where}: {names[0]} and {names[1]} differ by {off[worst]:.1e}; "
        f"{wide[worst]:.1e} is allowed; neither was timed: find out which one is wrong"
    )
    raise RefusedError(msg)


def _cut(
    within: float | Float[Array, "..."], values: Float[Array, "..."], count: int
) -> Float[Array, "..."]:
    return np.broadcast_to(np.asarray(within), np.shape(values))[:count]


def clock_of(race: Race) -> Callable[[], float]:
    """Clock that a race is timed by, s."""
    clocks = {
        "cpu": time.process_time,
        "wall": time.perf_counter,
        "children": _time_of_children,
    }
    return clocks[race.clock]


def _time_of_children() -> float:
    import resource  # not on every system

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
