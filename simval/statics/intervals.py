"""What is read off static intervals: counts, means and first samples."""

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import InputError

Intervals = NDArray[np.intp]


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
    return np.asarray(intervals[:, 1] - intervals[:, 0])


def interval_means(samples: Array, intervals: Intervals) -> Array:
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
    means = [samples[start:stop].mean(axis=0) for start, stop in intervals]
    return np.array(means).reshape(-1, 3)


def first_samples(samples: Array, intervals: Intervals, count: int) -> Array:
    """First readings of each interval, as IMU-TK takes them.

    Parameters
    ----------
    samples : Array
        Readings, (n, 3).
    intervals : Intervals
        [start, stop) rows, (m, 2), each of at least `count` samples.
    count : int
        Readings to take from each, 1 or more.

    Returns
    -------
    Array
        (m, count, 3), unit of the readings.

    Raises
    ------
    InputError
        If an interval is shorter.
    """
    shortest = int(interval_counts(intervals).min(initial=count))
    if not 1 <= count <= shortest:
        msg = f"`count` is {count}; it must be from 1 to the shortest's {shortest}"
        raise InputError(msg)
    return np.asarray(samples)[intervals[:, :1] + np.arange(count)]
