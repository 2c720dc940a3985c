"""What is wrong with a log: a fault of the sensor, the cable or the logger.

Each check looks for the mark of one fault in the rests, and returns nothing or a
sentence that names the axis, the time and the remedy. Every log goes through them:
most faults still give nine numbers and error bars.
"""

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import SaturatedError
from simval.logs import Log
from simval.multiposition.rests import Rests
from simval.shapes import Float
from simval.statics import Intervals
from simval.statics.intervals import runs_of

AXES = "xyz"
_RUN = 25  # equal readings, or rows equal to earlier ones, in a row
# Share of equal neighbours in noise, 0.28 steps of the converter by its sd: 0.36^24
# is 2e-11, so that no log of a million rows has such a run by chance.
_NOISY = 0.36
_BY_CHANCE = 1e-9  # of a stretch that equals any other of a log
_LONGEST = 1000  # rows; noise so coarse that more would be needed tells nothing
_FAR = 10.0  # robust standard deviations of a spike; noise has none in 1e22 rows
_SHIFT = 2e-3  # of the readings' radius, by which spikes may move the mean of a rest
_LIKE = 0.25  # least ratio of the scales of two columns that may be one channel
_FLAT = 0.02  # of the spread of the other axes: misalignments leave far more
_WEAK = 0.3  # the least spread of an axis in poses of less than half the sphere is 0.3
_ODD_SCALE = 3.0  # ratio of two axes' scales that no sensor has
# Of gravity. Holds by hand leave some 1e-3 (the recordings of tests/test_recorded.py
# 1e-4 to 2e-4); residuals above it are not those of gravity at rest.
MISFIT = 0.02
# A rail half a standard deviation above the mean of a rest holds so many of its
# readings (0.31 of white noise), and takes 0.2 of one off the mean.
_RAIL_SHARE = 0.3


def require_unsaturated(log: Log, intervals: Intervals, limit: float | None) -> None:
    """Refuse a log that has a rest with readings at the end of the range.

    Many readings at exactly the log's extreme are at a rail, if the noise elsewhere is
    enough that readings do not repeat by themselves.

    Raises
    ------
    SaturatedError
        Naming the axis, the reading and the time.
    """
    samples = log.accelerometer
    for sign in (1.0, -1.0):
        top = (sign * samples).max(axis=0)
        parts = [sign * samples[start:stop] for start, stop in intervals]
        own = np.array([(part == part.max(axis=0)).mean(axis=0) for part in parts])
        at_rail = np.array([(part == top).mean(axis=0) for part in parts])
        stuck = (at_rail >= _RAIL_SHARE) & (np.median(own, axis=0) < _RAIL_SHARE / 3)
        if limit is not None:
            stuck |= np.array([(part >= limit).any(axis=0) for part in parts])
        if stuck.any():
            pose, axis = (int(k) for k in np.argwhere(stuck)[0])
            start, stop = intervals[pose]
            msg = (
                f"{log.path}: axis {AXES[axis]} is saturated at {sign * top[axis]:g} "
                f"in the rest from {log.time[start]:.2f} s to "
                f"{log.time[stop - 1]:.2f} s; a reading at the rail says nothing about "
                "the force: cut that rest out, or record with a wider range"
            )
            raise SaturatedError(msg)


def constant_axis(rests: Rests) -> str | None:
    """An axis that shows one value in the whole log."""
    samples = rests.log.accelerometer
    still = np.ptp(samples, axis=0) == 0.0
    if still.all() or not still.any():  # all three: the log is empty of readings
        return None
    axis = int(np.argmax(still))
    return (
        f"axis {AXES[axis]} shows {samples[0, axis]:g} in every row "
        f"{rests.rows(0, len(samples))}: it is not connected or stuck; check its wire "
        "and the columns (--columns), and record again"
    )


def zero_rows(rests: Rests) -> str | None:
    """Rows of three zeros, which stand for lost data."""
    zero = np.all(rests.log.accelerometer == 0.0, axis=1)
    for index, (start, stop) in enumerate(rests.intervals):
        if np.count_nonzero(zero[start:stop]) >= 2:
            return (
                f"x, y and z are all exactly 0 in {np.count_nonzero(zero)} rows, among "
                f"them the rest {rests.span(index)}: a sensor at rest reads gravity, "
                "so these rows stand for lost data; cut them out"
            )
    return None


def frozen(rests: Rests) -> str | None:
    """A rest in which an axis repeats one value although it is noisy elsewhere."""
    samples = rests.log.accelerometer
    # at the ends of the range it is saturated, see `require_unsaturated`
    rails = np.stack([samples.min(axis=0), samples.max(axis=0)], axis=1)
    for axis in np.flatnonzero(rests.same <= _NOISY):
        same = np.diff(samples[:, axis]) == 0.0
        for index, (start, stop) in enumerate(rests.intervals):
            runs = runs_of(same[start : stop - 1]) + start
            if len(runs) == 0:
                continue
            first, end = runs[np.argmax(np.ptp(runs, axis=1))]
            if end - first >= _RUN and samples[first, axis] not in rails[axis]:
                return (
                    f"axis {AXES[axis]} shows {samples[first, axis]:g} in every row "
                    f"{rests.rows(first, end + 1)}, within the rest "
                    f"{rests.span(index)}, and varies by {rests.noise[axis]:.2g} in "
                    "other rests: the sensor or the logger froze; cut that stretch out"
                )
    return None


