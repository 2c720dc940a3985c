"""Faults of a sensor, a cable or a logger: reasons to reject the rests of a log.

Each check looks for the mark of one fault, and returns nothing or a sentence that names
the axis, the time and the remedy. Most faults still give nine numbers and error bars,
so every calibration of a log goes through `require_sound`; and every refusal through
`explained`, since a cause that can be named says more than the geometry it has ruined.
What begins in the course of a log is looked for in `changes`.
"""

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import ConvergenceError, RefusedError, SaturatedError, SimvalError
from simval.imu.calibrate import calibrate
from simval.imu.calibrate.evidence import REPEATS, STATE_NOISE
from simval.imu.calibrate.goodness_of_fit import LEFT
from simval.imu.calibrate.gyroscope.result import START
from simval.imu.calibrate.outliers import find_outliers
from simval.imu.logs import Log
from simval.imu.multiposition.changes import (
    changed,
    flipped,
    other_unit,
    stepped,
    wrapped,
)
from simval.imu.multiposition.rests import AXES, MISFIT, Case, case_of, find_rests
from simval.imu.noise.fit import rows_to_a_reading
from simval.imu.statics import Intervals
from simval.imu.statics.detector import runs_of
from simval.poses import PARAMETERS
from simval.shapes import Float

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
# A rail half a standard deviation above the mean of a rest holds so many of its
# readings (0.31 of white noise), and takes 0.2 of one off the mean.
_RAIL_SHARE = 0.3
_RARELY = 0.05  # chance that a scatter beyond the limit leaves as little as is seen
_TELLING = LEFT + 1  # degrees of freedom: one for the least step, and two to tell it by
RAIL = 3
"""Readings in a row at the greatest or least reading of an axis that may be a rail."""

KINK = 4.0
"""Steps of the converter by which the rows beside a rail are off it. A round top that
reads the same for L rows is one step lower beside them, times (1 + 2/L)^2 < 3."""

SAME_UNIT = 5.0
"""Ratio of two axes' scales beyond which they are in different units: the nearest two
units in use, standard gravities and m/s^2, differ by 9.8, and no two axes by 2."""


Checks = tuple[Callable[[Case], str | None], ...]


def require_sound(case: Case) -> None:
    """Refuse a calibration whose log shows a fault.

    Raises
    ------
    RefusedError
        That names the axis, the time and the remedy.
    """
    words = _first(case, SIGNS)
    if words:
        msg = f"{case.log.path}: {words}"
        raise RefusedError(msg)


def explained(
    log: Log, g: float, rest: float | None, refusal: RefusedError
) -> Exception:
    """Return the refusal, or one that names the fault behind it."""
    try:
        intervals = find_rests(log, rest).best.intervals
    except SimvalError:
        intervals = np.empty((0, 2), dtype=np.intp)
    case = case_of(log, g, rest, intervals)
    causes: Checks = CAUSES if len(case.means) else CAUSES_WITHOUT_RESTS
    if len(case.means) and isinstance(refusal, SaturatedError):
        causes = CAUSES_OF_SATURATION  # what it has spoilt is no fault by itself
    words = _first(case, causes)
    if words:
        return RefusedError(f"{log.path}: {words}")
    if isinstance(refusal, ConvergenceError):
        return ConvergenceError(
            f"{log.path}: the fit to {len(case.means)} rests did not converge: they "
            "hardly fix an ellipsoid, or are not all of gravity; hold the sensor in "
            "more poses all over the sphere, and check the columns, the wiring and "
            "the units of each axis"
        )
    return type(refusal)(for_a_log(str(refusal)))


def _first(case: Case, checks: Checks) -> str | None:
    # one after the other, since each costs time
    return next((words for check in checks if (words := check(case))), None)


def for_a_log(words: str) -> str:
    """Reword advice about poses and rotations as advice about a log."""
    for ours, theirs in {
        STATE_NOISE: "measure it in a long rest (simval noise LOG --json > noise.json) "
        "and give that file (--noise noise.json)",
        REPEATS: "or cut the log before it repeats",
        START: "",
    }.items():
        words = words.replace(ours, theirs)
    return words


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


def constant_axis(case: Case) -> str | None:
    """An axis that shows one value in the whole log."""
    samples = case.log.accelerometer
    still = np.ptp(samples, axis=0) == 0.0
    if still.all() or not still.any():  # all three: the log is empty of readings
        return None
    axis = int(np.argmax(still))
    return (
        f"axis {AXES[axis]} shows {samples[0, axis]:g} in every row "
        f"{case.rows(0, len(samples))}: it is not connected or stuck; check its wire "
        "and the columns (--columns), and record again"
    )


