"""A smooth trajectory through recorded poses, and the ideal readings along it.

The poses are those of the sensor. What the interpolation may be off by is the change by
the degree of its splines (`simval.path`).
"""

from os import PathLike
from pathlib import PurePath
from typing import Final

import numpy as np

from simval.arguments import whole_number
from simval.arrays import Array, positive_number
from simval.errors import InputError
from simval.imu.audit.recorded_poses import poses_of
from simval.imu.audit.simulated import evened
from simval.imu.logs import read_positions, read_truth
from simval.path import PosePath
from simval.scene.trajectory import Trajectory
from simval.shapes import Float
from simval.units import G0
from simval.vocabulary import PoseTurns

MAGNETIC: Final = (2e-5, 0.0, -4e-5)
"""Field of the scenes, T: north, west, up."""
COARSE: Final = 5
MOST: Final = 2_000_000  # rows


def recorded_trajectory(
    path: str | PathLike[str],
    rate: float | None = None,
    columns: str | None = None,
    turns: PoseTurns = "body-to-world",
) -> Trajectory:
    """What an ideal sensor reads along recorded poses.

    Parameters
    ----------
    path : path-like
        Poses: a file of TUM's or EuRoC's form, a data set's folder, or CSV.
    rate : float or None
        Rows per second, Hz; None takes that of the poses.
    columns : str or None
        What each column is, out of ``t px py pz qx qy qz qs`` or ``-``.
    turns : {"body-to-world", "world-to-body"}
        What a quaternion turns.

    Returns
    -------
    Trajectory
        Its provenance has what the interpolation changes by its degree: root mean
        squares ``force_error``, m/s^2, and ``rate_error``, rad/s.

    Raises
    ------
    InputError
        If the file cannot be read, or the poses have a hole.
    """
    try:
        truth = read_truth(str(path), columns=columns)
        positions = read_positions(str(path), columns=columns)
    except InputError as error:
        msg = str(error).replace("--truth-", "--trajectory-")
        raise InputError(msg) from None
    poses = poses_of(truth, positions, turns)
    time = evened("time", poses.time - poses.time[0])
    step = np.diff(time)
    if step.max() > 10.0 * np.median(step):
        at = float(time[int(step.argmax())])
        msg = (
            f"{path}: there is no pose for {step.max():.3g} s after {at:.3f} s; "
            "give a part without a gap"
        )
        raise InputError(msg)
    usual = 1.0 / float(np.median(step))
    hertz = usual if rate is None else positive_number("rate", rate, "Hz")
    count = whole_number("rows", int(time[-1] * hertz + 1e-6) + 1, 2, MOST)
    at_rows = np.arange(count) / hertz
    fine, coarse = (
        PosePath(time, poses.position, poses.attitude, k).at(at_rows)
        for k in (7, COARSE)
    )
    gravity, field = np.array([0.0, 0.0, -G0]), np.array(MAGNETIC)
    force, other = (x.specific_force(np.zeros(3), gravity) for x in (fine, coarse))
    return Trajectory(
        time=at_rows, specific_force=force, angular_velocity=fine.rate,
        magnetic_field=np.vecmat(field, fine.attitude),
        attitude=fine.quaternion, hold=np.full(count, -1, dtype=np.intp), unsettled=(),
        gravity=gravity, magnetic=field, rest_force=0.0, rest_rate=0.0,
        position=fine.position,
        provenance={
            "poses": PurePath(path).name, "rows": len(time), "pose_rate": usual,
            "force_error": _rms(force - other),
            "rate_error": _rms(fine.rate - coarse.rate),
        },
    )  # fmt: skip


def _rms(rows: Float[Array, "n 3"]) -> float:
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))
