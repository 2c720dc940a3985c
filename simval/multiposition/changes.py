"""What changes in the course of a log: a counter that wraps, a gain, a sign, a unit.

Such a log looks sound row by row; what gives it away is that undoing the change, or
leaving a part out, makes the residuals vanish.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from simval.arrays import Array
from simval.calibrate import FitResult, calibrate
from simval.calibrate.drift import find_break, find_step
from simval.calibrate.outliers import (
    BELIEVED,
    BEYOND,
    chi_square_chance,
    find_outliers,
)
from simval.errors import SimvalError
from simval.logs import Log
from simval.multiposition.faults import AXES, MISFIT
from simval.multiposition.rests import Rests
from simval.poses import PARAMETERS
from simval.shapes import Float
from simval.statics import Intervals, interval_means

Detector = Callable[[Log, int], Intervals]  # the rests of a log, at least so many

# What these bounds let pass and catch of 570 bad logs is
# held by tests/test_log_faults.py.
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
