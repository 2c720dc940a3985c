"""Whether a calibration belongs to the readings it is applied to.

A calibration turns any numbers into some force; only their size tells that they are
of another unit or another sensor. At rest, whatever the pose, the force is g. A log
without a rest says less: the mean of :math:`|f|` is at least that of the mean force in
the world, which is g but for the change of velocity over the time of the log, and
nothing that is carried is shaken at many g from end to end.
"""

import numpy as np

from simval.arrays import Array
from simval.calibrate.result import FitResult, raw_unit
from simval.errors import RefusedError
from simval.shapes import Float

# Another temperature moves a bias by 0.1 g and a scale by 3 %; the least mistake of a
# unit or a range is a factor of 2.
_REST = (0.75, 1.25)
# Mean |f| of a moving log, in g: g for m/s^2 is a factor of 9.8.
_MOVING = (0.75, 8.0)
_WINDOW = 0.5  # s; a hand at rest holds still for as long
_FEWEST = 10  # rows of which a scatter says something
_QUIET = 0.05  # scatter of a window at rest over its mean; a cheap sensor has 0.02


def require_same_sensor(fit: FitResult, raw: Float[Array, "n 3"], rate: float) -> None:
    """Refuse readings whose corrected force cannot be one.

    Raises
    ------
    RefusedError
        If the log's rests are not near g, or, without rests, its mean is far from it.
    """
    force = fit.sensor().correct(raw) / fit.g
    rests = rest_forces(force, rate)
    if rests.size:
        typical, (low, high) = float(np.median(rests)), _REST
        what = f"{rests.size} stretches at rest"
    else:
        typical, (low, high) = float(np.linalg.norm(force, axis=1).mean()), _MOVING
        what = "mean reading, in motion,"
    if low <= typical <= high:
        return
    length = float(np.median(np.linalg.norm(raw, axis=1)))
    msg = (
        f"the log's {what} would become {typical * fit.g:.4g} m/s^2, where "
        f"{low * fit.g:.3g} to {high * fit.g:.3g} is possible: {_made_from(fit)}, and "
        f"the log holds {raw.min():.6g} to {raw.max():.6g} (by size: "
        f"{raw_unit(length)}); give the log in the unit that was calibrated, or the "
        "calibration of this sensor and unit, or --unchecked if the force is real"
    )
    raise RefusedError(msg)


def rest_forces(force: Float[Array, "n 3"], rate: float) -> Float[Array, " m"]:
    """Length of the mean force of each stretch at rest."""
    size = max(_FEWEST, round(_WINDOW * rate))
    count = len(force) // size
    windows = force[: count * size].reshape(count, size, 3)
    means = np.linalg.norm(windows.mean(axis=1), axis=1)
    scatter = np.linalg.norm(windows.std(axis=1), axis=1)
    return np.asarray(means[scatter < _QUIET * means])


def _made_from(fit: FitResult) -> str:
    # what the calibration was made from, or what it reads at rest
    per_g = float(np.mean(np.abs(fit.raw_per_g)))
    unit = f"{fit.raw_unit}, {per_g:.6g} of them for {fit.g:.6g} m/s^2"
    if np.isfinite(fit.raw_range).all():
        ends = f"{fit.raw_range.min():.6g} to {fit.raw_range.max():.6g}"
        return f"the calibration was made from readings of {ends} ({unit})"
    low, high = (fit.B - per_g).min(), (fit.B + per_g).max()
    return (
        f"the calibration is for readings of {low:.6g} to {high:.6g} at rest ({unit})"
    )
