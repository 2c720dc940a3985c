"""The rests of a log, by times in seconds, so that any rate will do.

The accelerometer finds them, and one that holds several levels is cut at its steps or
left out (`simval.imu.statics.levels`); where the log has a gyroscope, what turns is cut
off them or leaves them out (`simval.imu.statics.rotating_rests`). A magnetometer is not
asked: a field that changes while the sensor lies still would cost the others a rest.

The detector's threshold is a multiple of the variance of the initial rest. Each
multiple gives its own intervals. Of the multiples that agree on the number of
intervals, the middle one is taken, so that the choice never sees the residuals: the
multiple whose fit leaves the least of them, as IMU-TK takes it, is the luckiest one,
and its error bars are too small (`docs/decisions/0055-threshold-without-residuals.md`).
"""

from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np

from simval.errors import InputError, RefusedError
from simval.imu.logs import Log
from simval.imu.statics import (
    SLOWEST_NOISE,
    WHITE,
    WINDOWS,
    Cut,
    Intervals,
    Rest,
    Step,
    evened,
    single_levels,
    still_parts,
)
from simval.imu.statics.detector import EvenLog
from simval.poses import PARAMETERS
from simval.spelling import counted

AXES = "xyz"
MULTIPLIERS = tuple(map(float, range(2, 11)))  # those that IMU-TK tries
# A window finds a rest that lasts a shortest interval longer than itself. Where half of
# those it finds last less than twice that, it may miss many, and the shorter one is
# taken if it finds so many times as many.
TWICE = 2.0
MISSED = 1.1


class Level(NamedTuple):
    """The rests of a log, found with one threshold."""

    multiplier: float  # of the variance of the initial rest
    intervals: Intervals
    steps: tuple[str, ...]  # rests that hold several levels, in words
    cuts: tuple[str, ...]  # rests in which the gyroscope turns, in words
    enough: bool  # are still; else these are the rests of the accelerometer alone


class Detection(NamedTuple):
    """The rests of a log, and the thresholds that find as many."""

    block: int  # rows that the detector takes together
    initial: Rest
    best: Level
    others: Iterator[Level]  # as many rests by other thresholds, most alike first

    @property
    def plateau(self) -> Iterator[Level]:
        """The best threshold's rests, then those of the others."""
        return chain([self.best], self.others)


def find_rests(log: Log, rest: float | None, least: int = PARAMETERS) -> Detection:
    """Find the rests of a log with the longest window that finds enough of them.

    Raises
    ------
    InputError
        If the rest is stated to be longer than the log.
    RefusedError
        If there is no rest, or no threshold finds enough.

    Notes
    -----
    A short window is trusted only where the rest is white noise: in half a second a
    slow motion looks still, too. It is asked where the long one finds too few, and
    where those that it finds are so short that it may have missed as many.
    """
    count = None if rest is None else log.rows_within(rest)
    if rest is not None and log.time[0] + rest > log.time[-1] + 1.0 / log.rate:
        msg = (
            f"the initial rest is stated as {rest:g} s, and {log.path} lasts "
            f"{log.time[-1] - log.time[0]:.2f} s; state how long its first rest lasts"
        )
        raise InputError(msg)
    found: Detection | None = None
    refusal: RefusedError | None = None
    for window in WINDOWS:
        short = window < WINDOWS[0]
        even = evened(log.time, log.accelerometer, window)
        try:
            detection = _detection(log, even, window, count, least, white=short)
        except RefusedError as error:
            refusal = refusal or error
            continue
        rests = detection.best.intervals
        if found is None or len(rests) > MISSED * len(found.best.intervals):
            found = detection
        if np.median(np.ptp(even.tick[rests], axis=1)) > TWICE * even.minimum:
            break
    if found is None:
        assert refusal is not None  # there is a window
        raise refusal
    return found


def _detection(
    log: Log,
    even: EvenLog,
    window: float,
    count: int | None,
    least: int,
    *,
    white: bool,
) -> Detection:
    spread = even.spread()
    initial = even.initial_rest(count, spread)
    if initial.found or white:
        limit = WHITE if white else 1.0 + SLOWEST_NOISE * even.rate
        wander = even.wander(initial, spread)
        if not wander <= limit:
            msg = (
                f"no initial rest found: the quietest part of the log, from "
                f"{log.span((initial.start, initial.stop))}, still moves: its variance "
                f"is {wander:.3g} times what it is from row to row, and a sensor at "
                f"rest shows at most {limit:.3g}; record with rests, or state the "
                "initial one (--rest SECONDS)"
            )
            raise RefusedError(msg)
    every = [(m, even.intervals(spread, m * initial.variance)) for m in MULTIPLIERS]
    usable = [(m, intervals) for m, intervals in every if len(intervals) >= least]
    judged = ((m, *single_levels(even, own)) for m, own in _plateau(usable))
    levels = (_level(log, window, least, *at) for at in judged if len(at[1]) >= least)
    best = next(levels, None)
    if best is None:
        most = max(len(intervals) for _, intervals in every)
        msg = (
            f"at most {counted(most, 'static interval')} found, and a calibration "
            f"needs {PARAMETERS} or more, each from a rest of two seconds or longer; "
            "hold the sensor still in more poses, or state the initial rest (--rest "
            "SECONDS) if it was found wrongly"
        )
        raise RefusedError(msg)
    return Detection(even.block, initial, best, levels)


def _level(
    log: Log,
    window: float,
    least: int,
    multiplier: float,
    intervals: Intervals,
    steps: list[Step],
) -> Level:
    said = tuple(_step_words(log, step) for step in steps)
    if log.gyro is None:
        return Level(multiplier, intervals, said, (), enough=True)
    kept, cuts = still_parts(evened(log.time, log.gyro, window), intervals)
    enough = len(kept) >= least
    words = tuple(_cut_words(log, cut, used=enough) for cut in cuts)
    return Level(multiplier, kept if enough else intervals, said, words, enough=enough)


def _step_words(log: Log, step: Step) -> str:
    kept = " and ".join(map(log.span, step.levels))
    verb = "are" if len(step.levels) > 1 else "is"
    return (
        f"rest from {log.span(step.rest)} {'cut' if kept else 'left out'}: its "
        f"readings shift as by a tilt of {np.degrees(step.angle):.2g} degrees; "
        f"{f'{kept} {verb} kept' if kept else 'no level in it lasts long enough'}"
    )


def _cut_words(log: Log, cut: Cut, *, used: bool) -> str:
    still, done = "too little of it is still", "left out" if used else "kept whole"
    if cut.kept is not None:
        still = f"{log.span(cut.kept)} is still"
        done = "cut" if used else done
    return (
        f"rest from {log.span(cut.rest)} {done}: the gyroscope turns in it, up "
        f"to {cut.rate:.3g} raw units off its bias where chance leaves "
        f"{cut.chance:.2g}; {still}{'' if used else ', but too few rests would be'}"
    )


def _plateau(usable: list[tuple[float, Intervals]]) -> list[tuple[float, Intervals]]:
    # a rest that a single threshold sees is a rest cut in two, or a slow motion
    counts = [len(intervals) for _, intervals in usable]
    agreed = max(counts, key=lambda count: (counts.count(count), count), default=0)
    level = [entry for entry in usable if len(entry[1]) == agreed]
    middle = (len(level) - 1) / 2
    order = sorted(range(len(level)), key=lambda k: abs(k - middle))
    return [level[k] for k in order]
