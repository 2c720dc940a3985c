"""A filter that is run again: the same answers, and in the same time.

State that outlives a run, instances that share it, and trials of a batch that depend on
each other are told by answers that differ. A step that takes the longer the longer a
filter runs is told by the same readings once more without a fresh filter, so that what
the motion costs is the same: three times, and each time by a factor. It is processor
time, which a busy machine leaves alone; that of a program beside us is not seen.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import PluginError
from simval.geometry import attitude_error
from simval.plugins.filter_protocol import Filter
from simval.plugins.filter_steps import (
    Readings,
    Run,
    making,
    place,
    run_of,
    stepped,
)
from simval.plugins.filter_worlds import own_quaternions
from simval.shapes import Float

BY_TURNS: Final = 100
"""Rows of two filters that are stepped by turns, and of one trial of a batch alone."""

AGAIN: Final = 1000
"""Rows of a batch that is run again."""

ALONE: Final = 1e-9
"""Attitude error of a trial alone, rad, whose sums may be rounded in another order."""

SUSPICIOUS: Final = 2.5
SLOWER: Final = 1.5
"""Time of the last rows over that of the first, from which a filter is run for longer,
and of a second time through the same readings over the first. A step whose cost grows
evenly with the rows so far reaches the second before the first."""

REPEATS: Final = 3

LEAST: Final = 1e-9
"""Processor time that a stretch takes at the least, s."""


def require_the_same_again(
    filter: Filter, readings: Readings, rows: NDArray[np.intp], before: Run
) -> None:
    """Require that a fresh filter answers the same readings with the same bits.

    Of a batch, which is all trials, it is asked for the beginning alone.

    Raises
    ------
    PluginError
        If it does not.
    """
    if readings.lead:
        readings = _beginning(readings, max(AGAIN, int(rows[0]) + 1))
        rows = rows[rows < len(readings.dt)]
        words = {word: values[: len(rows)] for word, values in before.words.items()}
        before = replace(before, words=words)
    again = run_of(filter, readings, rows)
    if difference := _difference(filter, before, again):
        row, said = difference
        msg = (
            f"{filter.name} answers the same readings differently when they are run "
            f"again: {said}, {place(readings, int(rows[row]))}; it keeps state "
            "between runs, or draws random numbers: `make` must return a fresh filter, "
            "with nothing kept in the module or the class, and a generator seeded anew"
        )
        raise PluginError(msg)


def require_a_life_of_its_own(filter: Filter, one: Readings, other: Readings) -> None:
    """Require that two filters, stepped by turns, answer as each does alone.

    Raises
    ------
    PluginError
        If they do not.
    """
    one, other = _beginning(one), _beginning(other)
    rows = np.arange(len(one.dt))
    alone = run_of(filter, one, rows)
    sensors = [list(np.array(a)) for a in other.sensors]
    beside = iter(list(zip(other.dt.tolist(), *sensors, strict=True)))
    with making(filter, one) as first, making(filter, other) as second:

        def by_turns(*values: Any) -> Any:
            answer = first(*values)
            second(*next(beside))
            return answer

        together = stepped(filter, by_turns, one, rows)
    if difference := _difference(filter, alone, together):
        row, words = difference
        msg = (
            f"two of {filter.name} that are stepped by turns change each other: "
            f"{words}, {place(one, row)}; keep what a filter knows in the object that "
            "`make` returns, not in the module or the class"
        )
        raise PluginError(msg)


def require_trials_alone(filter: Filter, batch: Readings, alone: Readings) -> None:
    """Require that the first trial of a batch is what it is alone.

    Raises
    ------
    PluginError
        If it is not.
    """
    batch, alone = _beginning(batch), _beginning(alone)
    rows = np.arange(len(batch.dt))
    runs = [run_of(filter, own, rows) for own in (batch, alone)]
    q = [own_quaternions(filter, run.words["attitude"][:, 0]) for run in runs]
    off = np.atleast_1d(attitude_error(*q))
    if not off.max() <= ALONE:
        row = int(off.argmax())
        msg = (
            f"{filter.name}: the first of {batch.lead[0]} trials is not what it is "
            f"alone, by {off[row]:.3g} rad {place(batch, row)}; the trials of a batch "
            "must not depend on each other"
        )
        raise PluginError(msg)


def require_an_even_pace(
    filter: Filter, readings: Readings, runs: Sequence[Run]
) -> None:
    """Require that a row takes no longer the more rows there were before.

    Raises
    ------
    PluginError
        If it does.
    """
    first, last = _ends(runs)
    if not last > SUSPICIOUS * first:
        return
    ratios = [_second_time(filter, readings) for _ in range(REPEATS)]
    if min(ratios) > SLOWER:
        msg = (
            f"{filter.name} takes longer and longer: a row takes {first * 1e6:.3g} us "
            f"at the beginning of a run and {last * 1e6:.3g} us at its end, and "
            f"{min(ratios):.2g} times as long when the same readings come once more; "
            "keep no history that grows"
        )
        raise PluginError(msg)


def _ends(runs: Sequence[Run]) -> tuple[float, float]:
    """Time of a row at the beginning of a run, and at its end: the least of a few."""
    paces = np.array([run.processor / run.rows for run in runs])
    count = max(paces.shape[1] // 8, 1)
    return float(paces[:, :count].min()), float(paces[:, -count:].min())


def _second_time(filter: Filter, readings: Readings) -> float:
    """Median over its stretches of the second time of all rows over the first."""
    if readings.lead:
        readings = _some(readings, 8)
    none = np.arange(1)
    try:
        with making(filter, readings) as update:
            paces = [stepped(filter, update, readings, none) for _ in range(2)]
    except PluginError:  # of readings that begin anew it makes nothing
        return 0.0
    return float(np.median(paces[1].processor / np.maximum(paces[0].processor, LEAST)))


def _some(readings: Readings, trials: int) -> Readings:
    """The first trials of a batch."""
    n = min(trials, readings.lead[0])
    reads = {
        word: value[:n] if word == "start" else value
        for word, value in readings.reads.items()
    }
    sensors = tuple(a[:, :n] for a in readings.sensors)
    return replace(readings, lead=(n,), sensors=sensors, reads=reads)


def _beginning(readings: Readings, count: int = BY_TURNS) -> Readings:
    rows = slice(0, count)
    return replace(
        readings,
        dt=readings.dt[rows],
        end=readings.end[rows],
        sensors=tuple(a[rows] for a in readings.sensors),
    )


def _difference(filter: Filter, before: Run, now: Run) -> tuple[int, str] | None:
    """First kept row at which two runs differ by a bit, and by what, in words."""
    if before.words.keys() != now.words.keys():
        return 0, f"{', '.join(now.words)} instead of {', '.join(before.words)}"
    found = []
    for word, values in before.words.items():
        other = now.words[word]
        if other.shape != values.shape:
            return 0, f"`{word}` of another shape"
        same = np.equal(values, other).reshape(len(values), -1).all(axis=1)
        if not same.all():
            row = int(np.argmin(same))
            found.append((row, f"`{word}` {_apart(filter, word, values, other)}"))
    return min(found, default=None)


def _apart(
    filter: Filter,
    word: str,
    values: Float[Array, "k ..."],
    other: Float[Array, "k ..."],
) -> str:
    """By how much the kept rows of two runs differ, at most."""
    if word != "attitude":
        return f"by up to {float(np.abs(values - other).max()):.2g}"
    axes = 2 if filter.components == "matrix" else 1
    flat = [a.reshape(-1, *a.shape[a.ndim - axes :]) for a in (values, other)]
    q = [own_quaternions(filter, a) for a in flat]
    return f"by up to {float(attitude_error(*q).max()):.2g} rad"