def zero_rows(case: Case) -> str | None:
    """Rows of three zeros, which stand for lost data."""
    zero = np.all(case.log.accelerometer == 0.0, axis=1)
    for index, (start, stop) in enumerate(case.intervals):
        if np.count_nonzero(zero[start:stop]) >= 2:
            return (
                f"x, y and z are all exactly 0 in {np.count_nonzero(zero)} rows, among "
                f"them the rest {case.span(index)}: a sensor at rest reads gravity, "
                "so these rows stand for lost data; cut them out"
            )
    return None


def frozen(case: Case) -> str | None:
    """A rest in which an axis repeats one value although it is noisy elsewhere."""
    samples = case.log.accelerometer
    # at the ends of the range it is saturated, see `require_unsaturated`
    rails = np.stack([samples.min(axis=0), samples.max(axis=0)], axis=1)
    for axis in np.flatnonzero(case.same <= _NOISY):
        same = np.diff(samples[:, axis]) == 0.0
        for index, (start, stop) in enumerate(case.intervals):
            runs = runs_of(same[start : stop - 1]) + start
            if len(runs) == 0:
                continue
            first, end = runs[np.argmax(np.ptp(runs, axis=1))]
            if end - first >= _RUN and samples[first, axis] not in rails[axis]:
                return (
                    f"axis {AXES[axis]} shows {samples[first, axis]:g} in every row "
                    f"{case.rows(first, end + 1)}, within the rest "
                    f"{case.span(index)}, and varies by {case.noise[axis]:.2g} in "
                    "other rests: the sensor or the logger froze; cut that stretch out"
                )
    return None


def spikes(case: Case) -> str | None:
    """Single rows far off, often enough to shift the means of the case."""
    samples = case.log.accelerometer
    radius = np.sqrt(np.sum(np.var(case.means, axis=0)))
    shifts, first, count = [], -1, 0
    for start, stop in case.intervals:
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
        f"{case.log.time[first]:.2f} s, which move its mean by {shift[axis]:.2g}: "
        "data is damaged on its way (cable, bus, clock); take those rows out, or "
        "record again"
    )


def repeated(case: Case) -> str | None:
    """A stretch of rows that is an earlier one again, bit for bit."""
    samples = case.log.accelerometer
    if case.same_rows >= 1.0:
        return None
    # rows that no pair of stretches of a log has in common by chance
    chance = np.log(_BY_CHANCE / len(samples) ** 2)
    run = max(_RUN, int(np.ceil(chance / np.log(max(case.same_rows, 1e-3)))))
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
        f"the {length} rows {case.rows(second, second + length)} are those "
        f"{case.rows(first, first + length)} again, bit for bit: a buffer was "
        "written twice; cut the second out"
    )


def flat_axis(case: Case) -> str | None:
    """An axis that does not take part, or repeats another."""
    centred = case.means - case.means.mean(axis=0)
    spread = np.sqrt(np.mean(centred**2, axis=0))
    size = np.linalg.norm(centred, axis=0)
    size[size == 0.0] = 1.0
    alike = np.abs((centred / size).T @ (centred / size))
    one, two = max(((0, 1), (0, 2), (1, 2)), key=lambda pair: float(alike[pair]))
    # root mean square of an axis that the other two do not explain
    others = np.delete(centred, two, axis=1)
    part = np.linalg.lstsq(others, centred[:, two], rcond=None)[0]
    own = float(np.sqrt(np.mean((centred[:, two] - others @ part) ** 2)))
    like = min(spread[one], spread[two]) > _LIKE * max(spread[one], spread[two])
    if like and own < _FLAT * spread.max() and spread.min() > _FLAT * spread.max():
        likeness = "the same" if centred[:, one] @ centred[:, two] > 0 else "opposite"
        return (
            f"axes {AXES[one]} and {AXES[two]} show {likeness} signal(s) in all "
            f"{len(centred)} rests {case.whole}: two columns are one channel, or "
            "the sensor was turned about one axis alone; check the wiring and the "
            "columns (--columns), add poses, and record again"
        )
    axis = int(np.argmin(spread))
    typical = float(np.median(spread))
    odd = case.misfit > MISFIT
    if case.fit is not None:
        scale = np.abs(np.diagonal(case.fit.matrix))
        odd |= float(scale[axis]) > _ODD_SCALE * np.median(scale)
    if spread[axis] < _FLAT * typical or (spread[axis] < _WEAK * typical and odd):
        return (
            f"axis {AXES[axis]} varies by {spread[axis]:.2g} over the {len(centred)} "
            f"rests {case.whole}, the others by {typical:.2g}: it shows noise "
            "instead of gravity, or was never tipped; check its wire, tip the sensor "
            "so that each axis points up and down, and record again"
        )
    return None


def outlying(case: Case) -> str | None:
    """Rests that are off the ellipsoid of the others, which calibrate without them."""
    outliers = find_outliers(case.means)
    if not outliers.flagged.any():
        return None
    try:
        calibrate(case.means[~outliers.flagged], case.g).require_converged()
    except SimvalError:
        return None
    named = [
        f"{k} {case.span(int(k))} ({abs(outliers.standardized[k]):.3g} standard "
        "deviations off)"
        for k in np.flatnonzero(outliers.flagged)
    ]
    it, hold = ("it", "that hold") if len(named) == 1 else ("them", "those holds")
    return (
        f"{_off(named)}, and without {it} the others calibrate; look at {hold}, cut "
        f"{it} out of the log and calibrate again"
    )


