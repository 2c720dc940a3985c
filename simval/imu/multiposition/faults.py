"""Faults that a sensor, a cable or a logger leaves in the rests of a log.

**What is wrong with a log: a fault of the sensor, the cable or the logger.**

Each check looks for the mark of one fault in the rests, and returns nothing or a
sentence that names the axis, the time and the remedy. Every log goes through them:
most faults still give nine numbers and error bars.

**What changes in the course of a log: a counter that wraps, a gain, a sign, a unit.**

Such a log looks sound row by row; what gives it away is that undoing the change, or
leaving a part out, makes the residuals vanish.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import SaturatedError, SimvalError
from simval.imu.calibrate import FitResult, calibrate
from simval.imu.calibrate.drift import find_break, find_step
from simval.imu.calibrate.outliers import (
    BELIEVED,
    BEYOND,
    chi_square_chance,
    find_outliers,
)
from simval.imu.logs import Log
from simval.imu.multiposition.rests import Rests
from simval.imu.statics import Intervals, interval_means
from simval.imu.statics.intervals import runs_of
from simval.poses import PARAMETERS
from simval.shapes import Float

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
# Of gravity. Holds by hand leave some 1e-3 (the recordings of test_recorded.py
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


Detector = Callable[[Log, int], Intervals]  # the rests of a log, at least so many

# What these bounds let pass and catch of 570 bad logs is
# held by tests/imu/multiposition/test_faults.py.
_BETTER = 1.5  # times less scatter; undoing the jumps of a sound log makes it worse
_VANISHES = 4.0  # times less scatter; leaving out a part of a slow drift halves it
_CHANCE = 1e-6  # of a cut or a step as good in a clean log; its root where the
# chi-square has a chance as small, `BEYOND`
_UNUSED = 15.0  # s without a rest, long enough for several of another unit
_SEVERAL = 3  # rests that agree on another unit
_MANY = 6  # rests all over a sphere: their spread is its radius within a factor of two
_FAR_UNIT = 2.0  # of that spread, off from it
_OTHER_UNIT = 0.3  # of gravity, off from it: readings in motion average to 5 %


def wrapped(log: Log, misfit: float, g: float, detect: Detector) -> str | None:
    """An axis whose readings leave at one end of a range and return at the other."""
    samples = log.accelerometer
    steps = np.diff(samples, axis=0)
    span = np.ptp(samples, axis=0)
    jumps = np.abs(steps) > 0.5 * span
    suspects = np.flatnonzero(jumps.any(axis=0))
    if suspects.size == 0:
        return None
    turns = np.concatenate([np.zeros((1, 3)), np.cumsum(-np.sign(steps) * jumps, 0)])
    widest = float(span[suspects].max())
    try:
        periods = _periods(samples, widest)
        undone = [samples + turns * period for period in periods]
        intervals = detect(replace(log, accelerometer=undone[0]), PARAMETERS)
        means = np.array([interval_means(part, intervals) for part in undone])
        fits = calibrate(means, g, covariance=False, repeats=True)
    except SimvalError:
        return None
    laps = np.array([np.median(turns[a:b], axis=0) for a, b in intervals])
    if not np.ptp(laps, axis=0).any():
        return None  # spikes: all rests are on one lap
    residual = np.where(fits.converged, fits.rms / g, np.inf)
    best = int(np.argmin(residual))
    if not (residual[best] < MISFIT and residual[best] * _BETTER < misfit):
        return None
    axis = int(suspects[np.argmax(jumps.sum(axis=0)[suspects])])
    row = int(np.argmax(jumps[:, axis]))
    before, after = samples[row, axis], samples[row + 1, axis]
    return (
        f"axis {AXES[axis]} jumps from {before:g} to {after:g} between "
        f"{log.time[row]:.2f} s and {log.time[row + 1]:.2f} s, and at "
        f"{int(jumps.sum())} places in all: the readings wrap around a range of "
        f"{periods[best]:.6g}, and lie on an ellipsoid once that is undone; read the "
        "counts as signed or unsigned as the sensor writes them, or unwrap them by "
        f"{periods[best]:.6g}, and calibrate again"
    )


def _periods(samples: Array, span: float) -> Array:
    # what a counter could wrap around: a power of two, or a little over what is seen,
    # since the ends of the range are seen to within one step of the motion
    if np.all(samples == np.round(samples)):
        power = 2.0 ** np.ceil(np.log2(span + 1.0))
        if power < 1.1 * span:
            return np.array([power])
    return span * np.linspace(1.0, 1.1, 41)


def flipped(rests: Rests, g: float, chi2: float = np.nan) -> str | None:
    """A time from which some axes have the other sign.

    Turning the signs back leaves as many parameters. By noise of unknown size the
    likelihood grows as the scatter's drop to the power of the degrees of freedom, and
    in a clean log to R times with a chance of at most 1/R (Markov), times the number
    of cuts and sets of axes tried. It must leave no more than the noise, or vanish.
    """
    means, dof = rests.means, len(rests.means) - PARAMETERS
    if dof < 1 or (np.isfinite(chi2) and not beyond_noise(chi2, dof)):
        return None
    signs = 1.0 - 2.0 * np.array(list(np.ndindex(2, 2, 2))[1:])
    cuts = np.arange(1, len(means))
    later = np.arange(len(means)) >= cuts[:, None]
    turned = np.where(later[:, None, :, None], signs[:, None, :], 1.0)
    middle = _middle(rests.log.accelerometer)
    undone = middle + (turned * (means - middle)).reshape(-1, len(means), 3)
    try:
        fits = calibrate(
            np.concatenate([undone, means[None]]), g, covariance=False, repeats=True
        )
    except SimvalError:
        return None
    residual = np.where(fits.converged, np.minimum(fits.rms / g, 1.0), 1.0)
    best = int(np.argmin(residual[:-1]))
    if not 0.0 < residual[best] < MISFIT:
        return None
    drop = float(residual[-1] / residual[best])
    healed = (
        np.isfinite(chi2) and chi_square_chance(chi2 / drop**2 * dof, dof) >= BELIEVED
    )
    if not (healed or drop >= _VANISHES) or len(undone) * drop**-dof > BEYOND:
        return None
    cut, which = divmod(best, len(signs))
    axes = " and ".join(AXES[k] for k in np.flatnonzero(signs[which] < 0.0))
    return (
        f"axis {axes} changed sign between the rest {rests.span(cut)} and the one "
        f"{rests.span(cut + 1)}: with the sign turned back the rests scatter "
        f"{drop:.3g} times less (wiring, driver, order of the axes); turn it "
        "back, or cut the log there and calibrate one part"
    )


def _middle(samples: Array) -> float:
    # what a sign turns about: 0, or the middle of the range of unsigned counts
    top = float(samples.max())
    if samples.min() >= 0.0 and np.all(samples == np.round(samples)):
        return float(2.0 ** (np.ceil(np.log2(top + 1.0)) - 1.0))
    return 0.0


def changed(rests: Rests) -> str | None:
    """A time from which the rests lie on another ellipsoid."""
    cut = find_break(rests.means)
    if cut is None or not (cut.chance <= _CHANCE and cut.drop >= _VANISHES):
        return None
    if _a_few_explain_it(rests, cut.scatter):
        return None
    earlier, later = rests.span(cut.index - 1), rests.span(cut.index)
    return (
        f"the rests up to the one {earlier} and those since the one {later} do not lie "
        f"on one ellipsoid; the {cut.what} ones alone "
        f"scatter {cut.drop:.3g} times less: scale, bias, sign or order of the axes "
        "changed in between (range setting, cable, temperature); cut the log there "
        "and calibrate one part"
    )


def stepped(rests: Rests, chi2: float = np.nan) -> str | None:
    """A time at which biases or scales change, for too few rests to be cut in two.

    In white noise the share of the residuals that a step explains does not depend on
    their size, so its chance and that of the chi-square may be multiplied. A step that
    leaves no more than the noise is refused whatever its own chance: a dozen rests do
    not tell it from moved holds, after which the answer would still be right.
    """
    known, dof = bool(np.isfinite(chi2)), len(rests.means) - PARAMETERS
    if known and not beyond_noise(chi2, dof):
        return None
    step = find_step(rests.means)
    if step is None or step.drop < _VANISHES:
        return None
    healed = (
        known
        and chi_square_chance(chi2 / step.drop**2 * step.dof, step.dof) >= BELIEVED
    )
    if not (step.chance <= (BEYOND if known else _CHANCE) or healed):
        return None
    if _a_few_explain_it(rests, step.scatter):
        return None
    earlier, later = rests.span(step.index - 1), rests.span(step.index)
    changed, advice = (
        ("changed", "cut the log there and calibrate one part, or record again")
        if step.chance <= BEYOND
        else (
            "may have changed",
            "so few rests do not tell it from holds that moved: record more",
        )
    )
    return (
        f"{step.what} {changed} between the rest {earlier} and the one {later}: with "
        f"such a step the {len(rests.means)} rests scatter {step.drop:.3g} times less "
        f"(range setting, cable, shock, temperature); {advice}"
    )


def beyond_noise(chi2: float, dof: int) -> bool:
    """Return whether white noise exceeds such a chi-square in under 1 of 1000 logs."""
    return chi_square_chance(chi2 * dof, dof) < BEYOND


def _a_few_explain_it(rests: Rests, scatter: float) -> bool:
    # without its outliers the log scatters no more than a cut or a step would leave
    outliers = find_outliers(rests.means)
    if not outliers.flagged.any():
        return False
    others = outliers.distance[~outliers.flagged]
    return bool(np.sqrt(np.sum(others**2) / max(outliers.dof, 1)) < 2.0 * scatter)


def other_unit(rests: Rests, fit: FitResult | None, detect: Detector) -> str | None:
    """A long stretch whose rests were left out because they read another gravity."""
    log = rests.log
    if len(rests.means) < _SEVERAL:
        return None
    several, off = (_SEVERAL, _OTHER_UNIT) if fit else (_MANY, _FAR_UNIT)
    edges = np.concatenate([[0], rests.intervals.ravel(), [len(log.time)]])
    for start, stop in edges.reshape(-1, 2):
        if log.time[stop - 1] - log.time[min(start, stop - 1)] < _UNUSED:
            continue
        part = replace(
            log,
            time=log.time[start:stop],
            accelerometer=log.accelerometer[start:stop],
            gyro=None,
        )
        try:
            inside = interval_means(part.accelerometer, detect(part, _SEVERAL))
        except SimvalError:
            continue  # no rests there: motion
        typical = _gravity(inside, rests.means, fit) if len(inside) >= several else 1.0
        if abs(np.log(typical)) > np.log1p(off):
            return (
                f"{len(inside)} rests {rests.rows(start, stop)} read "
                f"{typical:.3g} times the gravity of the others, on x, y and z: the "
                "unit or the range changed; bring all rows to one unit, or calibrate "
                "the parts by themselves"
            )
    return None


def _gravity(
    inside: Float[Array, "m 3"], others: Float[Array, "k 3"], fit: FitResult | None
) -> float:
    # of some rests over that of the others
    if fit is not None:
        length = np.linalg.norm(fit.sensor().correct(inside), axis=-1) / fit.g
        return float(np.median(length))
    radii = [np.sqrt(np.sum(np.var(part, axis=0))) for part in (inside, others)]
    return float(max(radii[0], np.finfo(float).tiny) / radii[1])
