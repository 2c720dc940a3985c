"""Readings that show nothing: at the end of a range, constant, or in mixed units."""

import numpy as np
import scipy

from simval.arrays import Array
from simval.errors import RefusedError, SaturatedError
from simval.imu.logs import Log
from simval.imu.multiposition.rests import AXES
from simval.imu.noise.fit import SHARE, rounding_step, rows_to_a_reading
from simval.imu.statics import Intervals
from simval.shapes import Float

# A rail half a standard deviation above the mean of a rest holds so many of its
# readings (0.31 of white noise), and takes 0.2 of one off the mean.
_RAIL_SHARE = 0.3
_MISSED = 14.0
"""Readings that noise puts beyond a rail, and are not there: a chance of 1e-6 of a
rest, and a coarse converter has rests of which a third to all read the same."""
RAIL = 3
"""Readings in a row at the greatest or least reading of an axis that may be a rail."""

KINK = 4.0
"""Steps of the converter by which the rows beside a rail are off it. A round top that
reads the same for L rows is one step lower beside them, times (1 + 2/L)^2 < 3."""

SAME_UNIT = 5.0
"""Ratio of two axes' scales beyond which they are in different units: the nearest two
units in use, standard gravities and m/s^2, differ by 9.8, and no two axes by 2."""


def require_unsaturated(log: Log, intervals: Intervals, limit: float | None) -> None:
    """Refuse a log with a rest at the end of the sensor's range.

    Many readings at exactly the log's extreme are at a rail, if the noise of the rests
    would have put more of them beyond it.

    Raises
    ------
    SaturatedError
        Naming the axis, the reading and the time.
    """
    samples = log.accelerometer
    for sign in (1.0, -1.0):
        top = (sign * samples).max(axis=0)
        parts = [sign * samples[start:stop] for start, stop in intervals]
        at_top = np.array([(part == top).mean(axis=0) for part in parts])
        stuck = at_top >= _RAIL_SHARE
        if stuck.any():
            stuck &= _missed(samples, parts, at_top) > _MISSED
        if limit is not None:
            stuck |= np.array([(part >= limit).any(axis=0) for part in parts])
        if stuck.any():
            pose, axis = (int(k) for k in np.argwhere(stuck)[0])
            msg = (
                f"{log.path}: axis {AXES[axis]} is saturated at {sign * top[axis]:g} "
                f"in the rest from {log.span(intervals[pose])}; a reading at the "
                "rail says nothing about the force: cut that rest out, or record with "
                "a wider range"
            )
            raise SaturatedError(msg)


def _missed(
    samples: Float[Array, "n 3"], parts: list[Array], at_top: Float[Array, "rests 3"]
) -> Float[Array, "rests 3"]:
    # readings beyond the greatest one of each rest, by the share of these, white noise
    # and its rounding
    steps = np.array([rounding_step(axis) for axis in samples.T])
    variance = np.median([part.var(axis=0) for part in parts], axis=0)
    least = np.finfo(float).tiny  # of a sensor that rests at one value: none beyond
    sigma = np.sqrt(np.maximum(variance - steps**2 / SHARE, least))
    sizes = np.array([[len(part)] for part in parts]) / rows_to_a_reading(samples)
    share = np.minimum(at_top, 1.0 - 0.5 / sizes)
    beyond = scipy.special.ndtr(scipy.special.ndtri(share) - steps / sigma)
    return sizes * beyond


def require_alive(log: Log, name: str, samples: Float[Array, "n 3"]) -> None:
    """Refuse an axis that reads one value, or stays at the end of its range.

    Raises
    ------
    RefusedError
        Naming the axis, and where.
    """
    least = int(np.ceil(RAIL * rows_to_a_reading(samples)))
    for axis, column in zip(AXES, samples.T, strict=True):
        if np.ptp(column) == 0.0:
            msg = (
                f"{log.path}: axis {axis} of the {name} shows {column[0]:g} in every "
                "row"
            )
            raise RefusedError(msg, "look at its cable and its settings", axis=axis)
        for sign in (1.0, -1.0):
            start, length = rail(sign * column, least)
            if length:
                msg = (
                    f"{log.path}: axis {axis} of the {name} stays at {column[start]:g} "
                    f"for {length} rows from {log.time[start]:.2f} s, the end of its "
                    "range, so what is beyond it is unknown"
                )
                do = "turn more slowly, or set a wider range"
                raise SaturatedError(msg, do, axis=axis, rows=length)


def rail(column: Float[Array, " n"], least: int = RAIL) -> tuple[int, int]:
    """Start and length of the longest stay at the largest reading; length 0: none."""
    top = column.max()
    edges = np.flatnonzero(np.diff(np.r_[0, column == top, 0]))
    starts, stops = edges[::2], edges[1::2]
    step = np.diff(np.unique(column)).min()
    walled = np.pad(column, 1, constant_values=-np.inf)  # a log may begin at a rail
    kinked = np.maximum(walled[starts], walled[stops + 1]) < top - KINK * step
    lengths = np.where(kinked, stops - starts, 0)
    k = np.argmax(lengths)
    return (int(starts[k]), int(lengths[k])) if lengths[k] >= least else (0, 0)


def require_one_unit(log: Log, name: str, M: Float[Array, "3 3"]) -> None:
    """Refuse three axes whose scales differ as much as units do.

    Raises
    ------
    RefusedError
        With the ratio.
    """
    scales = np.linalg.norm(M, axis=0)
    ratio = scales.max() / scales.min()
    if not ratio < SAME_UNIT:
        low, high = AXES[scales.argmin()], AXES[scales.argmax()]
        msg = (
            f"{log.path}: axis {high} of the {name} counts in units {ratio:.3g} "
            f"times those of axis {low}"
        )
        raise RefusedError(msg, "write all three axes in the same unit", times=ratio)
