"""Faults of a sensor, a cable or a logger: reasons to reject the rests of a log.

Each check looks for the mark of one fault, and returns nothing or a sentence that names
the axis, the time and the remedy. Most faults still give nine numbers and error bars,
so every calibration of a log goes through `require_sound`; and every refusal through
`explained`, since a cause that can be named says more than the geometry it has ruined.

A counter that wraps, a gain, a sign or a unit that changes look sound row by row: what
gives them away is that undoing the change, or leaving a part out, makes the residuals
vanish.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import ConvergenceError, RefusedError, SaturatedError, SimvalError
from simval.imu.calibrate import calibrate
from simval.imu.calibrate.diagnosis import distances
from simval.imu.calibrate.drift import find_break, find_step
from simval.imu.calibrate.evidence import REPEATS, STATE_NOISE
from simval.imu.calibrate.goodness_of_fit import (
    BELIEVED,
    BEYOND,
    LEFT,
    chi_square_chance,
)
from simval.imu.calibrate.gyroscope.result import START
from simval.imu.calibrate.outliers import find_outliers
from simval.imu.logs import Log
from simval.imu.multiposition.rests import AXES, MISFIT, Case, case_of, find_rests
from simval.imu.statics import interval_means
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
# What these bounds let pass and catch of 570 bad logs is
# held by tests/imu/multiposition/test_faults.py.
_BETTER = 1.5  # times less scatter; undoing the jumps of a sound log makes it worse
_STEPS = 20  # of a fit; of 24 500 sets that fit to `MISFIT` none took more than ten
_VANISHES = 4.0  # times less scatter; leaving out a part of a slow drift halves it
_CHANCE = 1e-6  # of a cut or a step as good in a clean log; its root where the
# chi-square has a chance as small, `BEYOND`
_UNUSED = 15.0  # s without a rest, long enough for several of another unit
_SEVERAL = 3  # rests that agree on another unit
_MANY = 6  # rests all over a sphere: their spread is its radius within a factor of two
_FAR_UNIT = 2.0  # of that spread, off from it
_OTHER_UNIT = 0.3  # of gravity, off from it: readings in motion average to 5 %
_RARELY = 0.05  # chance that a scatter beyond the limit leaves as little as is seen
_TELLING = LEFT + 1  # degrees of freedom: one for the least step, and two to tell it by
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


def wrapped(case: Case) -> str | None:
    """An axis whose readings leave at one end of a range and return at the other."""
    log, samples = case.log, case.log.accelerometer
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
        intervals = case.detect(replace(log, accelerometer=undone[0]), PARAMETERS)
        means = np.array([interval_means(part, intervals) for part in undone])
        fits = calibrate(means, case.g, covariance=False, repeats=True)
    except SimvalError:
        return None
    laps = np.array([np.median(turns[a:b], axis=0) for a, b in intervals])
    if not np.ptp(laps, axis=0).any():
        return None  # spikes: all rests are on one lap
    residual = np.where(fits.converged, fits.rms / case.g, np.inf)
    best = int(np.argmin(residual))
    if not (residual[best] < MISFIT and residual[best] * _BETTER < case.misfit):
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


def flipped(case: Case) -> str | None:
    """A time from which some axes have the other sign.

    Turning the signs back leaves as many parameters. By noise of unknown size the
    likelihood grows as the scatter's drop to the power of the degrees of freedom, and
    in a clean log to R times with a chance of at most 1/R (Markov), times the number
    of cuts and sets of axes tried. It must leave no more than the noise, or vanish.
    """
    means, dof, chi2 = case.means, case.dof, case.chi2
    if dof < 1 or (np.isfinite(chi2) and not case.beyond_noise):
        return None
    signs = 1.0 - 2.0 * np.array(list(np.ndindex(2, 2, 2))[1:])
    cuts = np.arange(1, len(means))
    later = np.arange(len(means)) >= cuts[:, None]
    turned = np.where(later[:, None, :, None], signs[:, None, :], 1.0)
    middle, samples = 0.0, case.log.accelerometer
    if samples.min() >= 0.0 and np.all(samples == np.round(samples)):
        # unsigned counts turn about the middle of their range
        middle = float(2.0 ** (np.ceil(np.log2(float(samples.max()) + 1.0)) - 1.0))
    undone = middle + (turned * (means - middle)).reshape(-1, len(means), 3)
    try:
        fits = calibrate(
            np.concatenate([undone, means[None]]), case.g, covariance=False,
            repeats=True, max_iterations=_STEPS,
        )  # fmt: skip
    except SimvalError:
        return None
    residual = np.where(fits.converged, np.minimum(fits.rms / case.g, 1.0), 1.0)
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
        f"axis {axes} changed sign between the rest {case.span(cut)} and the one "
        f"{case.span(cut + 1)}: with the sign turned back the rests scatter "
        f"{drop:.3g} times less (wiring, driver, order of the axes); turn it "
        "back, or cut the log there and calibrate one part"
    )


def changed(case: Case) -> str | None:
    """A time from which the rests lie on another ellipsoid."""
    if np.isfinite(case.chi2) and not case.beyond_noise:
        return None
    cut = find_break(case.means)
    if cut is None or not (cut.chance <= _CHANCE and cut.drop >= _VANISHES):
        return None
    if _a_few_explain_it(case, cut.scatter):
        return None
    earlier, later = case.span(cut.index - 1), case.span(cut.index)
    return (
        f"the rests up to the one {earlier} and those since the one {later} do not lie "
        f"on one ellipsoid; the {cut.what} ones alone "
        f"scatter {cut.drop:.3g} times less: scale, bias, sign or order of the axes "
        "changed in between (range setting, cable, temperature); cut the log there "
        "and calibrate one part"
    )


def stepped(case: Case) -> str | None:
    """A time at which biases or scales change, for too few rests to be cut in two.

    In white noise the share of the residuals that a step explains does not depend on
    their size, so its chance and that of the chi-square may be multiplied. A step that
    leaves no more than the noise is refused whatever its own chance: a dozen rests do
    not tell it from moved holds, after which the answer would still be right.
    """
    chi2, known = case.chi2, bool(np.isfinite(case.chi2))
    if known and not case.beyond_noise:
        return None
    step = find_step(case.means, _VANISHES)
    if step is None or step.drop < _VANISHES:
        return None
    healed = (
        known
        and chi_square_chance(chi2 / step.drop**2 * step.dof, step.dof) >= BELIEVED
    )
    if not (step.chance <= (BEYOND if known else _CHANCE) or healed):
        return None
    if _a_few_explain_it(case, step.scatter):
        return None
    earlier, later = case.span(step.index - 1), case.span(step.index)
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
        f"such a step the {len(case.means)} rests scatter {step.drop:.3g} times less "
        f"(range setting, cable, shock, temperature); {advice}"
    )


def _a_few_explain_it(case: Case, scatter: float) -> bool:
    # without its outliers the log scatters no more than a cut or a step would leave
    outliers = find_outliers(case.means)
    if not outliers.flagged.any():
        return False
    others = outliers.distance[~outliers.flagged]
    return bool(np.sqrt(np.sum(others**2) / max(outliers.dof, 1)) < 2.0 * scatter)


def other_unit(case: Case) -> str | None:
    """A long stretch whose rests were left out because they read another gravity."""
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


def _gravity(inside: Float[Array, "m 3"], case: Case) -> float:
    # of some rests over that of the others
    if case.fit is not None:
        force = case.fit.sensor().correct(inside)
        return float(np.median(np.linalg.norm(force, axis=-1) / case.fit.g))
    radii = [np.sqrt(np.sum(np.var(part, axis=0))) for part in (inside, case.means)]
    return float(max(radii[0], np.finfo(float).tiny) / radii[1])


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
    assert case.fit is not None
    misfit = possible = case.misfit
    if case.beyond_noise:
        least = scipy.special.chdtri(case.dof, 1.0 - _RARELY)
        possible *= np.sqrt(len(case.means) / least)
    if max(misfit, possible) <= MISFIT:
        return None
    outliers = np.flatnonzero(find_outliers(case.means, case.white).flagged)
    named = [f"{k} {case.span(int(k))}" for k in outliers]
    farthest = int(np.argmax(np.abs(distances(case.fit, case.means)[0])))
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
