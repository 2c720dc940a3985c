"""What noise leaves in the mean of a rest, by Allan variance where that is known."""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array, ReadOnly
from simval.errors import InputError, RefusedError
from simval.logs import Log
from simval.multiposition.noise import require_even
from simval.noise import AxisNoise, NoiseFile
from simval.noise.model import LEAST_ROWS
from simval.shapes import Float
from simval.statics import Intervals

SHOWS = 5.0
"""Median rests in the longest one that shows how their means scatter. Allan variances
go to a tenth of it, and the fitted model a factor of two farther."""
OTHER_UNIT = 5.0  # times the noise: 9.8, 1000, 57 or counts are other units


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseNoise(ReadOnly):
    """Noise of the mean of each rest, and where it comes from.

    Attributes
    ----------
    std : Array
        Standard deviation of each axis of the mean of each rest, raw units, (m,).
    white : Array
        The same if white noise were all there is, raw units, (m,).
    source : str
        ``white``, ``log`` (the log's longest rest) or ``file``.
    words : str
        Where it comes from.
    """

    std: Float[Array, " m"]
    white: Float[Array, " m"]
    source: str
    words: str


def pose_noise(
    log: Log,
    intervals: Intervals,
    white: Float[Array, " m"],
    file: NoiseFile | None = None,
) -> PoseNoise:
    """Noise of the means of a log's rests: by Allan variance where that is known.

    Raises
    ------
    InputError
        If the noise file is that of another log's unit.
    """
    seconds = (intervals[:, 1] - intervals[:, 0]) / log.rate
    axes = None if file is None else of_this_unit(file, log, intervals)
    source = "log" if axes is None else "file"
    try:
        std = mean_noise(own_noise(log, intervals) if axes is None else axes, seconds)
    except RefusedError as refusal:
        words = f"white noise alone: {refusal}; give --noise FILE of a longer one"
        return PoseNoise(std=white, white=white, source="white", words=words)
    where = "the log's longest rest" if axes is None else "the noise file"
    words = f"the Allan variance at each rest's length, of {where}"
    return PoseNoise(std=std, white=white, source=source, words=words)


def of_this_unit(
    file: NoiseFile, log: Log, intervals: Intervals
) -> tuple[AxisNoise, ...]:
    """Noise of a file, if its readings are in the unit of this log.

    Raises
    ------
    InputError
        If white noise of the two differs by a factor of `OTHER_UNIT` or more.
    """
    rows = [log.accelerometer[a:b] for a, b in intervals]
    here = np.sqrt(np.mean([np.diff(part, axis=0).var(axis=0) for part in rows]) / 2.0)
    there = np.sqrt(np.mean([axis.variances[0] for axis in file.accelerometer]))
    require_one_unit(float(here), float(there), f"a row of {log.path}")
    return file.accelerometer


def require_one_unit(here: float, there: float, what: str) -> None:
    """Refuse a noise file whose noise is not of the size of the log's own.

    Raises
    ------
    InputError
        If the two differ by a factor of `OTHER_UNIT` or more.
    """
    if not 1.0 / OTHER_UNIT < here / max(there, 1e-300) < OTHER_UNIT:
        msg = (
            f"{what} has a noise of {here:.3g} in its unit at rest, and the noise file "
            f"one of {there:.3g}: it is of another sensor, range or unit; measure the "
            "noise in the unit of the log"
        )
        raise InputError(msg)


def own_noise(log: Log, intervals: Intervals) -> tuple[AxisNoise, ...]:
    """Noise of the accelerometer in the longest of a log's rests."""
    start, stop = longest_rest(log, intervals)
    from simval.noise import noise_of  # most rests are too short for it

    return noise_of(log.accelerometer[start:stop], log.rate)


def longest_rest(log: Log, intervals: Intervals) -> tuple[int, int]:
    """First and last but one row of the longest of a log's rests.

    Raises
    ------
    RefusedError
        If that rest is too short to show what the others' means scatter by: five times
        their median length shows it.
    """
    lengths = intervals[:, 1] - intervals[:, 0]
    start, stop = map(int, intervals[int(np.argmax(lengths))])
    least = max(LEAST_ROWS, int(np.ceil(SHOWS * np.median(lengths))))
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
    """Standard deviation of the mean of a rest, by the Allan variance at its length.

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
    first = axis.seconds[axis.used[0]]
    measured = axis.seconds[-1]
    if axis.coefficients:
        law = axis.law(np.maximum(seconds, first))
        return np.where(
            seconds >= first,
            law,
            [axis.variance_at(t) for t in np.clip(seconds, axis.seconds[0], measured)],
        )
    return np.array([axis.variance_at(float(t)) for t in seconds])
