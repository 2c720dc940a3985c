"""Whether a log comes from a sound sensor, and why a log was refused.

Every calibration of a log goes through `require_sound`, every refusal through
`explained`: a cause that can be named (`faults`, poses that do not belong)
says more than the geometry it has ruined.
"""

from collections.abc import Iterator

import numpy as np
import scipy

from simval.errors import (
    ConvergenceError,
    RefusedError,
    SaturatedError,
    SimvalError,
)
from simval.imu.calibrate import Diagnosis, FitResult, calibrate
from simval.imu.calibrate.evidence import REPEATS, STATE_NOISE
from simval.imu.calibrate.gyroscope.result import START
from simval.imu.calibrate.outliers import LEFT, find_outliers
from simval.imu.logs import Log
from simval.imu.multiposition import faults
from simval.imu.multiposition.faults import MISFIT, Detector
from simval.imu.multiposition.rests import Rests, rests_of
from simval.imu.statics import Intervals
from simval.poses import PARAMETERS

_RARELY = 0.05  # chance that a scatter beyond the limit leaves as little as is seen
_OF_A_LOG = {
    STATE_NOISE: "measure it in a long rest (simval noise LOG --json > noise.json) and "
    "give that file (--noise noise.json)",
    REPEATS: "or cut the log before it repeats",
    START: "",
}
# Degrees of freedom: one for the least step, and two to tell it by.
_TELLING = LEFT + 1


def require_sound(
    log: Log,
    fit: FitResult,
    intervals: Intervals,
    diagnosis: Diagnosis,
    detect: Detector,
) -> None:
    """Refuse a calibration whose log shows a fault.

    Raises
    ------
    RefusedError
        That names the axis, the time and the remedy.
    """
    rests = rests_of(log, intervals)
    reasons = _reasons(rests, fit, diagnosis, detect)
    reason = next((words for words in reasons if words is not None), None)
    if reason is not None:
        msg = f"{log.path}: {reason}"
        raise RefusedError(msg)


def _reasons(
    rests: Rests, fit: FitResult, diagnosis: Diagnosis, detect: Detector
) -> Iterator[str | None]:
    # one after the other, since each costs time
    misfit = float(fit.rms) / fit.g
    yield faults.constant_axis(rests)
    yield faults.zero_rows(rests)
    yield faults.frozen(rests)
    yield faults.spikes(rests)
    yield faults.repeated(rests)
    yield faults.flipped(rests, fit.g, diagnosis.chi2_per_dof)
    yield faults.flat_axis(rests, np.diagonal(fit.matrix), misfit)
    yield faults.wrapped(rests.log, misfit, fit.g, detect)
    yield faults.other_unit(rests, fit, detect)
    yield faults.changed(rests)
    yield faults.stepped(rests, diagnosis.chi2_per_dof)
    yield _undecided(diagnosis, len(rests.means))
    yield _no_gravity(rests, misfit, diagnosis)


def explained(log: Log, refusal: RefusedError, g: float, detect: Detector) -> Exception:
    """Return the refusal, or one that names the fault behind it."""
    try:
        intervals = detect(log, PARAMETERS)
    except SimvalError:
        intervals = np.empty((0, 2), dtype=np.intp)
    saturated = isinstance(refusal, SaturatedError)
    causes = _causes(rests_of(log, intervals), g, detect, saturated)
    cause = next((words for words in causes if words is not None), None)
    if cause is not None:
        return RefusedError(f"{log.path}: {cause}")
    if isinstance(refusal, ConvergenceError):
        return ConvergenceError(
            f"{log.path}: the fit to {len(intervals)} rests did not converge: they "
            "hardly fix an ellipsoid, or are not all of gravity; hold the sensor in "
            "more poses all over the sphere, and check the columns, the wiring and "
            "the units of each axis"
        )
    return type(refusal)(of_a_log(str(refusal)))


def of_a_log(words: str) -> str:
    """What a caller with a log can do, for what one with poses or moves can."""
    for ours, theirs in _OF_A_LOG.items():
        words = words.replace(ours, theirs)
    return words


def _causes(
    rests: Rests, g: float, detect: Detector, saturated: bool
) -> Iterator[str | None]:
    yield faults.constant_axis(rests)
    yield faults.zero_rows(rests)
    yield faults.wrapped(rests.log, np.inf, g, detect)
    if len(rests.means) == 0:
        return
    yield faults.frozen(rests)
    if saturated:  # what it has spoilt is no fault by itself
        return
    yield faults.repeated(rests)
    yield faults.flat_axis(rests)
    yield faults.other_unit(rests, None, detect)
    yield faults.flipped(rests, g)
    yield faults.changed(rests)
    yield faults.stepped(rests)
    yield _healing(rests, g)


def _healing(rests: Rests, g: float) -> str | None:
    # outliers without which the log calibrates
    outliers = find_outliers(rests.means)
    if not outliers.flagged.any():
        return None
    try:
        calibrate(rests.means[~outliers.flagged], g).require_converged()
    except SimvalError:
        return None
    named = [
        f"{k} {rests.span(int(k))} ({abs(outliers.standardized[k]):.3g} standard "
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


def _undecided(diagnosis: Diagnosis, count: int) -> str | None:
    # too few rests to name what their residuals show
    dof = count - PARAMETERS
    if dof >= _TELLING or not faults.beyond_noise(diagnosis.chi2_per_dof, dof):
        return None
    return (
        f"the residuals of {count} rests are {np.sqrt(diagnosis.chi2_per_dof):.1f} "
        "times what their noise explains, and so few rests do not tell a hold that "
        "moved from a sensor that changed, which would make every number wrong; "
        f"record at least {PARAMETERS + _TELLING} rests, better 20"
    )


def _no_gravity(rests: Rests, misfit: float, diagnosis: Diagnosis) -> str | None:
    # residuals too large, or that may come from a scatter that is
    count, possible = len(rests.means), misfit
    dof = count - PARAMETERS
    if faults.beyond_noise(diagnosis.chi2_per_dof, dof):
        possible *= np.sqrt(count / scipy.special.chdtri(dof, 1.0 - _RARELY))
    if max(misfit, possible) <= MISFIT:
        return None
    named = [f"{k} {rests.span(k)}" for k in diagnosis.outliers]
    farthest = int(np.argmax(np.abs(diagnosis.distance)))
    what = (
        f"{_off(named)}; cut {'it' if len(named) == 1 else 'them'} out of the log and "
        "calibrate again"
        if named
        else "check axes, units, wiring and range, and hold the sensor still; the rest "
        f"that is farthest off is the one {rests.span(farthest)}"
    )
    return (
        f"the rests miss gravity by {100.0 * misfit:.2g} % (root mean square), with so "
        f"many rests {100.0 * possible:.2g} % may be behind it, and at most "
        f"{100.0 * MISFIT:g} % is accepted: these are not readings of gravity on "
        f"three axes; {what}"
    )
