r"""Calibrate all sensors of a log: accelerometer, gyroscope and magnetometer.

**All sensors of a log, calibrated from the rests that the accelerometer shows.**

The accelerometer's rests are the poses of all. Accelerometer and gyroscope are fitted
together, and so are accelerometer and magnetometer; both fits take the noise of a pose
mean that the residuals show, where that is more than is known of it. Where there are
all three, one fit of all begins with these two. A sensor that cannot be calibrated from
this log is left out, and why is said; one that was asked for is refused.

**Noise of single readings, in SI units and the axes of the calibration.**

What ROS's ``sensor_msgs/Imu`` carries: with M the matrix of a sensor and
:math:`\sigma_k` the white noise of a reading on its axis k, the covariance of a
corrected reading is :math:`M\,\mathrm{diag}(\sigma^2)\,M^T`, row by row.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

import numpy as np

from simval.arguments import choice
from simval.arrays import Array
from simval.errors import InputError, RefusedError, SaturatedError
from simval.imu.calibrate import (
    FitResult,
    GyroscopeFit,
    ImuFit,
    MagnetometerFit,
    NineAxisFit,
)
from simval.imu.calibrate.gyroscope.imu import variance_within
from simval.imu.logs import Log
from simval.imu.multiposition.calibration import LogCalibration, white_noise
from simval.imu.multiposition.description import log_lines, sensor_lines
from simval.imu.multiposition.health import of_a_log
from simval.imu.multiposition.noise import PoseNoise, compass_pose_noise
from simval.imu.noise import NoiseFile
from simval.imu.noise.fit import rows_to_a_reading
from simval.imu.statics import Intervals, interval_means
from simval.poses import PARAMETERS
from simval.shapes import Float

AXES: Final = "xyz"
RAIL: Final = 3
"""Readings in a row at the greatest or least reading of an axis that may be a rail."""

KINK: Final = 4.0
"""Steps of the converter by which the rows beside a rail are off it. A round top that
reads the same for L rows is one step lower beside them, times (1 + 2/L)^2 < 3."""

SAME_UNIT: Final = 5.0
"""Ratio of two axes' scales beyond which they are in different units: the nearest two
units in use, standard gravities and m/s^2, differ by 9.8, and no two axes by 2."""


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


T = TypeVar("T")
SENSORS: Final = ("gyroscope", "magnetometer")
"""Beside the accelerometer, without which there are no rests."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuCalibration:
    """Calibration of all sensors of a log.

    Attributes
    ----------
    log : LogCalibration
        The accelerometer's alone, with its rests and its diagnosis.
    accelerometer : FitResult
        The accelerometer's as the fit with the other sensors leaves it, else that of
        `log`.
    gyroscope : GyroscopeFit or None
        Its covariance holds the accelerometer's nine parameters too.
    sensitivity : Array
        What specific force does to the gyroscope, raw units per m/s^2, (3, 3).
    sensitivity_sd : Array
        Standard deviation of each entry of it, (3, 3).
    magnetometer : MagnetometerFit or None
        On the axes of the accelerometer, fitted together with it.
    together : NineAxisFit or None
        The one fit that all of these are of, where there are three sensors.
    reasons : tuple of str
        What was chosen by evidence, and why.
    left_out : mapping of str to str
        Sensors of the log that are not calibrated, and why.
    compass_noise : PoseNoise or None
        Noise of the magnetometer's pose means, and where it comes from.
    """

    log: LogCalibration
    accelerometer: FitResult
    gyroscope: GyroscopeFit | None
    sensitivity: Float[Array, "3 3"]
    sensitivity_sd: Float[Array, "3 3"]
    magnetometer: MagnetometerFit | None
    together: NineAxisFit | None
    reasons: tuple[str, ...]
    left_out: Mapping[str, str]
    compass_noise: PoseNoise | None

    def __str__(self) -> str:
        return "\n".join(log_lines(self.log, self) + sensor_lines(self))


