"""All sensors of a log, calibrated from the rests that the accelerometer shows.

The accelerometer's rests are the poses of all. Accelerometer and gyroscope are fitted
together, and so are accelerometer and magnetometer; both fits take the noise of a pose
mean that the residuals show, where that is more than is known of it. A sensor that
cannot be calibrated from this log is left out, and why is said; one that was asked for
is refused.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from simval.arguments import choice
from simval.arrays import Array
from simval.calibrate import (
    FitResult,
    GyroscopeFit,
    ImuFit,
    MagnetometerFit,
    calibrate_imu,
    calibrate_magnetometer,
)
from simval.errors import InputError, RefusedError, SaturatedError
from simval.logs import Log
from simval.multiposition.calibration import LogCalibration, white_noise
from simval.multiposition.compass import compass_pose_noise
from simval.multiposition.pose_noise import PoseNoise
from simval.noise import NoiseFile
from simval.noise.held import rows_to_a_reading
from simval.shapes import Float
from simval.statics import interval_means

T = TypeVar("T")
SENSORS: Final = ("gyroscope", "magnetometer")
"""Beside the accelerometer, without which there are no rests."""

AXES: Final = "xyz"
RAIL: Final = 3
"""Readings in a row at the greatest or least one of an axis that may be a rail."""

KINK: Final = 4.0
"""Steps of the converter by which the rows beside a rail are off it. A round top that
reads the same for L rows is one step lower beside them, times (1 + 2/L)^2 < 3."""

SAME_UNIT: Final = 5.0
"""Ratio of two axes' scales beyond which they are in different units: the nearest two
units in use, standard gravities and m/s^2, differ by 9.8, and no two axes by 2."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuCalibration:
    """Calibration of all sensors of a log.

    Attributes
    ----------
    log : LogCalibration
        The accelerometer's alone, with its rests and its diagnosis.
    accelerometer : FitResult
        The accelerometer's as the gyroscope's moves leave it, else that of `log`.
    gyroscope : GyroscopeFit or None
        Its covariance holds the accelerometer's nine parameters too.
    sensitivity : Array
        What specific force does to the gyroscope, raw units per m/s^2, (3, 3).
    magnetometer : MagnetometerFit or None
        On the axes of the accelerometer, fitted together with it.
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
    magnetometer: MagnetometerFit | None
    reasons: tuple[str, ...]
    left_out: Mapping[str, str]
    compass_noise: PoseNoise | None


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
            left_out[name] = str(error)
            return None

    imu = tried("gyroscope", lambda samples: _gyroscope(log, result, samples))
    compass = tried(
        "magnetometer",
        lambda samples: _magnetometer(log, result, samples, hemisphere, field, noise),
    )
    return ImuCalibration(
        log=result,
        accelerometer=result.fit if imu is None else imu.accelerometer,
        gyroscope=None if imu is None else imu.gyroscope,
        sensitivity=np.zeros((3, 3)) if imu is None else imu.G,
        magnetometer=None if compass is None else compass[0],
        compass_noise=None if compass is None else compass[1],
        reasons=() if imu is None else imu.reasons,
        left_out=left_out,
    )


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
