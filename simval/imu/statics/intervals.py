"""Static intervals, their counts and their means."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arguments import MOST
from simval.arrays import Array, finite_array, physical_array
from simval.errors import InputError
from simval.shapes import Float

Intervals = NDArray[np.intp]


def one_log(samples: Any) -> Float[Array, "n 3"]:
    """Require the readings of one log.

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
    """Require intervals of whole samples that are not empty.

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
    return np.asarray(intervals[:, 1] - intervals[:, 0])


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
    means = [samples[start:stop].mean(axis=0) for start, stop in intervals]
    return np.array(means).reshape(-1, 3)


def runs_of(flag: NDArray[np.bool_]) -> Intervals:
    """Runs of True as rows start <= k < stop, (m, 2)."""
    edges = np.diff(np.concatenate([[False], flag, [False]]).astype(np.int8))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)