def _off(named: list[str]) -> str:
    verb = "does" if len(named) == 1 else "do"
    return f"rest {', rest '.join(named)} {verb} not lie on the ellipsoid of the others"


def undecided(case: Case) -> str | None:
    """Residuals beyond the noise, of too few rests to name what they show."""
    if case.dof >= _TELLING or not case.beyond_noise:
        return None
    return (
        f"the residuals of {len(case.means)} rests are {np.sqrt(case.chi2):.1f} "
        "times what their noise explains, and so few rests do not tell a hold that "
        "moved from a sensor that changed, which would make every number wrong; "
        f"record at least {PARAMETERS + _TELLING} rests, better 20"
    )


def no_gravity(case: Case) -> str | None:
    """Residuals that are too large, or may come from a scatter that is."""
    assert case.diagnosis is not None
    misfit = possible = case.misfit
    if case.beyond_noise:
        least = scipy.special.chdtri(case.dof, 1.0 - _RARELY)
        possible *= np.sqrt(len(case.means) / least)
    if max(misfit, possible) <= MISFIT:
        return None
    named = [f"{k} {case.span(k)}" for k in case.diagnosis.outliers]
    farthest = int(np.argmax(np.abs(case.diagnosis.distance)))
    what = (
        f"{_off(named)}; cut {'it' if len(named) == 1 else 'them'} out of the log and "
        "calibrate again"
        if named
        else "check axes, units, wiring and range, and hold the sensor still; the rest "
        f"that is farthest off is the one {case.span(farthest)}"
    )
    return (
        f"the rests miss gravity by {100.0 * misfit:.2g} % (root mean square), with so "
        f"many rests {100.0 * possible:.2g} % may be behind it, and at most "
        f"{100.0 * MISFIT:g} % is accepted: these are not readings of gravity on "
        f"three axes; {what}"
    )


SIGNS = (
    constant_axis, zero_rows, frozen, spikes, repeated, flipped, flat_axis, wrapped,
    other_unit, changed, stepped, undecided, no_gravity,
)  # fmt: skip
"""Checks of a log that calibrates, the quick and plain ones first."""

CAUSES_WITHOUT_RESTS = (constant_axis, zero_rows, wrapped)
CAUSES_OF_SATURATION = (*CAUSES_WITHOUT_RESTS, frozen)
CAUSES = (
    *CAUSES_OF_SATURATION, repeated, flat_axis, other_unit, flipped, changed, stepped,
    outlying,
)  # fmt: skip
"""Checks of a log that was refused."""


# The sensors other than the accelerometer


def require_alive(log: Log, name: str, samples: Float[Array, "n 3"]) -> None:
    """Refuse an axis that shows one value, and one that stays at the end of its range.

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
                "row; look at its cable and its settings"
            )
            raise RefusedError(msg)
        for sign in (1.0, -1.0):
            start, length = rail(sign * column, least)
            if length:
                msg = (
                    f"{log.path}: axis {axis} of the {name} stays at "
                    f"{column[start]:g} for {length} rows from {log.time[start]:.2f} "
                    "s: that is the end of its range, and what lies beyond is not "
                    "known; turn more slowly, or widen the range"
                )
                raise SaturatedError(msg)


def rail(column: Float[Array, " n"], least: int = RAIL) -> tuple[int, int]:
    """Start and length of the longest stay at the greatest reading; length 0: none."""
    top = float(column.max())
    edges = np.flatnonzero(np.diff(np.r_[0, column == top, 0]))
    starts, stops = edges[::2], edges[1::2]
    step = float(np.diff(np.unique(column)).min())
    walled = np.pad(column, 1, constant_values=-np.inf)  # a log may begin at a rail
    kinked = np.maximum(walled[starts], walled[stops + 1]) < top - KINK * step
    lengths = np.where(kinked, stops - starts, 0)
    k = int(np.argmax(lengths))
    return (int(starts[k]), int(lengths[k])) if lengths[k] >= least else (0, 0)


def require_one_unit(log: Log, name: str, M: Float[Array, "3 3"]) -> None:
    """Refuse three axes whose scales differ as units do.

    Raises
    ------
    RefusedError
        With the ratio.
    """
    scales = np.linalg.norm(M, axis=0)
    ratio = float(scales.max() / scales.min())
    if not ratio < SAME_UNIT:
        low, high = AXES[int(scales.argmin())], AXES[int(scales.argmax())]
        msg = (
            f"{log.path}: a unit of axis {high} of the {name} is {ratio:.3g} times one "
            f"of axis {low}; write all three axes in the same unit"
        )
        raise RefusedError(msg)
