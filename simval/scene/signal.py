"""A test signal for any calibrator: an IMU's readings beside the truth."""

from os import PathLike
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.scene.rates import average_rates
from simval.scene.trajectory import Trajectory
from simval.sensor import ImuReadings, Motion
from simval.shapes import Float

TRUTH = (
    "true t [s],true fx [m/s^2],true fy [m/s^2],true fz [m/s^2],"
    "true wx [rad/s],true wy [rad/s],true wz [rad/s],"
    "true instant wx [rad/s],true instant wy [rad/s],true instant wz [rad/s],"
    "true mx [T],true my [T],true mz [T],qx,qy,qz,qs,rest"
)
SENSORS = (("a", "m/s^2"), ("w", "rad/s"), ("m", "T"))


def motion_of(trajectory: Trajectory, every: int = 1) -> Motion:
    """What the sensors of an IMU are to measure in a run, each of so many rows.

    The rate is the average over the step that ends at a row, and over all steps since
    the row before that is kept.
    """
    return Motion(
        time=trajectory.time[::every],
        specific_force=trajectory.specific_force[::every],
        rate=average_rates(trajectory, every),
        field=trajectory.magnetic_field[::every],
    )


def write_signal(
    path: str | PathLike[str],
    trajectory: Trajectory,
    readings: ImuReadings | None = None,
    every: int = 1,
) -> None:
    """Write a run as comma-separated text, one row of one instant each.

    Columns: the time stamp; readings of accelerometer, gyroscope and magnetometer, the
    truth where there is no such sensor; the true time, specific force, average rate of
    the step that ends at the row, rate of the instant, and field, in sensor axes; the
    attitude world to sensor, vector first; the index of the rest that the row belongs
    to, -1 for none. ``simval calibrate`` reads the readings by their names, and any
    other calibrator the first columns.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    motion = motion_of(trajectory, every)
    kept = slice(None, None, every)
    table = np.column_stack(
        [
            *(motion.time if readings is None else readings.stamp,),
            *read_or_true(motion, readings),
            motion.time,
            motion.specific_force,
            motion.rate,
            trajectory.angular_velocity[kept],
            motion.field,
            trajectory.attitude[kept],
        ]
    )
    # seventeen digits: a reader gets the same bits
    rests = trajectory.hold[kept].tolist()
    lines = [
        ",".join([f"{value:.17g}" for value in row] + [str(rest)])
        for row, rest in zip(table.tolist(), rests, strict=True)
    ]
    text = "\n".join([header(readings), *lines, ""])
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}"
        raise InputError(msg) from None


def header(readings: ImuReadings | None = None) -> str:
    """Names of the columns; a sensor that is not there reads in units of the truth."""
    real = (
        [False] * 3
        if readings is None
        else [True, readings.gyroscope is not None, readings.magnetometer is not None]
    )
    names = [
        f"{letter}{axis} [{'raw' if there else unit}]"
        for (letter, unit), there in zip(SENSORS, real, strict=True)
        for axis in "xyz"
    ]
    return ",".join(["t [s]", *names, TRUTH])


def read_or_true(
    motion: Motion, readings: ImuReadings | None
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Readings of the three sensors, and the truth of one that is not there."""
    force, rate, field = motion.specific_force, motion.rate, motion.field
    if readings is None:
        return force, rate, field
    gyroscope, magnetometer = readings.gyroscope, readings.magnetometer
    return (
        readings.accelerometer.raw,
        rate if gyroscope is None else gyroscope.raw,
        field if magnetometer is None else magnetometer.raw,
    )
