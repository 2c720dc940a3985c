"""A test signal for any calibrator: distorted readings beside the truth."""

from os import PathLike
from pathlib import Path

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.scene.trajectory import Trajectory
from simval.shapes import Float

HEADER = (
    "t [s],ax [raw],ay [raw],az [raw],"
    "fx [m/s^2],fy [m/s^2],fz [m/s^2],wx [rad/s],wy [rad/s],wz [rad/s],"
    "mx [T],my [T],mz [T],qx,qy,qz,qs,rest"
)


def write_signal(
    path: str | PathLike[str],
    trajectory: Trajectory,
    raw: Float[Array, "n 3"] | None = None,
) -> None:
    """Write a trajectory as comma-separated text, one row of one instant each.

    Columns: time; the raw readings; the true specific force, angular rate and field in
    sensor axes; the attitude world to sensor, vector first; the index of the rest that
    the row belongs to, -1 for none. ``simval calibrate`` reads the raw readings by
    their names, and any other calibrator the first four columns.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    readings = trajectory.specific_force if raw is None else np.asarray(raw)
    table = np.column_stack(
        [
            trajectory.time,
            readings,
            trajectory.specific_force,
            trajectory.angular_velocity,
            trajectory.magnetic_field,
            trajectory.attitude,
        ]
    )
    # seventeen digits: a reader gets the same bits
    lines = [
        ",".join([f"{value:.17g}" for value in row] + [str(rest)])
        for row, rest in zip(table.tolist(), trajectory.hold.tolist(), strict=True)
    ]
    try:
        Path(path).write_text("\n".join([HEADER, *lines, ""]), encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}"
        raise InputError(msg) from None
