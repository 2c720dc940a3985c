"""The rests of a log as the checks see them, with the judgement of them.

What is wrong with their means is asked once (`simval.imu.explain`), with the noise that
the rows of each rest show. A counter that wraps around is seen row by row, where the
sensor moves: the readings without the laps go in as one more explanation.
"""

from collections.abc import Sequence
from numbers import Integral
from typing import NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.calibrate import FitResult
from simval.imu.calibrate.thermal import DRIFTS
from simval.imu.explain import Judgement, RestMeans, judge
from simval.imu.explain.catalogue import wrapped
from simval.imu.explain.explanation import LEAST_FREEDOM
from simval.imu.logs import Log
from simval.imu.multiposition.noise import PoseNoise, rounding_left, steps_of
from simval.imu.multiposition.rests import find_rests
from simval.imu.statics import Intervals, interval_counts, interval_means
from simval.poses import PARAMETERS
from simval.shapes import Float

_JUMP = 0.5  # of an axis's span, from row to row: the counter has wrapped around
_FEWEST = 1.1  # times the span: a power of two as close is the counter's range
_WIDER = 1.05  # times the span seen, the range of another


DRIFT = "--drift"
"""Option by which a drift is taken into the fit."""


class JudgedRests(NamedTuple):
    """The rests of a log, with the fit to them if there is one."""

    log: Log
    rest: float | None  # length of the initial rest as it was given, s
    intervals: Intervals  # samples start <= k < stop of each rest
    means: Float[Array, "m 3"]  # mean reading of each, raw units
    noise: Float[Array, "3"]  # median over the rests of the standard deviation in each
    # median share of readings equal to the one before, each axis; small where the
    # noise is a step of the converter or more
    same: Float[Array, "3"]
    # share of rows equal to the one before that nine rests of ten stay below
    same_rows: float
    fit: FitResult | None
    dof: int  # degrees of freedom of a fit to the rests
    numbers: Intervals  # of each rest, with those that were left out
    misfit: float  # root mean square of residuals over gravity; infinite without a fit
    judgement: Judgement

    def detect(self, part: Log, least: int) -> Intervals:
        """Find at least so many rests in a part of the log."""
        known = self.rest if part.time[0] == self.log.time[0] else None
        return find_rests(part, known, least).best.intervals

    def rows(self, start: int, stop: int) -> str:
        """Say at what times some rows were taken."""
        return f"from {self.log.span((start, stop))}"

    def span(self, rest: int) -> str:
        """Say at what times a rest was."""
        return self.rows(*self.intervals[rest])

    @property
    def whole(self) -> str:
        """Say when the first rest began and the last one ended."""
        return self.rows(self.intervals[0, 0], self.intervals[-1, 1])

    @property
    def wrong(self) -> str:
        """Say what is wrong with the rests and what to do; empty if nothing is."""
        cause = self.judgement.cause(self.middle)
        return f"{cause}: {self.do}" if self.do else cause

    @property
    def do(self) -> str:
        """Say what to do, with the option that does it."""
        words, option = self.judgement.advice, self.option
        if option == DRIFT:
            return f"take the drift into the fit ({option}), or {words}"
        return f"{words} ({option})" if option else words

    @property
    def option(self) -> str:
        """The command's option that follows the advice; empty if there is none."""
        named, time = self.judgement.candidates, self.log.time
        if self.judgement.off:
            out = ",".join(str(self.numbers[k]) for k in self.judgement.off)
            return f"--leave-out {out}"
        drifts = all(f.explanation.kinds <= DRIFTS for f in named)
        if self.judgement.names and drifts and self.log.temperature is None:
            return DRIFT
        rests = named[0].explanation.rests if len(named) == 1 else ()
        count, first = len(self.intervals), min(rests, default=0)
        if not self.judgement.names or rests != tuple(range(first, count)) or not first:
            return ""
        # between the rests, and what is longer is kept
        at = (self.intervals[first - 1, 1] + self.intervals[first, 0]) // 2
        return f"{'--from' if 2 * first < count else '--until'} {time[at]:.1f}"

    @property
    def middle(self) -> Float[Array, " m"]:
        """Time of the middle of each rest, s."""
        return self.log.time[self.intervals.sum(axis=1) // 2]


def kept(log: Log, rests: Intervals, out: Sequence[float]) -> Intervals:
    """Numbers of the rests that remain; others are named by number or by a time, s.

    An integer is the number of a rest, and any other number a time.

    Raises
    ------
    InputError
        If there is no rest of a number, or none at a time.
    """
    first, last = log.time[rests[:, 0]], log.time[rests[:, 1] - 1]
    every = np.arange(len(rests))
    left = np.zeros(len(rests), dtype=bool)
    for each in out:
        is_number = isinstance(each, Integral)
        inside = every == each if is_number else (first <= each) & (each <= last)
        if not inside.any() and is_number:
            msg = (
                f"there is no rest {each} to leave out; rests are numbered from 0 "
                f"to {len(rests) - 1}, and a time in seconds is written with a point"
            )
            raise InputError(msg)
        if not inside.any():
            k = np.argmin(np.maximum(first - each, each - last))
            msg = (
                f"there is no rest at {each:g} s to leave out; the nearest, rest "
                f"{k}, is from {first[k]:.2f} s to {last[k]:.2f} s; give its number "
                "or a time within it"
            )
            raise InputError(msg)
        left |= inside
    return every[~left]


def case_of(
    log: Log,
    rest: float | None,
    intervals: Intervals,
    noise: PoseNoise | None = None,
    fit: FitResult | None = None,
    numbers: Intervals | None = None,
) -> JudgedRests:
    """Gather what the checks need; without `noise` no rests are judged."""
    samples = log.accelerometer
    parts = [samples[start:stop] for start, stop in intervals]
    spread = np.array([part.std(axis=0) for part in parts]).reshape(-1, 3)
    equal = [np.diff(part, axis=0) == 0.0 for part in parts]
    same = np.array([part.mean(axis=0) for part in equal]).reshape(-1, 3)
    rows = np.array([part.all(axis=1).mean() for part in equal])
    judgement = Judgement(1.0, 0.0)
    if noise is not None:
        means = rest_means(log, intervals, noise)
        turns, lap = laps_of(log)
        own = np.array([turns[a:b].mean(axis=0) for a, b in intervals])
        own = np.median(own, axis=0) - own
        judgement = judge(means, [wrapped(means, own, lap)] if own.any() else [])
    return JudgedRests(
        log=log,
        rest=rest,
        intervals=intervals,
        means=interval_means(samples, intervals),
        noise=np.median(spread, axis=0) if parts else np.full(3, np.nan),
        same=np.median(same, axis=0) if parts else np.ones(3),
        same_rows=np.quantile(rows, 0.9) if parts else 1.0,
        fit=fit,
        dof=len(intervals) - PARAMETERS,
        numbers=np.arange(len(intervals)) if numbers is None else numbers,
        misfit=np.inf if fit is None else float(fit.rms) / fit.g,
        judgement=judgement,
    )


def rest_means(
    log: Log, intervals: Intervals, noise: PoseNoise, rows: Array | None = None
) -> RestMeans:
    """Mean readings of the rests, each with the noise that its own rows show.

    Times what is slower than they, and with what a coarse converter leaves; of the
    accelerometer, or of `rows`.
    """
    counts, samples = interval_counts(intervals), log.accelerometer
    samples = samples if rows is None else rows
    rests = [samples[a:b] for a, b in intervals]
    own = np.array([np.cov(rows.T) for rows in rests])
    left = rounding_left(rests, steps_of(rests))
    size = (noise.slow / counts)[:, None, None]
    warm = log.temperature
    return RestMeans.of(
        interval_means(samples, intervals),
        own * size + np.diag(left),
        log.time[intervals.sum(axis=1) // 2],
        None if warm is None else np.array([warm[a:b].mean() for a, b in intervals]),
        freedom=np.maximum(counts - 1.0, LEAST_FREEDOM),
        zero=middle_of_counts(samples),
    )


def middle_of_counts(samples: Float[Array, "n 3"]) -> float:
    """Reading about which a sign is turned: mid-range for unsigned counts."""
    if samples.min() < 0.0 or np.any(samples != np.round(samples)):
        return 0.0
    return float(2.0 ** (np.ceil(np.log2(samples.max() + 1.0)) - 1.0))


def laps_of(log: Log) -> tuple[Float[Array, "n 3"], float]:
    """Laps of a counter missing from each reading, by its jumps, and a lap's length.

    Of integers a power of two that is hardly more than what is seen; else a little over
    it, since the ends of the range are seen to within one step of the motion.
    """
    samples = log.accelerometer
    steps, span = np.diff(samples, axis=0), np.ptp(samples, axis=0)
    jumps = np.abs(steps) > _JUMP * span
    turns = np.concatenate([np.zeros((1, 3)), np.cumsum(-np.sign(steps) * jumps, 0)])
    widest = np.max(span, where=jumps.any(axis=0), initial=0.0)
    if np.all(samples == np.round(samples)):
        power = 2.0 ** np.ceil(np.log2(widest + 1.0))
        if power < _FEWEST * widest:
            return turns, power
    return turns, _WIDER * widest
