"""Faults of a sensor, a cable or a logger for which the rests of a log are refused.

Each check looks for the mark of one fault, and returns nothing or a sentence that names
the axis, the time and the remedy. Most faults still give nine numbers and error bars,
so every calibration of a log goes through `require_sound`; and every refusal through
`explained`, since a cause that can be named says more than the geometry it has ruined.

What looks sound row by row, such as a sign or a gain that changes, is judged by the
means of the rests, and in one way (`simval.imu.explain`): after what the rows show by
themselves, and before rests that are too few.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import ConvergenceError, RefusedError, SaturatedError, SimvalError
from simval.imu.calibrate.covariance import REPEATS, STATE_NOISE
from simval.imu.calibrate.diagnosis import distances
from simval.imu.calibrate.goodness_of_fit import LEFT
from simval.imu.calibrate.gyroscope.result import START
from simval.imu.logs import Log
from simval.imu.multiposition.case import JudgedRests, case_of, laps_of
from simval.imu.multiposition.noise import pose_noise
from simval.imu.multiposition.rests import AXES, find_rests
from simval.imu.statics import Intervals, interval_means
from simval.imu.statics.detector import runs_of
from simval.poses import PARAMETERS
from simval.shapes import Float

_RUN = 25  # equal readings, or rows equal to earlier ones, in a row
# Share of equal neighbours in noise, 0.28 steps of the converter by its sd: 0.36^24
# is 2e-11, so that no log of a million rows has such a run by chance.
_NOISY = 0.36
_BY_CHANCE = 1e-9  # of a stretch that equals any other of a log
_LONGEST = 1000  # rows; noise so coarse that it would need more is not tested
_FAR = 10.0  # robust standard deviations of a spike; noise has none in 1e22 rows
_SHIFT = 2e-3  # of the readings' radius, by which spikes may move the mean of a rest
_LIKE = 0.25  # least ratio of the scales of two columns that may be one channel
_FLAT = 0.02  # of the spread of the other axes: misalignments leave far more
_WEAK = 0.3  # the least spread of an axis in poses of less than half the sphere is 0.3
_ODD_SCALE = 3.0  # ratio of two axes' scales that no sensor has
# Of gravity. Holds by hand leave some 1e-3 (the recordings of test_recorded.py
# 1e-4 to 2e-4); residuals above it are not those of gravity at rest.
MISFIT = 0.02
# What these bounds let pass and catch of 570 bad logs is
# held by tests/imu/multiposition/test_faults.py.
_UNUSED = 15.0  # s without a rest, long enough for several of another unit
_SEVERAL = 3  # rests that agree on another unit, or in which an axis is stuck
_MANY = 6  # rests all over a sphere: their spread is its radius within a factor of two
_FAR_UNIT = 2.0  # of that spread, off from it
_OTHER_UNIT = 0.3  # of gravity, off from it: readings in motion average to 5 %
_RARELY = 0.05  # chance that a scatter beyond the limit leaves as little as is seen
_TELLING = LEFT + 1  # degrees of freedom: one for the least step, and two to tell it by
Checks = tuple[Callable[[JudgedRests], str | None], ...]


def require_sound(case: JudgedRests) -> None:
    """Refuse to calibrate a log that shows a fault.

    Raises
    ------
    RefusedError
        That names the axis, the time and the remedy; with what was `tried`.
    """
    words = _first(case, SIGNS)
    if words:
        raise _refusal(case, words)


def explained(log: Log, rest: float | None, refusal: RefusedError) -> Exception:
    """Return the refusal, or one that names the fault that caused it."""
    intervals = _rests(log, rest)
    noise = pose_noise(log, intervals) if len(intervals) else None
    case = case_of(log, rest, intervals, noise)
    causes: Checks = CAUSES if len(case.means) else CAUSES_WITHOUT_RESTS
    if len(case.means) and isinstance(refusal, SaturatedError):
        causes = CAUSES_OF_SATURATION  # what it has spoilt is no fault by itself
    words = _first(case, causes)
    if words:
        return _refusal(case, words)
    if isinstance(refusal, ConvergenceError):
        return ConvergenceError(
            f"{log.path}: the fit to {len(case.means)} rests did not converge: they "
            "hardly fix an ellipsoid, or are not all of gravity; hold the sensor in "
            "more poses all over the sphere, and check the columns, the wiring and "
            "the units of each axis"
        )
    return type(refusal)(for_a_log(str(refusal)))


def _rests(log: Log, rest: float | None) -> Intervals:
    # of a counter that wraps around within them those without its laps
    turns, lap = laps_of(log)
    unwrapped = replace(log, accelerometer=log.accelerometer + lap * turns)
    for one in [log, unwrapped] if turns.any() else [log]:
        try:
            return find_rests(one, rest).best.intervals
        except SimvalError:
            continue
    return np.empty((0, 2), dtype=np.intp)


def _refusal(case: JudgedRests, words: str) -> RefusedError:
    refusal = RefusedError(f"{case.log.path}: {words}")
    if case.judgement.answer != "sound":
        refusal.tried = "\n".join(case.judgement.runners_up(case.middle))
    return refusal


def _first(case: JudgedRests, checks: Checks) -> str | None:
    # one after the other, since each costs time
    return next((words for check in checks if (words := check(case))), None)


def for_a_log(words: str) -> str:
    """Turn advice about poses and rotations into advice about a log."""
    for ours, theirs in {
        STATE_NOISE: "measure it in a long rest (simval noise LOG --json > noise.json) "
        "and give that file (--noise noise.json)",
        REPEATS: "or cut the log before it repeats",
        START: "",
    }.items():
        words = words.replace(ours, theirs)
    return words


def constant_axis(case: JudgedRests) -> str | None:
    """An axis that reads the same value in the whole log."""
    samples = case.log.accelerometer
    still = np.ptp(samples, axis=0) == 0.0
    if still.all() or not still.any():  # all three: the log is empty of readings
        return None
    axis = np.argmax(still)
    return (
        f"axis {AXES[axis]} shows {samples[0, axis]:g} in every row "
        f"{case.rows(0, len(samples))}: it is not connected or stuck; check its wire "
        "and the columns (--columns), and record again"
    )


def zero_rows(case: JudgedRests) -> str | None:
    """Rows of three zeros, which loggers write for lost data."""
    zero = np.all(case.log.accelerometer == 0.0, axis=1)
    for index, (start, stop) in enumerate(case.intervals):
        if np.count_nonzero(zero[start:stop]) >= 2:
            return (
                f"x, y and z are all exactly 0 in {np.count_nonzero(zero)} rows, among "
                f"them the rest {case.span(index)}: a sensor at rest reads gravity, "
                "so these rows stand for lost data; cut them out"
            )
    return None


def frozen(case: JudgedRests) -> str | None:
    """A rest in which an axis repeats one value although it is noisy elsewhere."""
    samples = case.log.accelerometer
    # at the ends of the range it is saturated, see `simval.imu.multiposition.ranges`
    rails = np.stack([samples.min(axis=0), samples.max(axis=0)], axis=1)
    for axis in np.flatnonzero(case.same <= _NOISY):
        same = np.diff(samples[:, axis]) == 0.0
        if not np.any(np.ptp(runs_of(same), axis=1) >= _RUN):
            continue
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


def spikes(case: JudgedRests) -> str | None:
    """Single rows that are far off, so many that they shift the means of rests."""
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
            first = start + np.argmax(far.any(axis=1))
    shift = np.mean(shifts, axis=0)
    axis = np.argmax(np.abs(shift))
    if not abs(shift[axis]) > _SHIFT * radius:
        return None
    return (
        f"axis {AXES[axis]} has spikes, {count} readings in the rests, the first at "
        f"{case.log.time[first]:.2f} s, which move its mean by {shift[axis]:.2g}: "
        "data is damaged on its way (cable, bus, clock); take those rows out, or "
        "record again"
    )


def repeated(case: JudgedRests) -> str | None:
    """A stretch of rows that repeats an earlier one bit for bit."""
    samples = case.log.accelerometer
    if case.same_rows >= 1.0:
        return None
    # rows that no pair of stretches of a log has in common by chance
    chance = np.log(_BY_CHANCE / len(samples) ** 2)
    run = max(_RUN, int(np.ceil(chance / np.log(max(case.same_rows, 1e-3)))))
    if run > min(_LONGEST, len(samples) // 2):
        return None
    codes: NDArray[np.uint64] = np.zeros(len(samples), dtype=np.uint64)
    for axis in samples.T:
        values, code = np.unique(axis, return_inverse=True)
        codes = codes * np.uint64(len(values)) + code.astype(np.uint64)
    # a polynomial in the codes of a run of rows, modulo 2^64, stands for them
    total: NDArray[np.uint64] = np.zeros(len(codes) - run + 1, dtype=np.uint64)
    for k in range(run):
        total *= np.uint64(0x9E3779B97F4A7C15)
        total += codes[k : k + len(total)] + np.uint64(1)
    if np.all(np.diff(np.sort(total))):  # a sort is quicker than an order
        return None
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


def flat_axis(case: JudgedRests) -> str | None:
    """An axis that does not respond to turns, or repeats another axis."""
    centred = case.means - case.means.mean(axis=0)
    spread = np.sqrt(np.mean(centred**2, axis=0))
    size = np.linalg.norm(centred, axis=0)
    size[size == 0.0] = 1.0
    alike = np.abs((centred / size).T @ (centred / size))
    one, two = max(((0, 1), (0, 2), (1, 2)), key=lambda pair: alike[pair])
    # root mean square of an axis that the other two do not explain
    others = np.delete(centred, two, axis=1)
    part = np.linalg.lstsq(others, centred[:, two])[0]
    own = np.sqrt(np.mean((centred[:, two] - others @ part) ** 2))
    like = min(spread[one], spread[two]) > _LIKE * max(spread[one], spread[two])
    if like and own < _FLAT * spread.max() and spread.min() > _FLAT * spread.max():
        likeness = "the same" if centred[:, one] @ centred[:, two] > 0 else "opposite"
        return (
            f"axes {AXES[one]} and {AXES[two]} show {likeness} signal(s) in all "
            f"{len(centred)} rests {case.whole}: two columns are one channel, or "
            "the sensor was turned about one axis alone; check the wiring and the "
            "columns (--columns), add poses, and record again"
        )
    axis = np.argmin(spread)
    typical = np.median(spread)
    odd = case.misfit > MISFIT
    if case.fit is not None:
        scale = np.abs(np.diagonal(case.fit.matrix))
        odd |= scale[axis] > _ODD_SCALE * np.median(scale)
    if spread[axis] < _FLAT * typical or (spread[axis] < _WEAK * typical and odd):
        return (
            f"axis {AXES[axis]} varies by {spread[axis]:.2g} over the {len(centred)} "
            f"rests {case.whole}, the others by {typical:.2g}: it shows noise "
            "instead of gravity, or was never tipped; check its wire, tip the sensor "
            "so that each axis points up and down, and record again"
        )
    return None


def stuck(case: JudgedRests) -> str | None:
    """An axis that reads one value while the others move, where the rests misfit."""
    if case.judgement.answer == "sound":
        return None
    for axis, samples in enumerate(case.log.accelerometer.T):
        for first, end in runs_of(np.diff(samples) == 0.0):
            inside = (case.intervals[:, 0] >= first) & (case.intervals[:, 1] <= end + 1)
            if np.count_nonzero(inside) >= _SEVERAL:
                return (
                    f"axis {AXES[axis]} shows {samples[first]:g} in every row "
                    f"{case.rows(first, end + 1)}, while the sensor was turned: it is "
                    "stuck; check its wire, and calibrate the rest of the log alone"
                )
    return None


def wrapped(case: JudgedRests) -> str | None:
    """A counter that leaves its range at one end and comes back at the other."""
    causes = [found.explanation.kinds for found in case.judgement.candidates]
    return judged(case) if causes and all(c == {"wrap"} for c in causes) else None


def judged(case: JudgedRests) -> str | None:
    """What is wrong with the rests, if the odds are high enough to refuse them."""
    return case.wrong if case.judgement.answer == "refusal" else None


def accused(case: JudgedRests) -> str | None:
    """The same, if the sensor or its readings are wrong and not a single rest."""
    return judged(case) if case.judgement.accuses else None


def other_unit(case: JudgedRests) -> str | None:
    """A long stretch whose rests were left out as they read another gravity."""
    log = case.log
    if len(case.means) < _SEVERAL:
        return None
    several, off = (_SEVERAL, _OTHER_UNIT) if case.fit else (_MANY, _FAR_UNIT)
    edges = np.concatenate([[0], case.intervals.ravel(), [len(log.time)]])
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
            inside = interval_means(part.accelerometer, case.detect(part, _SEVERAL))
        except SimvalError:
            continue  # no rests there: motion
        typical = _gravity(inside, case) if len(inside) >= several else 1.0
        if abs(np.log(typical)) > np.log1p(off):
            return (
                f"{len(inside)} rests {case.rows(start, stop)} read "
                f"{typical:.3g} times the gravity of the others, on x, y and z: the "
                "unit or the range changed; bring all rows to one unit, or calibrate "
                "the parts by themselves"
            )
    return None


def _gravity(inside: Float[Array, "m 3"], case: JudgedRests) -> float:
    # of some rests over that of the others
    if case.fit is not None:
        force = case.fit.sensor().correct(inside)
        return np.median(np.linalg.norm(force, axis=-1) / case.fit.g)
    radii = [np.sqrt(np.sum(np.var(part, axis=0))) for part in (inside, case.means)]
    return max(radii[0], np.finfo(float).tiny) / radii[1]


def undecided(case: JudgedRests) -> str | None:
    """Residuals beyond the noise in so few rests that the cause stays open."""
    if case.dof >= _TELLING or case.judgement.answer == "sound":
        return None
    return (
        f"the residuals of {len(case.means)} rests are "
        f"{case.judgement.misfit:.1f} times what their noise explains. So "
        "few rests cannot show whether a hold moved or the sensor changed, "
        "which would make every number wrong; record at least "
        f"{PARAMETERS + _TELLING} rests, better 20"
    )


def no_gravity(case: JudgedRests) -> str | None:
    """Residuals that are too large, or may be so and hide behind few rests."""
    assert case.fit is not None
    misfit = possible = case.misfit
    if case.judgement.answer != "sound":
        least = scipy.special.chdtri(case.dof, 1.0 - _RARELY)
        possible *= np.sqrt(len(case.means) / least)
    if max(misfit, possible) <= MISFIT:
        return None
    farthest = int(np.argmax(np.abs(distances(case.fit, case.means)[0])))
    what = judged(case) or (
        "check axes, units, wiring and range, and hold the sensor still; the rest "
        f"that is farthest off is the one {case.span(farthest)}"
    )
    return (
        f"the rests miss gravity by {100.0 * misfit:.2g} % (root mean square), which "
        f"for so few rests may be {100.0 * possible:.2g} % in truth, and at most "
        f"{100.0 * MISFIT:g} % is accepted: these are not readings of gravity on "
        f"three axes; {what}"
    )


SIGNS = (
    constant_axis, zero_rows, frozen, spikes, repeated, flat_axis, other_unit, stuck,
    accused, undecided, no_gravity,
)  # fmt: skip
"""Checks of a log that calibrates, the quick and plain ones first."""

CAUSES_WITHOUT_RESTS = (constant_axis, zero_rows)
CAUSES_OF_SATURATION = (constant_axis, zero_rows, wrapped, frozen)
CAUSES = (*CAUSES_OF_SATURATION, repeated, flat_axis, other_unit, stuck, judged)
"""Checks of a log that was refused."""
