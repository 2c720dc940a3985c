"""Noise of a log's longest rest."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from simval.arrays import Array, frozen
from simval.errors import RefusedError
from simval.logs import Log
from simval.multiposition.rests import find_rests
from simval.noise import AxisNoise
from simval.noise.fit import noise_of_readings
from simval.shapes import Float
from simval.statics import WINDOWS, Intervals, interval_means

MISSING = 0.01  # share of rows lost beyond which averages are over other times
LATE = 1.5  # median steps from row to row: one is missing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LogNoise:
    """Noise model of each signal of a log.

    Attributes
    ----------
    start, stop : int
        Rows ``start <= k < stop`` that it was measured in.
    seconds : float
        Their time, s.
    how : str
        Where they come from, in words.
    accelerometer : tuple of AxisNoise
        Of the three axes, raw units.
    gyro : tuple of AxisNoise
        Of the three axes, raw units; empty without a gyroscope.
    magnetometer : tuple of AxisNoise
        Of the three axes, raw units, its own readings where it is slower than the log;
        empty without a magnetometer.
    means : Array
        Mean reading of the accelerometer in these rows, and then in every rest that
        was found, raw units, (m, 3).
    left_out : mapping of str to str
        Sensors of the log whose noise cannot be told, and why.
    """

    start: int
    stop: int
    seconds: float
    how: str
    accelerometer: tuple[AxisNoise, ...]
    gyro: tuple[AxisNoise, ...]
    magnetometer: tuple[AxisNoise, ...]
    means: Float[Array, "m 3"]
    left_out: Mapping[str, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "means", frozen(self.means))
        own = MappingProxyType(dict(self.left_out))
        object.__setattr__(self, "left_out", own)


def log_noise(
    log: Log, rest: float | None = None, *, increments: bool = False
) -> LogNoise:
    """Measure the noise of a log in its longest rest.

    Parameters
    ----------
    log : Log
        The log, see `simval.logs.read_log`.
    rest : float or None
        The first seconds of the log are known to be at rest, s; None finds the
        longest rest.
    increments : bool
        Whether a reading is a rounded increment of an angle or a velocity over the
        time of its row.

    Returns
    -------
    LogNoise
        Noise of each axis of the accelerometer and, where there is one, of the gyro
        and of the magnetometer. A magnetometer that does not show its own readings, or
        too few, is left out.

    Raises
    ------
    RefusedError
        If there is no rest, it is too short, or rows are missing in it.
    """
    from simval.noise import noise_of

    intervals = _rests(log, rest)
    start, stop, how = _still(log, rest, intervals)
    require_even(log, start, stop)
    rows = log.accelerometer[start:stop]
    if log.gyro is not None:
        rows = np.concatenate([rows, log.gyro[start:stop]], axis=1)
    found = noise_of(rows, log.rate, increments=increments)
    compass: tuple[AxisNoise, ...] = ()
    left_out = {}
    if log.magnetometer is not None:
        try:
            compass = noise_of_readings(log.magnetometer[start:stop], log.rate)
        except RefusedError as error:
            left_out["magnetometer"] = str(error)
    return LogNoise(
        start=start,
        stop=stop,
        seconds=float(log.time[stop - 1] - log.time[start]),
        how=how,
        accelerometer=found[:3],
        gyro=found[3:],
        magnetometer=compass,
        left_out=left_out,
        means=np.concatenate(
            [
                log.accelerometer[start:stop].mean(axis=0, keepdims=True),
                interval_means(log.accelerometer, intervals),
            ]
        ),
    )


def require_even(log: Log, start: int, stop: int) -> None:
    """Refuse rows that do not follow each other at equal steps of time.

    Raises
    ------
    RefusedError
        If more than a hundredth of the rows is missing between them.
    """
    steps = np.diff(log.time[start:stop])
    median = float(np.median(steps)) if len(steps) else 1.0
    late = steps[steps > LATE * median] / median
    share = float(np.sum(late - 1.0)) / max(len(steps), 1)
    if not share <= MISSING:
        msg = (
            f"{log.path}: between {log.time[start]:.2f} s and {log.time[stop - 1]:.2f} "
            f"s {100.0 * share:.2g} % of the rows are missing (steps of {median:.4g} s "
            f"and up to {steps.max():.4g} s), at most {100.0 * MISSING:g} % may be: "
            "averages over rows would not be averages over time; record without "
            "losses, or if rows only were stamped late, mark the clock - (--columns) "
            "and state the rate (--rate HZ)"
        )
        raise RefusedError(msg)


def _rests(log: Log, rest: float | None) -> Intervals:
    # those that are found; of a log whose rest is stated, there may be none to find
    try:
        return find_rests(log, rest, 1).best.intervals
    except RefusedError:
        if rest is None:
            raise
        return np.empty((0, 2), dtype=np.intp)


def _still(log: Log, rest: float | None, intervals: Intervals) -> tuple[int, int, str]:
    # rows at rest, and where they come from
    rows = len(log.time)
    if rest is not None:
        stop = log.rows_within(rest)
        return 0, stop, f"the first {log.time[stop - 1] - log.time[0]:.2f} s, as given"
    lengths = intervals[:, 1] - intervals[:, 0]
    start, stop = map(int, intervals[int(np.argmax(lengths))])
    edge = int(np.ceil(WINDOWS[0] * log.rate))  # the detector's window is not full
    if start <= edge and rows - stop <= edge:
        return 0, rows, "the whole log, which is at rest"
    return (
        start,
        stop,
        f"the longest of {len(intervals)} rest(s), from {log.time[start]:.2f} s to "
        f"{log.time[stop - 1]:.2f} s",
    )
