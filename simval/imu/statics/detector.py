"""Windowed variance, the initial rest, and static intervals of a log, at any rate.

Equation (D1) is that of `simval.imu.statics`.

**An even clock** has the detector in seconds. Rows fall into ticks of equal length; a
tick reads their mean, and one without a row (the log lost it) what the tick before it
read. Down to `RATE` a tick is one row. Above, it is as many as make up about that rate:
the same motion then leaves the same variance in a window, and noise beyond the band in
which a sensor can be turned by hand counts neither for nor against a rest.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arguments import MOST, whole_number
from simval.arrays import (
    Array,
    ReadOnly,
    finite_array,
    physical_array,
    real_number,
    shaped_array,
)
from simval.errors import InputError, RefusedError
from simval.shapes import Float
from simval.text import shown

Intervals = NDArray[np.intp]
WINDOW = 101  # samples; one second at 100 Hz
MINIMUM = 100  # samples
FLOOR_QUANTILE = 0.1
"""Of the windowed variances: the noise floor of the log. The log needs rests in more of
its windows than that, and a share of few windows would be a chance minimum. Any from
0.01 to 0.2 leaves the rests as they are; 0.5 loses those of a log that rests a fifth of
its time."""

FLOOR_MULTIPLE = 3.0
"""Floors above which a window has moved. Windows of white noise vary by 8 % at 101
samples, sqrt(2/300). Any from 1.2 to 10 leaves the rests as they are (the same test),
for it chooses the rest that scales the threshold, and not the threshold."""

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
HOLE = 5.0  # s; in more no rows were recorded, and their time counts as two windows
_CACHED = 1 << 14  # samples worked at once: arrays of 400 kB stay in the cache


def variance_magnitude(
    samples: Float[Array, "n 3"], window: int = WINDOW
) -> Float[Array, " n"]:
    """Variance magnitude of the window centred on each sample, eq. (D1).

    Parameters
    ----------
    samples : Array
        Readings, (n, 3), any unit.
    window : int
        Samples in a window, odd, 3 or more.

    Returns
    -------
    Array
        (n,), unit of the readings squared; infinite within half a window of either
        end, where there is no full window, so that nothing there is static.

    Raises
    ------
    InputError
        If the window is not odd or does not fit into the log.

    Notes
    -----
    A log is cut into blocks of a window. A window that starts within a block loses the
    samples of that block one by one and gains those of the next, both less the block's
    mean: no sum is longer than a window, so a rest late in a long log of large counts
    loses no digits.
    """
    window = whole_number("window", window, 3)
    samples = checked_samples(samples, window)
    n, half, count = len(samples), window // 2, len(samples) // window
    padded = np.concatenate([samples, np.broadcast_to(samples[-1], (window, 3))])
    squared, size = np.empty((count, window)), max(1, _CACHED // window)
    for block in range(0, count, size):
        stop = min(block + size, count)
        rows = padded[block * window : (stop + 1) * window].reshape(-1, window, 3)
        # one step of all windows after the other: sums over these are long operations
        cube = np.ascontiguousarray(rows.transpose(1, 2, 0))
        centre = cube[..., :-1].mean(axis=0)
        old, new = cube[..., :-1] - centre, cube[..., 1:] - centre
        sums, squares = np.empty_like(old), np.empty_like(old)
        sums[0], squares[0] = old.sum(axis=0), np.sum(old * old, axis=0)
        np.subtract(new[:-1], old[:-1], out=sums[1:])
        np.add(new[:-1], old[:-1], out=squares[1:])
        squares[1:] *= sums[1:]
        for k in range(1, window):
            sums[k] += sums[k - 1]
            squares[k] += squares[k - 1]
        sums *= sums
        sums /= window
        squares -= sums
        np.maximum(squares, 0.0, out=squares)
        squares *= squares
        squared[block:stop] = squares.sum(axis=1).T
    result = np.full(n, np.inf)
    whole = squared.ravel()[: n - window + 1]
    result[half : n - half] = np.sqrt(whole) / (window - 1)
    return result


def checked_samples(samples: Float[Array, "n 3"], window: int) -> Float[Array, "n 3"]:
    """Check that a log is one of finite rows and longer than a window.

    Raises
    ------
    InputError
        If it is not.
    """
    samples = one_log(samples)
    if whole_number("window", window, 3) % 2 == 0:
        msg = f"`window` is {window}; it must be an odd number of samples, 3 or more"
        raise InputError(msg)
    if not len(samples) >= window:
        msg = (
            f"`samples` has shape {samples.shape}; one log of at least one window "
            f"({window} rows of 3) is needed: record longer or shorten the window"
        )
        raise InputError(msg)
    return samples


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rest:
    """The initial rest, whose variance sets the scale of the threshold.

    Attributes
    ----------
    start, stop : int
        Samples ``start <= k < stop``.
    variance : float
        Variance magnitude (D1) of all its samples, unit of the readings squared.
    found : bool
        Whether it was found, and not stated.
    """

    start: int
    stop: int
    variance: float
    found: bool


def initial_rest(
    samples: Float[Array, "n 3"],
    count: int | None = None,
    window: int = WINDOW,
    minimum: int = MINIMUM,
    spread: Array | None = None,
    rate: float | None = None,
) -> Rest:
    """Return the initial rest: the first `count` samples, or the first rest found.

    Without `count` the noise floor of the log is the lowest tenth of its windowed
    variances, and the rest is the first run of at least `minimum` samples below three
    floors. The log then needs rests in more than a tenth of its windows, but need not
    begin at rest.

    Parameters
    ----------
    samples : Array
        Readings, (n, 3), any unit.
    count : int or None
        Samples at the start of the log known to be at rest; None finds them.
    window : int
        Samples in a window, odd.
    minimum : int
        Least number of samples of a rest that is found.
    spread : Array or None
        The samples' `variance_magnitude` where it is known already.
    rate : float or None
        Samples per second, Hz, for a message in seconds.

    Returns
    -------
    Rest
        Its samples and their variance magnitude.

    Raises
    ------
    InputError
        If `count` is shorter than a window or longer than the log.
    RefusedError
        If no rest is found, or its readings do not vary at all.
    """
    samples = checked_samples(samples, window)
    minimum = whole_number("minimum", minimum, 1)
    if count is None:
        if spread is None:
            spread = variance_magnitude(samples, window)
        least = max(minimum, 2)  # one sample has no variance
        start, stop = _first_rest(spread, least, rate)
    else:
        start, stop = 0, whole_number("count", count, 1)
        if not window <= stop <= len(samples):
            msg = (
                f"the initial rest is {stop} samples; it must be between one window "
                f"({window}) and the whole log ({len(samples)})"
            )
            raise InputError(msg)
    variance = float(np.linalg.norm(np.var(samples[start:stop], axis=0, ddof=1)))
    if not variance > 0.0:
        msg = (
            f"the initial rest (samples {start} to {stop - 1}) does not vary at all, "
            "so its noise sets no threshold; is the sensor stuck, or too coarse?"
        )
        raise RefusedError(msg)
    return Rest(start=start, stop=stop, variance=variance, found=count is None)


def _first_rest(spread: Array, minimum: int, rate: float | None) -> tuple[int, int]:
    floor = float(np.quantile(spread[np.isfinite(spread)], FLOOR_QUANTILE))
    if not floor > 0.0:
        msg = (
            "no initial rest found: the stillest rows do not vary at all, so noise "
            "sets no threshold: it is far below one step of the converter, or the "
            "sensor is stuck; record with a narrower range or a finer resolution"
        )
        raise RefusedError(msg)
    runs = runs_of(spread < FLOOR_MULTIPLE * floor)
    runs = runs[np.ptp(runs, axis=1) >= minimum]
    if len(runs) == 0:
        long = f"{minimum} samples" if rate is None else f"{minimum / rate:.3g} s"
        msg = (
            f"no initial rest found: no {long} in a row stay below "
            f"{FLOOR_MULTIPLE:g} noise floors ({floor:.3g}); state its length "
            "(--rest SECONDS), or record with rests"
        )
        raise RefusedError(msg)
    return int(runs[0, 0]), int(runs[0, 1])


def intervals_below(
    spread: Float[Array, " n"], threshold: float, minimum: int = MINIMUM, trim: int = 0
) -> Intervals:
    """Intervals whose windowed variance magnitude stays below a threshold.

    Parameters
    ----------
    spread : Array
        From `variance_magnitude`, (n,).
    threshold : float
        Limit of eq. (D1), unit of the readings squared: a multiple of a `Rest`'s.
    minimum : int
        Least number of samples of an interval, after trimming.
    trim : int
        Samples cut off at both ends of each interval: the slow start of a motion is
        still below the threshold.

    Returns
    -------
    Intervals
        (m, 2) samples ``start <= k < stop`` in order of time; m can be 0.

    Raises
    ------
    InputError
        If `minimum` is below 1 or `trim` below 0.
    """
    minimum, trim = whole_number("minimum", minimum, 1), whole_number("trim", trim, 0)
    if not real_number("threshold", threshold, "(reading unit)^2") > 0.0:
        msg = f"`threshold` is {shown(threshold)}; it must be above 0"
        raise InputError(msg)
    spread = shaped_array("spread", spread, (None,))
    if spread.ndim != 1:
        msg = f"`spread` has shape {spread.shape}; give that of one log, (n,)"
        raise InputError(msg)
    runs = runs_of(spread < threshold) + np.array([trim, -trim])
    kept: Intervals = runs[runs[:, 1] - runs[:, 0] >= minimum]
    return kept


def one_log(samples: Any) -> Float[Array, "n 3"]:
    """Check that readings are those of one log.

    Raises
    ------
    InputError
        If the shape is another, or a value is not finite.
    """
    array = physical_array("samples", samples, (None, 3))
    if array.ndim != 2:
        msg = f"`samples` has shape {array.shape}; give those of one log, (n, 3)"
        raise InputError(msg)
    return array


def checked_intervals(intervals: Any, count: int | None = None) -> Intervals:
    """Check that intervals are whole samples and not empty.

    Raises
    ------
    InputError
        If the shape is another, a number is not whole, or a row is empty or outside.
    """
    array = finite_array("intervals", intervals, (None, 2))
    rows = np.where(np.abs(array) <= MOST, array, -1.0).astype(np.intp)
    most = MOST if count is None else count
    good = (rows == array).all() and array.ndim == 2
    if not (good and np.all((rows[:, :1] >= 0) & (rows[:, :1] < rows[:, 1:]))):
        msg = "`intervals` must be rows of two whole numbers, 0 <= start < stop, (m, 2)"
        raise InputError(msg)
    if not np.all(rows <= most):
        msg = f"`intervals` reach sample {rows.max()}, and there are {count}"
        raise InputError(msg)
    return rows


def interval_counts(intervals: Intervals) -> Intervals:
    """Number of samples of each interval.

    Parameters
    ----------
    intervals : Intervals
        [start, stop) rows, (m, 2).

    Returns
    -------
    Intervals
        (m,).
    """
    intervals = checked_intervals(intervals)
    return intervals[:, 1] - intervals[:, 0]


def interval_means(
    samples: Float[Array, "n 3"], intervals: Intervals
) -> Float[Array, "m 3"]:
    """Mean reading of each interval.

    Parameters
    ----------
    samples : Array
        Readings, (n, 3).
    intervals : Intervals
        [start, stop) rows, (m, 2).

    Returns
    -------
    Array
        (m, 3), unit of the readings.
    """
    samples = one_log(samples)
    intervals = checked_intervals(intervals, len(samples))
    ended = np.append(samples, np.zeros((1, 3)), axis=0)  # an interval may stop there
    # every second sum is of the rows between two intervals
    sums = np.add.reduceat(ended, intervals.ravel(), axis=0)[::2]
    return sums / np.diff(intervals)


def runs_of(flag: NDArray[np.bool_]) -> Intervals:
    """Start and stop of each run of True, (m, 2)."""
    edges = np.diff(np.concatenate([[False], flag, [False]]).astype(np.int8))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EvenLog(ReadOnly):
    """Readings resampled to even steps of time, called ticks."""

    samples: Float[Array, "n 3"]  # mean reading of each tick
    empty: Any  # bool: ticks without a row, (n,)
    tick: Intervals  # tick of each row of the log
    rate: float  # ticks per second, Hz
    block: int  # rows to a tick
    window: int  # ticks in a window of the detector, odd
    minimum: int  # least number of ticks of an interval

    def rows(self, intervals: Intervals) -> Intervals:
        """Rows of the log in intervals of ticks."""
        return np.searchsorted(self.tick, intervals).reshape(-1, 2)

    def spread(self) -> Float[Array, " n"]:
        """Variance magnitude, infinite where half a window or more has no rows."""
        spread = variance_magnitude(self.samples, self.window)
        lost = np.cumsum(np.pad(self.empty, (1, 0)))
        half = self.window // 2
        lost = lost[self.window :] - lost[: -self.window]
        spread[half : half + len(lost)][2 * lost >= self.window] = np.inf
        return spread

    def wander(self, rest: Rest, spread: Array) -> float:
        """Variance of a rest within windows, relative to that from tick to tick.

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
        """Initial rest in rows of the log: the first `count`, or found if None.

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
    step = np.diff(time)
    holes, kept = step > HOLE, 2.0 * window  # of each, so that no interval spans it
    if count := np.count_nonzero(holes):
        time = np.cumsum(np.concatenate([time[:1], np.where(holes, kept, step)]))
    duration = float(time[-1] - time[0])
    rate = (len(step) - count) / max(duration - count * kept, float(step.min()))
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
