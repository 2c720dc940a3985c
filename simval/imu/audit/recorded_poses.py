"""A simulated IMU from files: a log, and poses in it or in a file of their own."""

from typing import Final

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.geometry import conjugate
from simval.imu.audit.simulated import SimulatedImu
from simval.imu.logs import Log, Truth
from simval.imu.logs.names import Measurand
from simval.shapes import Float
from simval.units import OF_A_LOG
from simval.vocabulary import PoseTurns

_SENSORS: Final[dict[str, tuple[Measurand, str]]] = {
    "accelerometer": ("force", "accelerometer"), "gyroscope": ("gyro", "gyro"),
}  # fmt: skip


def simulated(
    log: Log, truth: Truth, position: Float[Array, "m 3"], turns: PoseTurns, source: str
) -> SimulatedImu:
    """Readings of a log in SI units, by its header, beside poses.

    Rows without a pose are left out. A quaternion whose scalar part is not named is
    taken to have it first.
    """
    q = truth.components
    q = q if truth.scalar == "last" else np.roll(q, -1, axis=1)
    there = np.isfinite(q).all(axis=1) & np.isfinite(position).all(axis=1)
    q = q[there] if turns == "body-to-world" else conjugate(q[there])
    rows = {"accelerometer": log.accelerometer if log.has_force else None,
            "gyroscope": log.gyro}  # fmt: skip
    readings = {
        name: value * OF_A_LOG[unit].get(log.unit(kind), 1.0)
        for name, (kind, unit) in _SENSORS.items()
        if (value := rows[name]) is not None
    }
    time, poses = log.time, truth.time[there]
    inside = (time >= poses[0]) & (time <= poses[-1])
    if not inside.any():
        msg = (
            f"the log is of {time[0]:.3f} to {time[-1]:.3f} s and its poses of "
            f"{poses[0]:.3f} to {poses[-1]:.3f} s; give both on one clock"
        )
        raise InputError(msg)
    return SimulatedImu(
        time=time[inside], pose_time=poses, position=position[there], attitude=q,
        source=source, **{name: value[inside] for name, value in readings.items()},
    )  # fmt: skip
