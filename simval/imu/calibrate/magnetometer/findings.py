r"""Warnings about a magnetometer's calibration, to be read before it is used.

**Poses that do not fit the others, and a field that varies with time.**

What leaving the three equations of a pose out takes off chi-square, eq. (O2) of
`goodness_of_fit`, is a chi-square of three where they belong:

.. math:: t_i = c_i^T (W_i^{-1} - J_i (J^T W J)^{-1} J_i^T)^{-1} c_i \sim \chi^2(3).
   \tag{M5}

Poses are left out one by one, the worst first, while it is beyond chance for the worst
of n. A strength of the field that varies as :math:`1 + \kappa(\tau)` adds
:math:`\partial c/\partial \kappa = [0, -2, s]` to the equations of each pose, and is
looked for as a drift of a sensor is, eq. (W1) of `drift`.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from simval.account import Remark
from simval.arrays import Array
from simval.geometry import normalize
from simval.imu.calibrate.drift import Drift, find_drift
from simval.imu.calibrate.equations import Problem, Sensor
from simval.imu.calibrate.gauss_newton import minimize
from simval.imu.calibrate.goodness_of_fit import Deletion, believed_range
from simval.imu.calibrate.magnetometer.covariance import Fitted
from simval.imu.calibrate.magnetometer.result import DIP, IRON
from simval.imu.calibrate.magnetometer.start import ENOUGH
from simval.poses import fibonacci_sphere
from simval.shapes import Float

FALSE_ALARM = 0.01
"""Of a clean set: that a pose of it is named, or that its field is called varying."""


def pose_chi_squares(fit: Fitted) -> Float[Array, " n"]:
    """Chi-square of each pose of one set, eq. (M5); NaN where it has no freedom."""
    count, rows = fit.here.white.shape[1], len(fit.here.rows[0])
    items = np.zeros((count, rows, 3))
    items[:, : 3 * count] = (
        np.eye(3 * count).reshape(3 * count, count, 3).swapaxes(0, 1)
    )
    return Deletion.of(fit.here.slopes[0], fit.here.rows[0], items).drops([])


def drift(fit: Fitted, time: Float[Array, " n"]) -> Drift:
    """Test whether the strength of the field drifts during one set."""
    here, whole = fit.here, np.zeros_like(fit.here.rows[0])
    own = (here.white[0] @ np.array([0.0, -2.0, fit.theta[0, DIP]])).ravel()
    whole[: own.size] = own
    each = np.resize(np.repeat(time, 3), whole.size)
    strength = {"the strength of the field": whole}
    return find_drift(here.rows[0], here.slopes[0], strength, each, known=True)


STRONG_IRON = 0.7
"""Hard iron, of the field: beyond it the field inside the sensor can pass near zero."""
# Of 150 random sets 99 % lose at most 4.6 with 12 poses, 2.0 with 20, 1.6 with 40.
GEOMETRY_LIMIT = 5.0
_NOT_CONVERGED = Remark(
    "not converged",
    "the solver did not converge: the poses hardly fix the parameters",
    "Do not use them; turn and tilt to more sides.",
)
_LEAVE_OUT = "Leave out and calibrate again."
_FEWEST_LEFT = 9  # poses after those that do not fit are left out
_TILTS, _HEADINGS = 24, 5  # attitudes that stand for evenly spread ones


def look(fit: Fitted, time: Float[Array, " n"], iron: float) -> dict[str, Any]:
    """Warnings about one set; its hard iron in units of the field."""
    poses, varies = pose_chi_squares(fit), drift(fit, time)
    steady = not varies.p_value < FALSE_ALARM
    # a pose that is far off bends any curve, and a field that varies puts poses off:
    # the one that lowers chi-square more is reported
    worst: tuple[int, ...] = ()
    rest = 1.0
    if steady or varies.drop < np.nanmax(poses, initial=0.0):
        worst, rest = _left_out(fit)
    remarks = [
        None if fit.converged[0] else _NOT_CONVERGED,
        _few(fit),
        _poses(poses, worst, rest),
        None if steady or worst else _varying(varies),
        _scatter(fit, explained=bool(worst)),
        _iron(iron),
        _geometry(fit),
        _axes(fit),
    ]
    return {
        "pose_chi_square": poses,
        "disturbed": worst,
        "findings": tuple(each for each in remarks if each is not None),
        "steady_p_value": varies.p_value,
    }


def _left_out(fit: Fitted) -> tuple[tuple[int, ...], float]:
    # poses that do not fit the others, and the chi-square by freedom of the others
    whole, count = fit.problem, len(fit.here.white[0])
    kept, out = np.arange(count), list[int]()
    # of three, that the worst of a clean set's poses exceeds by chance
    limit = 2.0 * scipy.special.gammainccinv(1.5, FALSE_ALARM / count)
    while len(kept) > _FEWEST_LEFT and len(out) <= count // 3:
        values = np.nan_to_num(pose_chi_squares(fit))
        worst = int(np.argmax(values))
        if values[worst] <= limit:
            break
        out.append(int(kept[worst]))
        kept = np.delete(kept, worst)
        problem = whole.take(slice(None), kept)
        fit = Fitted.of(problem, minimize(problem, fit.theta, 50).theta)
        if not np.isfinite(fit.covariance).all():
            break
    if len(out) > count // 3:  # then it is no matter of single poses
        return (), np.nan
    return tuple(out), float(fit.chi_square[0] / fit.dof)


def _few(fit: Fitted) -> Remark | None:
    count = fit.problem.accelerometer.readings.shape[1]
    if count >= ENOUGH:
        return None
    words = (
        f"{count} poses leave {fit.dof} degrees of freedom: another calibration may "
        "fit as well, and a pose that does not belong can hide (of random sets of "
        "eight poses one in a hundred went wrong unseen)"
    )
    numbers = {"poses": count, "dof": fit.dof}
    return Remark("few poses", words, f"Take {ENOUGH} or more.", numbers)


def _poses(poses: Array, worst: tuple[int, ...], rest: float) -> Remark | None:
    if not worst:
        return None
    named = ", ".join(f"{k} (chi-square {poses[k]:.3g} of 3)" for k in worst)
    plural = "poses" if len(worst) > 1 else "pose"
    words = (
        f"{plural} {named} not of the same field as the others: iron or a current near "
        "by, a hold that moved, or another unit; without, chi-square per degree of "
        f"freedom is {rest:.2f}"
    )
    numbers = {"poses": list(worst), "chi2_per_dof_without": rest}
    return Remark("poses", words, _LEAVE_OUT, numbers)


def _scatter(fit: Fitted, *, explained: bool) -> Remark | None:
    chi_square = float(fit.chi_square[0])
    low, high = believed_range(fit.dof)
    ratio = chi_square / fit.dof
    if chi_square < low:
        times = float(np.sqrt(ratio))
        words = (
            f"residuals are {times:.2f} times what the noise explains: the noise is "
            "overstated, or the poses are not independent"
        )
        return Remark("noise", words, numbers={"times": times})
    if chi_square <= high or explained:
        return None
    gravity, strength, dip = _sizes(fit)
    words = (
        f"the field is disturbed: chi-square per degree of freedom is {ratio:.2f}, and "
        f"no few poses explain it; the dip of the poses varies by {dip:.2g} degrees "
        f"rms, the strength of the field by {strength:.2g} percent and gravity by "
        f"{gravity:.2g} percent; by the noise that was stated the error bars would be "
        f"{np.sqrt(ratio):.1f} times too small"
    )
    numbers = {
        "chi2_per_dof": ratio, "dip_degrees": dip, "strength_percent": strength,
        "gravity_percent": gravity,
    }  # fmt: skip
    return Remark("disturbed", words, "Record away from iron and currents.", numbers)


def _sizes(fit: Fitted) -> tuple[float, float, float]:
    # the raw sizes of the three equations: percent of gravity and of the field, degrees
    sine = fit.theta[0, DIP]
    up, field = (each.w[0] for each in fit.here.at.values())
    lengths = np.linalg.norm(up, axis=1), np.linalg.norm(field, axis=1)
    cosine = np.clip(np.vecdot(up, field) / (lengths[0] * lengths[1]), -1.0, 1.0)
    angle = np.degrees(np.arcsin(-cosine) - np.arcsin(sine))
    off = (*(100.0 * (each - 1.0) for each in lengths), angle)
    gravity, strength, dip = (float(np.sqrt(np.mean(x * x))) for x in off)
    return gravity, strength, dip


def _varying(found: Drift) -> Remark:
    percent = 100.0 * found.span
    words = (
        f"{found.what} varies with time, by {percent:.2g} percent over the poses "
        f"(chance shows as much in {found.p_value:.1g} of steady fields): a current, "
        "warming, or iron that moves"
    )
    do = "Calibrate with everything switched as it will be in use."
    numbers = {"percent": percent, "p_value": float(found.p_value)}
    return Remark("varies", words, do, numbers)


def _iron(iron: float) -> Remark | None:
    if not iron > STRONG_IRON:
        return None
    words = (
        f"the hard iron is {iron:.2f} times the field, beyond {STRONG_IRON:g}: a "
        "magnet or a strong current near the sensor, whose part may change"
    )
    return Remark("iron", words, "Move the sensor away from it.", {"times": iron})


def _geometry(fit: Fitted) -> Remark | None:
    own, even = fit.natural[0], even_sd(fit)
    loss = float(np.max(own[12:] / even[12:]))
    if loss <= GEOMETRY_LIMIT:
        return None
    words = (
        f"the geometry is the limit: the worst error bar is {loss:.0f} times that of "
        "as many poses turned to all sides"
    )
    do = "Add poses in directions not yet covered."
    return Remark("geometry", words, do, {"times": loss})


def even_sd(fit: Fitted) -> Float[Array, "25"]:
    """Error bars in natural sizes of as many poses, spread evenly."""
    directions = even_poses(np.clip(fit.theta[0, DIP], -1.0, 1.0))
    given = fit.problem.sensors
    at = fit.here.at
    even: list[Sensor] = []
    for sensor, along, bias in zip(given, directions, (slice(6, 9), IRON), strict=True):
        x = along @ np.linalg.inv(at[sensor.name].matrix[0]).T + fit.theta[0, bias]
        std = np.full((1, *x.shape), 1.0 / np.sqrt(np.mean(sensor.std**-2.0)))
        even.append(replace(sensor, readings=x[None], std=std))
    # the information of many is shared out; a prior, which is not, is left out
    count, few = len(directions[0]), given[0].readings.shape[1]
    stated = Fitted.of(Problem(sensors=tuple(even)), fit.theta)
    return stated.natural[0] * np.sqrt(count / few)


def even_poses(sine: float) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Up and field directions in poses that are spread evenly."""
    up = np.repeat(fibonacci_sphere(_TILTS), _HEADINGS, axis=0)
    # the heading turns on from tilt to tilt by the golden angle
    angle = np.arange(len(up)) * (2.0 * np.pi / _HEADINGS + np.pi * (3.0 - 5.0**0.5))
    side = normalize(np.cross(up, np.roll(np.eye(3)[np.abs(up).argmin(1)], 1, axis=1)))
    turned = np.cross(up, side)
    level = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * turned
    return up, np.sqrt(1.0 - sine**2) * level - sine * up


def _axes(fit: Fitted) -> Remark | None:
    right = np.linalg.det(fit.here.at["magnetometer"].matrix[0]) > 0.0
    if right:
        return None
    words = (
        "the axes of the magnetometer are left-handed (det M < 0), as the hemisphere "
        "says"
    )
    do = "If that is not in its data sheet, check the sign of a column."
    return Remark("axes", words, do)
