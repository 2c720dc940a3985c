"""Noise of a log: of single readings, and of the means of its rests."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy

from simval.account import Remark
from simval.arrays import Array, ReadOnly, positive_number
from simval.errors import InputError, RefusedError
from simval.geometry import normalize
from simval.imu.calibrate import FitResult
from simval.imu.calibrate.goodness_of_fit import BEYOND, chi_square_chance
from simval.imu.calibrate.gyroscope.residuals import across
from simval.imu.logs import Log
from simval.imu.multiposition.rests import find_rests
from simval.imu.noise import AxisNoise, NoiseFile, load_noise, noise_of
from simval.imu.noise.fit import (
    SHARE,
    noise_of_readings,
    rounding_step,
    rows_to_a_reading,
)
from simval.imu.noise.model import LEAST_ROWS
from simval.imu.sensor import AccelerometerModel
from simval.imu.statics import WINDOWS, Intervals, interval_counts, interval_means
from simval.shapes import Float
from simval.spelling import counted

MISSING = 0.01  # share of rows lost beyond which averages are over other times
LATE = 1.5  # median steps from row to row: one is missing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LogNoise(ReadOnly):
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
        Of the three axes, raw units; empty for another sensor alone.
    gyro : tuple of AxisNoise
        Of the three axes, raw units; empty without a gyroscope.
    magnetometer : tuple of AxisNoise
        Of the three axes, raw units, its own readings where it is slower than the log;
        empty without a magnetometer.
    means : Array
        Mean reading of the accelerometer in these rows, and then in every rest that
        was found, raw units, (m, 3).
    left_out : mapping of str to Remark
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
    left_out: Mapping[str, Remark]


def log_noise(
    log: Log, rest: float | None = None, *, increments: bool = False
) -> LogNoise:
    """Measure the noise of a log in its longest rest.

    Parameters
    ----------
    log : Log
        The log, see `simval.imu.logs.read_log`.
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
    force = log.accelerometer if log.has_force else None
    sensors = [each for each in (force, log.gyro) if each is not None]
    finder = log
    for alone in [log.gyro, log.magnetometer] if force is None else []:
        if alone is not None:
            finder = replace(log, accelerometer=alone, gyro=None)
            break
    start, stop, how, intervals = _still(finder, rest)
    require_even(log, start, stop)
    axes: tuple[AxisNoise, ...] = ()
    if sensors:
        rows = np.stack([each[start:stop] for each in sensors], axis=1)
        axes = noise_of(rows, log.rate, increments=increments)
    means = np.empty((0, 3))
    if force is not None:
        mean = force[start:stop].mean(axis=0, keepdims=True)
        means = np.concatenate([mean, interval_means(force, intervals)])
    compass: tuple[AxisNoise, ...] = ()
    left_out = {}
    if log.magnetometer is not None:
        try:
            compass = noise_of_readings(log.magnetometer[start:stop], log.rate)
        except RefusedError as error:
            left_out["magnetometer"] = error.remark
    return LogNoise(
        start=start,
        stop=stop,
        seconds=float(log.time[stop - 1] - log.time[start]),
        how=how,
        accelerometer=axes[:3] if force is not None else (),
        gyro=axes[-3:] if log.gyro is not None else (),
        magnetometer=compass,
        left_out=left_out,
        means=means,
    )


def _still(log: Log, rest: float | None) -> tuple[int, int, str, Intervals]:
    # rows at rest, where they come from, and all rests that were found
    intervals = np.empty((0, 2), dtype=np.intp)
    try:
        intervals = find_rests(log, rest, 1).best.intervals
    except RefusedError:
        if rest is None:
            raise
    if rest is not None:  # of such a log there may be no rest to find
        stop = log.rows_within(rest)
        how = f"the first {log.time[stop - 1] - log.time[0]:.2f} s, as given"
        return 0, stop, how, intervals
    start, stop = _longest(intervals)
    rows = len(log.time)
    edge = int(np.ceil(WINDOWS[0] * log.rate))  # the detector's window is not full
    if start <= edge and rows - stop <= edge:
        return 0, rows, "the whole log, which is at rest", intervals
    rests = counted(len(intervals), "rest")
    how = f"the longest of {rests}, from {log.span((start, stop))}"
    return start, stop, how, intervals


def _longest(intervals: Intervals) -> tuple[int, int]:
    start, stop = intervals[np.argmax(interval_counts(intervals))]
    return int(start), int(stop)


