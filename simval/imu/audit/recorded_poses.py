"""A simulated IMU from files: a log, and poses in the log or in a separate file."""

from typing import NamedTuple

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.geometry import conjugate
from simval.imu.audit.simulated import SimulatedImu
from simval.imu.logs import Log, Truth
from simval.shapes import Float
from simval.units import OF_A_LOG
from simval.vocabulary import PoseTurns


class Poses(NamedTuple):
    """Recorded poses of a body, as `SimulatedImu` takes them."""

    time: Float[Array, " m"]
    position: Float[Array, "m 3"]
    attitude: Float[Array, "m 4"]


def poses_of(truth: Truth, position: Float[Array, "m 3"], turns: PoseTurns) -> Poses:
    """Read recorded poses, leaving out rows that have none.

    A quaternion whose scalar part is not named is taken to have it first.
    """
    q = truth.components
    q = q if truth.scalar == "last" else np.roll(q, -1, axis=1)
    there = np.isfinite(q).all(axis=1) & np.isfinite(position).all(axis=1)
    q = q[there] if turns == "body-to-world" else conjugate(q[there])
    return Poses(truth.time[there], position[there], q)


def simulated(log: Log, poses: Poses, source: str) -> SimulatedImu:
    """Readings of a log in SI units, with the recorded poses."""
    time, within = log.time, poses.time
    inside = (time >= within[0]) & (time <= within[-1])
    if not inside.any():
        msg = (
            f"the log is of {time[0]:.3f} to {time[-1]:.3f} s and its poses of "
            f"{within[0]:.3f} to {within[-1]:.3f} s; give both on one clock"
        )
        raise InputError(msg)
    force, gyro = log.accelerometer if log.has_force else None, log.gyro
    units = OF_A_LOG["accelerometer"], OF_A_LOG["gyro"]
    if force is not None:
        force = force[inside] * units[0].get(log.unit("force"), 1.0)
    if gyro is not None:
        gyro = gyro[inside] * units[1].get(log.unit("gyro"), 1.0)
    return SimulatedImu(
        time=time[inside], pose_time=within, position=poses.position,
        attitude=poses.attitude, gyroscope=gyro, accelerometer=force, source=source,
    )  # fmt: skip
