"""Faults that change in the course of a log, see `simval.imu.multiposition.faults`.

A counter that wraps, a gain, a sign or a unit that changes look sound row by row: what
gives them away is that undoing the change, or leaving a part out, makes the residuals
vanish.
"""

from dataclasses import replace

import numpy as np

from simval.arrays import Array
from simval.errors import SimvalError
from simval.imu.calibrate import calibrate
from simval.imu.calibrate.drift import find_break, find_step
from simval.imu.calibrate.goodness_of_fit import BELIEVED, BEYOND, chi_square_chance
from simval.imu.calibrate.outliers import find_outliers
from simval.imu.multiposition.rests import AXES, MISFIT, Case
from simval.imu.statics import interval_means
from simval.poses import PARAMETERS
from simval.shapes import Float

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
            repeats=True,
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
    step = find_step(case.means)
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
