"""Whether a log is one of a sound sensor, and why a log was refused.

`require_sound` is asked of every calibration of a log, `explained` of every refusal:
a cause that can be named (`log_faults`, `log_breaks`, poses that do not belong) says
more than the geometry it has ruined.
"""

from functools import partial

import numpy as np
from scipy import special

from simval.calibrate import Diagnosis, FitResult, calibrate
from simval.calibrate.deletion import LEFT
from simval.calibrate.outliers import find_outliers
from simval.errors import (
    ConvergenceError,
    RefusedError,
    SaturatedError,
    SimvalError,
)
from simval.logs import Log
from simval.poses import PARAMETERS
from simval.statics import Intervals
from simval.studies import log_breaks, log_faults
from simval.studies.log_breaks import Detector
from simval.studies.log_rests import Rests, rests_of

# Of gravity. Real holds leave some 1e-3 (the recordings in docs/calibration.md 1e-4 to
# 3e-3), and what is left here says that the readings are not those of gravity at rest.
_MISFIT = 0.02
_RARELY = 0.05  # chance that a scatter beyond the limit leaves as little as is seen
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
    misfit = float(fit.rms) / fit.g
    scale = np.diagonal(fit.matrix)
    checks = (
        partial(log_faults.constant_axis, rests),
        partial(log_faults.zero_rows, rests),
        partial(log_faults.frozen, rests),
        partial(log_faults.spikes, rests),
        partial(log_faults.repeated, rests),
        partial(log_faults.flat_axis, rests, scale, misfit),
        partial(log_breaks.wrapped, log, misfit, fit.g, detect),
        partial(log_breaks.other_unit, rests, fit, detect),
        partial(log_breaks.changed, rests),
        partial(log_breaks.stepped, rests, diagnosis.chi2_per_dof),
    )
    for check in checks:
        said = check()
        if said is not None:
            msg = f"{log.path}: {said}"
            raise RefusedError(msg)
    dof = len(intervals) - PARAMETERS
    if dof < _TELLING and log_breaks.beyond_noise(diagnosis.chi2_per_dof, dof):
        msg = f"{log.path}: {_undecided(len(intervals), diagnosis)}"
        raise RefusedError(msg)
    possible = misfit
    if log_breaks.beyond_noise(diagnosis.chi2_per_dof, dof):
        possible *= np.sqrt(len(intervals) / special.chdtri(dof, 1.0 - _RARELY))
    if not max(misfit, possible) <= _MISFIT:
        msg = f"{log.path}: {_misfit(rests, misfit, possible, diagnosis)}"
        raise RefusedError(msg)


def explained(log: Log, refusal: RefusedError, g: float, detect: Detector) -> Exception:
    """Return the refusal, or one that names the fault behind it."""
    try:
        intervals = detect(log, PARAMETERS)
    except SimvalError:
        intervals = np.empty((0, 2), dtype=np.intp)
    rests = rests_of(log, intervals)
    checks = [
        partial(log_faults.constant_axis, rests),
        partial(log_faults.zero_rows, rests),
        partial(log_breaks.wrapped, log, np.inf, g, detect),
    ]
    if len(intervals):
        checks.append(partial(log_faults.frozen, rests))
    # what a saturated rest has spoilt is not its own fault
    if len(intervals) and not isinstance(refusal, SaturatedError):
        checks += [
            partial(log_faults.repeated, rests),
            partial(log_faults.flat_axis, rests),
            partial(log_breaks.other_unit, rests, None, detect),
            partial(log_breaks.changed, rests),
            partial(log_breaks.stepped, rests),
            partial(_healing, rests, g),
        ]
    for check in checks:
        said = check()
        if said is not None:
            return RefusedError(f"{log.path}: {said}")
    if isinstance(refusal, ConvergenceError):
        return ConvergenceError(
            f"{log.path}: the fit to {len(intervals)} rests did not settle: they "
            "hardly fix an ellipsoid, or are not all of gravity; hold the sensor in "
            "more poses all over the sphere, and check the columns, the wiring and "
            "the units of each axis"
        )
    return refusal


def _healing(rests: Rests, g: float) -> str | None:
    # outliers without which the log calibrates
    found = find_outliers(rests.means)
    if not found.flagged.any():
        return None
    try:
        calibrate(rests.means[~found.flagged], g).require_converged()
    except SimvalError:
        return None
    which = [
        f"{k} {rests.span(int(k))} ({abs(found.standardized[k]):.3g} standard "
        "deviations off)"
        for k in np.flatnonzero(found.flagged)
    ]
    return (
        f"rest {', rest '.join(which)} does not lie on the ellipsoid of the others, "
        "and without it they calibrate; look at that hold, cut it out of the log and "
        "calibrate again"
    )


def _misfit(rests: Rests, misfit: float, possible: float, diagnosis: Diagnosis) -> str:
    named = [f"{k} {rests.span(k)}" for k in diagnosis.outliers]
    what = (
        f"rest {', rest '.join(named)} does not lie on the ellipsoid of the others; "
        "cut it out of the log and calibrate again"
        if named
        else "axes, units, wiring and range are to be checked, and the sensor held "
        f"still; the rest farthest off is the one {rests.span(_farthest(diagnosis))}"
    )
    return (
        f"the rests miss gravity by {100.0 * misfit:.2g} % (root mean square), what is "
        f"behind it may be {100.0 * possible:.2g} % with so many rests, and at most "
        f"{100.0 * _MISFIT:g} % is accepted: these are not readings of gravity on "
        f"three axes; {what}"
    )


def _undecided(count: int, diagnosis: Diagnosis) -> str:
    return (
        f"the residuals of {count} rests are {np.sqrt(diagnosis.chi2_per_dof):.1f} "
        "times what their noise explains, and so few rests do not tell a hold that "
        "moved from a sensor that changed, which would make every number wrong; "
        f"record at least {PARAMETERS + _TELLING} rests, better 20"
    )


def _farthest(diagnosis: Diagnosis) -> int:
    return int(np.argmax(np.abs(diagnosis.distance)))
