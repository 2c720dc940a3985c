r"""A log resampled to an even clock: the detector in seconds, at any rate.

Rows fall into ticks of equal length; a tick reads their mean, and one without a row
(the log lost it) what the tick before it read. Down to `RATE` a tick is one row. Above,
it is as many as make up about that rate: the same motion then leaves the same variance
in a window, and noise beyond the band in which a sensor can be turned by hand counts
neither for nor against a rest.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.arrays import Array, finite_array, frozen
from simval.errors import InputError, RefusedError
from simval.imu.statics.detector import (
    Intervals,
    Rest,
    initial_rest,
    intervals_below,
    variance_magnitude,
)
from simval.shapes import Float

RATE = 100.0  # Hz; rows that come faster are averaged to ticks of about this rate
# span of the variance's window, and of the shortest interval, which is a window shorter
# than its rest: 1 s as the method's authors use it; the other for rests of 1 s
WINDOWS = (1.0, 0.5)  # s
# limits of `EvenLog.wander`. Noise of a band f wanders by rate / (2 pi f) at most, and
# no accelerometer's band is below half a hertz, 0.3 s: measured 1.1 on real sensors, 16
# for 1 Hz at 100 Hz, and 80 to 1000 where a slow motion was taken for a rest
SLOWEST_NOISE = 0.3  # s
WHITE = 1.5  # white noise has 1, with 50 ticks less than this in all but 1e-4 of rests
SLOWEST = 5.0  # Hz; windows of 5 ticks: every rest of test_rests.py still found
CLOCK_ERROR = 0.01  # relative; of a nominal rate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EvenLog:
    """Readings at equal distances in time."""

    samples: Float[Array, "n 3"]  # mean reading of each tick
    empty: Any  # bool: ticks without a row, (n,)
    tick: Intervals  # tick of each row of the log
    rate: float  # ticks per second, Hz
    block: int  # rows to a tick
    window: int  # ticks in a window of the detector, odd
    minimum: int  # least number of ticks of an interval

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", frozen(self.samples))

    def rows(self, intervals: Intervals) -> Intervals:
        """Rows of the log that intervals of ticks hold."""
        return np.searchsorted(self.tick, intervals).reshape(-1, 2)

    def spread(self) -> Float[Array, " n"]:
        """Variance magnitude, infinite where half a window or more has no row."""
        spread = variance_magnitude(self.samples, self.window)
        lost = np.cumsum(np.pad(self.empty, (1, 0)))
        half = self.window // 2
        lost = lost[self.window :] - lost[: -self.window]
        spread[half : half + len(lost)][2 * lost >= self.window] = np.inf
        return spread

    def wander(self, rest: Rest, spread: Array) -> float:
        """Variance of a rest's readings within a window, over that from tick to tick.

        Median variance of the rest's windows over half its mean squared difference of
        successive ticks, 1: 1 for white noise, more where motion is in it.
        """
        ticks = slice(self.tick[rest.start], self.tick[rest.stop - 1] + 1)
        steps = np.mean(np.diff(self.samples[ticks], axis=0) ** 2, axis=0)
        whole = spread[ticks][np.isfinite(spread[ticks])]
        noise = float(np.linalg.norm(0.5 * steps))
        return float(np.median(whole)) / noise if noise > 0.0 else np.inf

    def intervals(self, spread: Array, threshold: float) -> Intervals:
        """Static intervals below a threshold, in rows of the log."""
        return self.rows(intervals_below(spread, threshold, self.minimum))

    def initial_rest(self, count: int | None, spread: Array) -> Rest:
        """Initial rest of the log, in its rows: the first `count`, or None to find it.

        Raises
        ------
        InputError, RefusedError
            As `simval.imu.statics.initial_rest`.
        """
        ticks = None if count is None else int(self.tick[count - 1]) + 1
        rest = initial_rest(
            self.samples, ticks, self.window, self.minimum, spread, self.rate
        )
        start, stop = self.rows(np.array([[rest.start, rest.stop]]))[0]
        return replace(rest, start=int(start), stop=int(stop))


def evened(
    time: Float[Array, " n"], samples: Float[Array, "n 3"], window: float = WINDOWS[0]
) -> EvenLog:
    """Resample a log to an even clock.

    Parameters
    ----------
    time : Array
        Seconds, (n,), strictly increasing.
    samples : Array
        Readings, (n, 3), any unit.
    window : float
        Span of the detector's window and of its shortest interval, s.

    Returns
    -------
    EvenLog
        The same readings, and lengths in ticks for what the detector has in seconds.

    Raises
    ------
    InputError
        If the log is shorter than a window, or its times do not increase.
    RefusedError
        If its rows are too few in a second.
    """
    samples = finite_array("samples", samples, (None, 3))
    time = finite_array("time", time, (len(samples),))
    if not (len(time) >= 2 and np.all(np.diff(time) > 0.0)):
        msg = f"`time` has {len(time)} values; two or more are needed, each increasing"
        raise InputError(msg)
    duration = float(time[-1] - time[0])
    rate = (len(time) - 1) / duration
    if not rate >= SLOWEST * (1.0 - CLOCK_ERROR):
        msg = (
            f"the log has {rate:.4g} rows a second; {SLOWEST:g} or more are needed to "
            "tell a rest from a motion within a second: record faster, or state the "
            "clock's unit (t[ms], t[us], t[ns] in --columns) if it is not in seconds"
        )
        raise RefusedError(msg)
    if not duration + 1.0 / rate >= window:
        msg = (
            f"the log lasts {duration:.3g} s ({len(time)} rows at {rate:.6g} Hz); at "
            f"least one window of the detector ({window:g} s) is needed: record longer"
        )
        raise InputError(msg)
    block = max(1, round(rate / RATE))
    # a row in the middle of its tick, so that jitter of less than half a row is nothing
    tick = np.floor(((time - time[0]) * rate + 0.5) / block).astype(np.intp)
    present, first, counts = np.unique(tick, return_index=True, return_counts=True)
    means = np.add.reduceat(samples, first, axis=0) / counts[:, None]
    every = np.arange(tick[-1] + 1)
    even = rate / block
    half = round(even * window / 2)
    last = np.searchsorted(present, every, side="right") - 1
    return EvenLog(
        samples=means[last],
        empty=present[last] != every,
        tick=tick,
        rate=even,
        block=block,
        window=2 * half + 1,
        minimum=round(even * 2.0 * window) - 2 * half,
    )