def calibrate_sensors(
    log: Log,
    result: LogCalibration,
    *,
    sensors: Sequence[str] | None = None,
    hemisphere: str = "unstated",
    field: float = 1.0,
    noise: NoiseFile | None = None,
) -> ImuCalibration:
    """Calibrate the other sensors of a log whose accelerometer is calibrated.

    Parameters
    ----------
    log : Log
        The log.
    result : LogCalibration
        As from `calibrate_log`.
    sensors : sequence of str or None
        Out of ``gyroscope`` and ``magnetometer``, those that must be calibrated; None
        takes those that the log has and leaves out what cannot be.
    hemisphere : {"unstated", "north", "south"}
        Where the log was made, which the magnetometer's axes cannot tell.
    field : float
        Strength of the field, in the unit that the magnetometer's M is wanted in.
    noise : NoiseFile or None
        Where it has a magnetometer, its noise; None, or one without, takes it from the
        log's longest rest, and white noise alone where that is too short.

    Returns
    -------
    ImuCalibration
        The calibrations, and what was left out.

    Raises
    ------
    InputError
        If a sensor is unknown, or asked for and not in the log.
    RefusedError
        If a sensor that was asked for cannot be calibrated from this log.
    """
    asked = (
        None if sensors is None else [choice("sensors", s, SENSORS) for s in sensors]
    )
    rows = {"gyroscope": log.gyro, "magnetometer": log.magnetometer}
    left_out: dict[str, str] = {}

    def tried(name: str, calibrate: Callable[[Float[Array, "n 3"]], T]) -> T | None:
        samples = rows[name]
        if asked is not None and name not in asked:
            return None
        if samples is None:
            if asked is not None:
                raise InputError(_absent(log, name))
            return None
        try:
            require_alive(log, name, samples)
            return calibrate(samples)
        except RefusedError as error:
            if asked is not None:
                raise
            left_out[name] = of_a_log(str(error))
            return None

    imu = tried("gyroscope", lambda samples: _gyroscope(log, result, samples))
    compass = tried(
        "magnetometer",
        lambda samples: _magnetometer(log, result, samples, hemisphere, field, noise),
    )
    found = ImuCalibration(
        log=result,
        accelerometer=result.fit if imu is None else imu.accelerometer,
        gyroscope=None if imu is None else imu.gyroscope,
        sensitivity=np.zeros((3, 3)) if imu is None else imu.G,
        sensitivity_sd=np.zeros((3, 3)) if imu is None else imu.G_sd,
        magnetometer=None if compass is None else compass[0],
        together=None,
        compass_noise=None if compass is None else compass[1],
        reasons=() if imu is None else (*imu.reasons, *imu.gyroscope.noise.sentences),
        left_out=left_out,
    )
    if imu is None or compass is None or log.magnetometer is None:
        return found
    return _all(found, imu, compass, log.magnetometer)


def _all(
    found: ImuCalibration,
    imu: ImuFit,
    compass: tuple[MagnetometerFit, PoseNoise],
    samples: Float[Array, "n 3"],
) -> ImuCalibration:
    # the three sensors as one fit has them, or two and two as they are
    from simval.imu.calibrate import calibrate_nine_axis
    from simval.imu.calibrate.gyroscope.imu import joined

    fields, reduced = interval_means(samples, found.log.intervals), imu.reduced
    try:
        fit = calibrate_nine_axis(
            reduced.moves, reduced.poses, fields, imu.gyroscope, compass[0],
            pose_std=reduced.pose_std, field_std=compass[1].std,
            angle_random_walk=reduced.angle_random_walk,
            bias_random_walk=reduced.bias_random_walk,
            known_bias=reduced.known_bias, bias_std=reduced.bias_std,
        ).require_converged()  # fmt: skip
    except RefusedError as error:
        said = f"the three sensors are not fitted together: {error}"
        return replace(found, reasons=(*found.reasons, said))
    own = fit.gyroscope
    return replace(
        found,
        accelerometer=joined(
            imu.accelerometer, own.accelerometer, own.covariance[:9, :9],
            imu.reduced.poses,
        ),
        gyroscope=own,
        magnetometer=fit.magnetometer,
        together=fit,
        reasons=(*imu.reasons, *fit.noise.sentences),
    )  # fmt: skip