def require_even(log: Log, start: int, stop: int) -> None:
    """Refuse rows that are not evenly spaced in time.

    Raises
    ------
    RefusedError
        If more than a hundredth of the rows is missing between them.
    """
    steps = np.diff(log.time[start:stop])
    median = np.median(steps) if len(steps) else 1.0
    late = steps[steps > LATE * median] / median
    share = np.sum(late - 1.0) / max(len(steps), 1)
    if not share <= MISSING:
        msg = (
            f"{log.path}: between {log.time[start]:.2f} s and "
            f"{log.time[stop - 1]:.2f} s {100.0 * share:.2g} % of the rows are "
            f"missing (steps of {median:.4g} s and up to {steps.max():.4g} s); "
            f"at most {100.0 * MISSING:g} % may be, because averages over rows "
            "would not be averages over time. Read a part without losses "
            "(--from, --until), or if rows were only stamped late, mark the "
            "clock - (--columns) and state the rate (--rate HZ)"
        )
        raise RefusedError(msg)


SHOWS = 5.0
"""Median rests in the longest one that shows how their means scatter. Allan variances
go to a tenth of it, and the fitted model a factor of two farther."""
LONGER = "Measure it in a longer rest (--noise FILE)."
OTHER_UNIT = 5.0  # times the noise: 9.8, 1000, 57 or counts are other units


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseNoise(ReadOnly):
    """Noise of the mean of each rest, and how it was found.

    Attributes
    ----------
    std : Array
        Standard deviation of each axis of the mean of each rest, raw units, (m,); of an
        accelerometer that along gravity.
    white : Array
        The same if white noise were all there is, raw units, (m,); the same along all
        axes and in all rests.
    trembled : Array
        What a trembling direction takes from the mean of each rest, raw units, (m, 3).
    slow : Array
        Times the variance that the rows of a rest would leave its mean if they were
        white, (m,).
    rounded : Array
        What of `std` the steps of the readings make, raw units, (m,).
    source : str
        ``white``, ``log`` (the log's longest rest), ``rests`` (all) or ``file``.
    words, do : str
        Where it comes from, and what would tell more of it.
    """

    std: Float[Array, " m"]
    white: Float[Array, " m"]
    source: str
    words: str
    do: str = ""
    trembled: Float[Array, "m 3"] | float = 0.0
    slow: Float[Array, " m"] | float = 1.0
    rounded: Float[Array, " m"] | float = 0.0

    def as_object(self) -> dict[str, Any]:
        """Return what it is and where it comes from as plain JSON values."""
        return {
            "pose_noise": self.source,
            "pose_noise_std": self.std.tolist(),
            "pose_noise_white_std": self.white.tolist(),
        }


def white_noise(
    samples: Float[Array, "n 3"], intervals: Intervals, block: int = 1
) -> Float[Array, " m"]:
    """Standard deviation that white noise leaves in the mean of each interval.

    The variance within intervals is pooled over them and over the axes. Rows that come
    faster than the sensor's band are not independent; their means over blocks are.
    """
    counts = interval_counts(intervals) // block
    parts = [
        samples[a : a + n * block].reshape(n, block, 3).mean(axis=1)
        for (a, _), n in zip(intervals, counts, strict=True)
    ]
    squares = [part.var(axis=0).mean() * len(part) for part in parts]
    variance = np.sum(squares) / (np.sum(counts) - len(counts))
    return np.sqrt(variance / counts)


def pose_noise(
    log: Log,
    intervals: Intervals,
    *,
    sensor: Literal["accelerometer", "magnetometer"] = "accelerometer",
    block: int = 1,
    file: NoiseFile | None = None,
) -> PoseNoise:
    """Noise of the means of a log's rests, by Allan variance where it is known.

    A magnetometer is often slower than its log: its own readings are what counts, each
    once, however many rows it stands in.

    Raises
    ------
    InputError
        If the noise file is that of another sensor or unit.
    """
    samples = getattr(log, sensor)
    compass = sensor == "magnetometer"
    white = white_noise(samples, intervals, block)
    if compass:
        white = white * np.sqrt(rows_to_a_reading(samples))
    axes = () if file is None else getattr(file, sensor)
    source = "file" if axes else "log"
    if axes:
        _require_this_unit(log, samples, intervals, axes, compass)
    try:
        if not axes:
            start, stop = _telling_rest(log, intervals)
            measure = noise_of_readings if compass else noise_of
            axes = measure(samples[start:stop], log.rate, intervals=False)
        std = mean_noise(axes, interval_counts(intervals) / log.rate)
    except RefusedError as refusal:
        words = f"white noise alone: {refusal}"
        return PoseNoise(std=white, white=white, source="white", words=words, do=LONGER)
    where = {"file": "the noise file", "log": "the log's longest rest"}[source]
    words = f"the Allan variance at each rest's length, of {where}"
    slow = (std / np.where(white > 0.0, white, np.inf)) ** 2
    return PoseNoise(std=std, white=white, source=source, words=words, slow=slow)