def spikes(rests: Rests) -> str | None:
    """Single rows far off, often enough to shift the means of the rests."""
    samples = rests.log.accelerometer
    radius = np.sqrt(np.sum(np.var(rests.means, axis=0)))
    shifts, first, count = [], -1, 0
    for start, stop in rests.intervals:
        offset = samples[start:stop] - np.median(samples[start:stop], axis=0)
        scale = np.quantile(np.abs(offset), 0.95, axis=0) / 2.0
        far = np.abs(offset) > _FAR * np.maximum(scale, np.finfo(float).tiny)
        far &= scale > 0.0  # else too coarse to tell
        shifts.append(np.where(far, offset, 0.0).mean(axis=0))
        count += int(np.count_nonzero(far))
        if first < 0 and far.any():
            first = int(start) + int(np.argmax(far.any(axis=1)))
    shift = np.mean(shifts, axis=0)
    axis = int(np.argmax(np.abs(shift)))
    if not abs(shift[axis]) > _SHIFT * radius:
        return None
    return (
        f"axis {AXES[axis]} has spikes, {count} readings in the rests, the first at "
        f"{rests.log.time[first]:.2f} s, which move its mean by {shift[axis]:.2g}: "
        "data is damaged on its way (cable, bus, clock); take those rows out, or "
        "record again"
    )


def repeated(rests: Rests) -> str | None:
    """A stretch of rows that is an earlier one again, bit for bit."""
    samples = rests.log.accelerometer
    run = _telling_run(len(samples), rests.same_rows)
    if run > min(_LONGEST, len(samples) // 2):
        return None
    _, code = np.unique(samples, axis=0, return_inverse=True)
    codes: NDArray[np.uint64] = code.ravel().astype(np.uint64)
    # a polynomial in the codes of a run of rows, modulo 2^64, stands for them
    total: NDArray[np.uint64] = np.zeros(len(codes) - run + 1, dtype=np.uint64)
    for k in range(run):
        total *= np.uint64(0x9E3779B97F4A7C15)
        total += codes[k : k + len(total)] + np.uint64(1)
    order = np.argsort(total, kind="stable")
    pairs = np.stack([order[:-1], order[1:]], axis=1)[np.diff(total[order]) == 0]
    pairs = pairs[pairs[:, 1] - pairs[:, 0] >= run]  # closer ones are a frozen stretch
    if len(pairs) == 0:
        return None
    first, second = pairs[np.argmin(pairs[:, 1])]
    length = 0
    longest = min(len(codes) - second, second - first)
    while length < longest and codes[first + length] == codes[second + length]:
        length += 1
    return (
        f"the {length} rows {rests.rows(second, second + length)} are those "
        f"{rests.rows(first, first + length)} again, bit for bit: a buffer was "
        "written twice; cut the second out"
    )


def _telling_run(rows: int, same: float) -> int:
    # rows that no pair of stretches of a log has in common by chance
    if same >= 1.0:
        return _LONGEST + 1
    chance = np.log(_BY_CHANCE / rows**2) / np.log(max(same, 1e-3))
    return max(_RUN, int(np.ceil(chance)))


def flat_axis(
    rests: Rests, scale: Float[Array, "3"] | None = None, misfit: float = np.inf
) -> str | None:
    """An axis that does not take part, or repeats another."""
    centred = rests.means - rests.means.mean(axis=0)
    spread = np.sqrt(np.mean(centred**2, axis=0))
    one, two = _most_alike(centred)
    own = _left_over(centred, two)
    like = min(spread[one], spread[two]) > _LIKE * max(spread[one], spread[two])
    if like and own < _FLAT * spread.max() and spread.min() > _FLAT * spread.max():
        likeness = "the same" if centred[:, one] @ centred[:, two] > 0 else "opposite"
        return (
            f"axes {AXES[one]} and {AXES[two]} show {likeness} signal(s) in all "
            f"{len(centred)} rests {_whole(rests)}: two columns are one channel, or "
            "the sensor was turned about one axis alone; check the wiring and the "
            "columns (--columns), add poses, and record again"
        )
    axis = int(np.argmin(spread))
    other = float(np.median(spread))
    odd = misfit > MISFIT
    if scale is not None:
        odd |= float(np.abs(scale[axis])) > _ODD_SCALE * np.median(np.abs(scale))
    if spread[axis] < _FLAT * other or (spread[axis] < _WEAK * other and odd):
        return (
            f"axis {AXES[axis]} varies by {spread[axis]:.2g} over the {len(centred)} "
            f"rests {_whole(rests)}, the others by {other:.2g}: it shows noise "
            "instead of gravity, or was never tipped; check its wire, tip the sensor "
            "so that each axis points up and down, and record again"
        )
    return None


def _whole(rests: Rests) -> str:
    return rests.rows(rests.intervals[0, 0], rests.intervals[-1, 1])


def _most_alike(centred: Float[Array, "n 3"]) -> tuple[int, int]:
    size = np.linalg.norm(centred, axis=0)
    size[size == 0.0] = 1.0
    alike = np.abs((centred / size).T @ (centred / size))
    pairs = ((0, 1), (0, 2), (1, 2))
    return max(pairs, key=lambda pair: float(alike[pair]))


def _left_over(centred: Float[Array, "n 3"], axis: int) -> float:
    # root mean square of an axis that the other two do not explain
    others = np.delete(centred, axis, axis=1)
    part = np.linalg.lstsq(others, centred[:, axis], rcond=None)[0]
    return float(np.sqrt(np.mean((centred[:, axis] - others @ part) ** 2)))