def _absent(log: Log, name: str) -> str:
    letter = name[0].replace("g", "w")
    return (
        f"{log.path} has no {name}, which is asked for; name its columns: --columns "
        f"with {letter}x, {letter}y and {letter}z"
    )


def pose_std(result: LogCalibration) -> Float[Array, " m"]:
    """Noise of each pose mean: what is known of it, or what the residuals show."""
    excess = result.diagnosis.chi2_per_dof
    grown = np.sqrt(excess) if excess > 1.0 else 1.0  # NaN is no excess
    return np.asarray(result.pose_noise.std * grown)


def _gyroscope(
    log: Log, result: LogCalibration, samples: Float[Array, "n 3"]
) -> ImuFit:
    if result.turns:
        msg = (
            f"it turns in {len(result.cuts)} of the {len(result.intervals)} rests of "
            f"the accelerometer, and {PARAMETERS} in which both are still are needed; "
            "record more rests in which nothing turns"
        )
        raise RefusedError(msg)
    # axes of different units make any move look blind to the one with small numbers
    try:
        return _joint(log, result, samples)
    except RefusedError as error:
        size = samples.std(axis=0)
        try:
            alike = _joint(log, result, samples / size).gyroscope.M
        except RefusedError:
            raise error from None
        require_one_unit(log, "gyroscope", alike / size)
        raise


def _joint(log: Log, result: LogCalibration, samples: Float[Array, "n 3"]) -> ImuFit:
    # both sensors together
    from simval.imu.calibrate import calibrate_imu

    fit = calibrate_imu(
        log.time,
        log.accelerometer,
        samples,
        result.intervals,
        g=result.fit.g,
        model=result.fit.model,
        pose_std=pose_std(result),
    )
    require_one_unit(log, "gyroscope", fit.gyroscope.require_converged().M)
    return fit


def _magnetometer(
    log: Log,
    result: LogCalibration,
    samples: Float[Array, "n 3"],
    hemisphere: str,
    field: float,
    known: NoiseFile | None,
) -> tuple[MagnetometerFit, PoseNoise]:
    from simval.imu.calibrate import calibrate_magnetometer

    middle = result.intervals.sum(axis=1) // 2
    white = white_noise(samples, result.intervals)
    noise = compass_pose_noise(log, samples, result.intervals, white, known)
    fit = calibrate_magnetometer(
        interval_means(log.accelerometer, result.intervals),
        interval_means(samples, result.intervals),
        result.fit.g,
        field,
        accelerometer_std=pose_std(result),
        magnetometer_std=noise.std,
        hemisphere=hemisphere,
        model=result.fit.model,
        time=log.time[middle],
    ).require_converged()
    require_one_unit(log, "magnetometer", fit.M)
    return fit, noise


def message_covariances(log: Log, whole: ImuCalibration) -> dict[str, Any]:
    """Fields of a message: nine numbers each; -1 first where nothing is known."""
    unknown = [-1.0] + [0.0] * 8
    rests = whole.log.intervals
    force = whole.accelerometer.sensor().matrix
    rate = unknown
    if whole.gyroscope is not None and log.gyro is not None:
        rate = _covariance(log.gyro, rests, whole.gyroscope.M)
    return {
        "orientation_covariance": unknown,
        "angular_velocity_covariance": rate,
        "linear_acceleration_covariance": _covariance(log.accelerometer, rests, force),
    }


def _covariance(
    samples: Float[Array, "n 3"], rests: Intervals, M: Float[Array, "3 3"]
) -> list[float]:
    return (M * variance_within(samples, rests) @ M.T).ravel().tolist()