_PARTS = (4, 8)  # of a rest, whose means show what is slower than its rows
_UNLIKE = 2.0  # times the variance along gravity; axes may differ in their noise
_SHORT = 0.1  # s; in less a lever arm shakes the readings, which is no direction


def along_gravity(
    log: Log, intervals: Intervals, noise: PoseNoise, fit: FitResult
) -> PoseNoise:
    r"""Noise of the means along gravity, which is all that their lengths contain.

    It is that of `noise`. But a hand trembles. Where it does, or the means of eighths
    of the rests have chance against it, a mean of n rows of the variance :math:`s^2`
    along gravity has :math:`s^2 q/n`, with :math:`q = 2 q_4 - q_8` by quarters and
    eighths: rows that undo each other, as the accelerations of a lever arm, leave the
    means of k parts of a rest a scatter as k + 1, and that of the whole 1. What
    rounding leaves where noise does not blur its steps h,
    :math:`h^2/12\, e^{-4\pi^2\sigma^2/h^2}`, comes on top. A direction that trembles
    with the variances :math:`v_1, v_2` across shortens a mean by
    :math:`(v_1 + v_2 - 2 v_u)/2|y|^2`, which is told where it is beyond chance.
    """
    samples, counts = log.accelerometer, interval_counts(intervals)
    x = interval_means(samples, intervals) - fit.B
    up = normalize(x @ fit.matrix.T @ fit.matrix)
    axes = np.concatenate([up[:, None], across(up[None])[0]], axis=1)
    rests = [samples[a:b] for a, b in intervals]
    turned = [rows @ R.T for rows, R in zip(rests, axes, strict=True)]
    white, _ = _scatter(turned, np.ones_like(counts))
    if np.any(noise.std == 0.0):
        return noise
    own, pooled = white[:, 0], np.average(white, axis=0, weights=counts - 1)
    block = max(1, round(_SHORT * log.rate))
    short, dof = _scatter(turned, np.full(len(counts), block))
    v, *beside = dof @ short
    F = np.mean(beside) / v / _UNLIKE if v > 0.0 else 0.0
    trembles = scipy.special.fdtrc(2.0 * dof.sum(), dof.sum(), F) < BEYOND
    lost = short @ [-2.0, 1.0, 1.0] / (2.0 * block * np.vecdot(x, x)) * trembles
    seen, ratios = own > 0.0, []
    for pieces in _PARTS:
        parts, dof = _scatter(turned, np.maximum(counts // pieces, 1))
        square, free = dof[seen] @ (parts[seen, 0] / own[seen]), dof[seen].sum()
        ratios.append((square / max(free, 1.0), chi_square_chance(square, free)))
    (quarters, _), (eighths, p) = ratios
    known, alone = noise.std**2, noise.source == "white"
    step = steps_of(rests)
    left = up**2 @ rounding_left(rests, step)
    # steps that noise blurs are noise of each row
    rounded = np.sqrt(left + up**2 @ step**2 / SHARE / counts)
    noise = replace(noise, trembled=lost[:, None] * x, rounded=rounded)
    beyond = alone or eighths * pooled[0] > np.max(known * counts)
    if trembles or (beyond and 2.0 * min(p, 1.0 - p) < BEYOND):
        q = max(2.0 * quarters - eighths, eighths / 9.0)
        words = (
            f"by the means of parts of the rests, which leave {np.sqrt(q):.3g} times "
            "the noise that their rows would have if it were white"
        )
        std = np.sqrt(pooled[0] * q / counts + left)
        slow = np.full(len(counts), q)
        return replace(noise, std=std, source="rests", words=words, do="", slow=slow)
    return replace(noise, std=np.sqrt(known + left))


def steps_of(rests: list[Array]) -> Float[Array, "3"]:
    """Resolution of each axis; 0 where there is none to see."""
    return np.array([rounding_step(axis) for axis in np.concatenate(rests).T])


def rounding_left(rests: list[Array], step: Float[Array, "3"]) -> Float[Array, "3"]:
    """Variance of a mean by rounding, where noise is too small to average it out."""
    counts = [len(rows) for rows in rests]
    blurs = np.average([rows.var(axis=0) for rows in rests], axis=0, weights=counts)
    blurs = np.maximum(blurs - step**2 / SHARE, 0.0) / np.maximum(step**2, 1e-300)
    return step**2 / SHARE * np.exp(-4.0 * np.pi**2 * blurs)


def _scatter(
    rests: list[Array], block: Any
) -> tuple[Float[Array, "m 3"], Float[Array, " m"]]:
    # of each rest the variance of rows by means over blocks of them, and its freedom
    variances, dof = [], []
    for rows, size in zip(rests, block, strict=True):
        n = len(rows) // size
        parts = rows[: n * size].reshape(n, size, 3).mean(axis=1)
        variances.append(size * parts.var(axis=0, ddof=1))
        dof.append(n - 1.0)
    return np.array(variances), np.array(dof)


def _require_this_unit(
    log: Log,
    samples: Float[Array, "n 3"],
    intervals: Intervals,
    axes: tuple[AxisNoise, ...],
    compass: bool,
) -> None:
    # by the steps from row to row; of a magnetometer, whose neighbouring rows may
    # repeat, by the spread within rests
    parts = [samples[a:b] for a, b in intervals]
    if compass:
        spread = [part.var(axis=0, ddof=1) for part in parts if len(part) > 1]
        here = np.sqrt(np.median(spread))
    else:
        steps = [np.diff(part, axis=0).var(axis=0) for part in parts]
        here = np.sqrt(np.mean(steps) / 2.0)
    there = np.sqrt(np.mean([axis.variances[0] for axis in axes]))
    if not 1.0 / OTHER_UNIT < here / max(there, 1e-300) < OTHER_UNIT:
        what = "reading of the magnetometer" if compass else "row"
        msg = (
            f"the {what} of {log.path} has a noise of {here:.3g} in its unit at "
            f"rest, but the noise file says {there:.3g}: it is of another "
            "sensor, range or unit; measure the noise in the unit of the log"
        )
        raise InputError(msg)


def _telling_rest(log: Log, intervals: Intervals) -> tuple[int, int]:
    # rows of the longest rest, if it shows what the means of the others scatter by
    start, stop = _longest(intervals)
    median = np.median(interval_counts(intervals))
    least = max(LEAST_ROWS, int(np.ceil(SHOWS * median)))
    if stop - start < least:
        msg = (
            f"the longest rest, {(stop - start) / log.rate:.3g} s, is shorter than "
            f"{least / log.rate:.3g} s"
        )
        raise RefusedError(msg)
    require_even(log, start, stop)
    return start, stop


def mean_noise(
    axes: tuple[AxisNoise, ...], seconds: Float[Array, " m"]
) -> Float[Array, " m"]:
    """Standard deviation of a rest's mean, from the Allan variance at its length.

    The mean over the axes of their variances, as the calibration knows one noise for
    the three axes of a pose. An axis's variance is that of its fitted model, and the
    measured one where none fits.

    Raises
    ------
    RefusedError
        If a rest is longer than what was measured of an axis without a model.
    """
    return np.sqrt(np.mean([_variances(axis, seconds) for axis in axes], axis=0))


def _variances(axis: AxisNoise, seconds: Float[Array, " m"]) -> Float[Array, " m"]:
    if not axis.coefficients:
        return np.array([axis.variance_at(t) for t in seconds])
    first, (shortest, *_, longest) = axis.seconds[axis.used[0]], axis.seconds
    measured = [axis.variance_at(t) for t in np.clip(seconds, shortest, longest)]
    law = axis.law(np.maximum(seconds, first))
    return np.where(seconds >= first, law, measured)


FARTHEST = 2.0  # times the longest average: so far the fitted model is believed


def planned_noise(
    path: Path, hold: float | None, sensor: AccelerometerModel | None
) -> float:
    """Noise of a pose mean for a plan, from the Allan variance of a noise file.

    Those are the log's where a sensor is given, else m/s^2.
    """
    known = load_noise(path)
    if hold is None:
        msg = "how long is each pose averaged? Give `--hold`"
        raise InputError(msg)
    hold = positive_number("hold", hold, "s")
    longest = FARTHEST * known.accelerometer[0].seconds[-1]
    if hold > longest:
        msg = (
            f"{path} has averages over {longest / FARTHEST:.3g} s at most, "
            f"which is enough for holds of {longest:.3g} s, but `--hold` is "
            f"{hold:.3g} s; measure the noise in a rest of {SHOWS * hold:.3g} s "
            "or longer"
        )
        raise RefusedError(msg)
    std = mean_noise(known.accelerometer, np.array([hold]))[0]
    if sensor is None:
        if known.si_per_raw is None:
            msg = f"{path} does not say what its unit is in m/s^2; give `--sensor` too"
            raise InputError(msg)
        return std * known.si_per_raw
    scale = np.mean(np.diagonal(sensor.matrix))
    if known.si_per_raw is not None and not 0.5 < scale / known.si_per_raw < 2.0:
        msg = (
            f"by the sensor one raw unit is {scale:.4g} m/s^2, but {path} says "
            f"{known.si_per_raw:.4g}; give both in the same unit"
        )
        raise InputError(msg)
    return std
