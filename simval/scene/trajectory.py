r"""A trajectory: a row for each instant, average rates, and conversion to a log.

The rows are true values, with where they come from. As a test signal for any calibrator
they are written with an IMU's readings.

Average body rates over each step, from attitudes, are what a rate gyroscope integrates.
With :math:`d_k` the rotation vector of the turn of step k and :math:`S_k` the integral
of the body rate over it,

.. math:: d_k = S_k
   + \tfrac{1}{24}\,(S_{k-1} \times S_k + S_k \times S_{k+1}),  \tag{G1}

up to the fifth order of the step: the bracket is the coning of a rate that is a
parabola over three steps. Equation (G1) is solved for S, so whoever integrates the
averages with this bracket gets the attitudes back to rounding. The physics' own rate is
of the step before, and differs from the average by 0.6 degrees a move when it is
integrated.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arguments import instance, whole_number
from simval.arrays import Array, ReadOnly
from simval.errors import InputError
from simval.geometry import compose, conjugate, rotation_vector
from simval.imu.logs.rows import BEFORE, Rows
from simval.imu.sensor import ImuReadings, Motion
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory(ReadOnly):
    """Readings of an ideal sensor at the IMU's site, row by row.

    All columns of a row are from the same evaluation of the physics; with positions,
    force and rate are of the path that the body takes, eq. (P2) of the physics.

    Attributes
    ----------
    time : Array
        Clock, s, (n,).
    specific_force : Array
        In sensor axes, m/s^2, (n, 3); at rest it is g upwards.
    angular_velocity : Array
        Of the sensor relative to the world, sensor axes, rad/s, (n, 3).
    magnetic_field : Array
        In sensor axes, T, (n, 3).
    attitude : Array
        Unit quaternions world to sensor, vector first, (n, 4).
    hold : NDArray[np.intp]
        Index of the rest that each row belongs to, -1 for none, (n,).
    unsettled : tuple of int
        Planned rests that were left out because the body had not come to rest.
    gravity : Array
        In world axes, m/s^2, (3,).
    magnetic : Array
        The field in world axes, T, (3,).
    rest_force : float
        Every rest row's specific force has the length g within this, m/s^2.
    rest_rate : float
        Every rest row's angular rate is within this, rad/s.
    provenance : Mapping
        All that the numbers depend on: scene, model file's SHA-256, MuJoCo's version,
        parameters.
    position : Array or None
        Of the sensor in world axes, m, (n, 3), where it is known.
    """

    time: Float[Array, " n"]
    specific_force: Float[Array, "n 3"]
    angular_velocity: Float[Array, "n 3"]
    magnetic_field: Float[Array, "n 3"]
    attitude: Float[Array, "n 4"]
    hold: NDArray[np.intp]
    unsettled: tuple[int, ...]
    gravity: Float[Array, "3"]
    magnetic: Float[Array, "3"]
    rest_force: float
    rest_rate: float
    provenance: Mapping[str, Any]
    position: Float[Array, "n 3"] | None = None

    def __post_init__(self) -> None:
        ReadOnly.__post_init__(self)
        hold = np.array(self.hold, dtype=np.intp)
        hold.flags.writeable = False
        object.__setattr__(self, "hold", hold)

    @property
    def g(self) -> float:
        """Length of gravity, m/s^2."""
        return float(np.linalg.norm(self.gravity))

    @property
    def rate(self) -> float:
        """Rows per second, Hz."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    def hold_indices(self) -> NDArray[np.intp]:
        """Indices of the rests, in order of time.

        Returns
        -------
        NDArray[np.intp]
            (m,).
        """
        return np.unique(self.hold[self.hold >= 0])

    def hold_means(
        self, values: Float[Array, "n k"] | None = None
    ) -> Float[Array, "m k"]:
        """Mean over the rows of each rest, of the specific force or of other rows.

        Parameters
        ----------
        values : Array or None
            Rows beside the trajectory's own, (n, k), for instance distorted readings;
            None takes the specific force.

        Returns
        -------
        Array
            (m, k), in the order of `hold_indices`.
        """
        rows = self.specific_force if values is None else np.asarray(values)
        means = [rows[self.hold == k].mean(axis=0) for k in self.hold_indices()]
        return np.array(means).reshape(-1, rows.shape[1])


def attitude_from_mujoco(quaternion: Float[Array, "... 4"]) -> Float[Array, "... 4"]:
    """Convert MuJoCo's quaternions to the package's order; only here is that done.

    MuJoCo's ``framequat`` of a site takes site to world, scalar first. Reordered scalar
    last, the same four numbers are the package's quaternion of world to site, whose
    matrix is the transpose.
    """
    return np.roll(np.asarray(quaternion), -1, axis=-1)


_ROUNDS: Final = 60  # each takes a tenth of the error at 1 rad a step
_MOST: Final = 1.0  # rad a step; the bracket leaves out a power of this


def average_rates(trajectory: Trajectory, every: int = 1) -> Float[Array, "m 3"]:
    """Average body rate over the step that ends at each row, eq. (G1).

    Parameters
    ----------
    trajectory : Trajectory
        A simulated run.
    every : int, default 1
        Keep every so many rows, the first among them; the increments between two kept
        rows are added, as a sensor does that integrates and is read less often.

    Returns
    -------
    Array
        Sensor axes, rad/s, (m, 3), for the rows ``[::every]``. No step ends at the
        first row, which repeats the second.

    Raises
    ------
    InputError
        If the body turns by more than a radian in a step, so that attitudes do not tell
        how, or fewer than two rows would be kept.
    """
    instance("trajectory", trajectory, Trajectory)
    every = whole_number("every", every, 1, len(trajectory.time) - 1)
    kept = range(0, len(trajectory.time), every)
    S = increments(trajectory.attitude)
    total = np.add.reduceat(S[: kept[-1]], np.arange(0, kept[-1], every), axis=0)
    rates = total / np.diff(trajectory.time[::every])[:, None]
    return np.concatenate([rates[:1], rates])


def gyroscope_rows(
    trajectory: Trajectory, every: int = 1, rows: Rows = BEFORE
) -> Float[Array, "m 3"]:
    """Rates as a gyroscope with such rows reads them.

    By the spline through the sum of the increments of all steps, of which every so many
    are kept.
    """
    if rows == BEFORE:
        return average_rates(trajectory, every)
    time, at = trajectory.time, trajectory.time[::every]
    sums = np.cumsum(increments(trajectory.attitude), axis=0)
    turned = scipy.interpolate.CubicSpline(time, np.vstack([np.zeros(3), sums]))

    def until(wanted: Float[Array, " m"]) -> Float[Array, "m 3"]:
        inside = np.clip(wanted, time[0], time[-1])
        return np.asarray(
            turned(inside) + turned(inside, 1) * (wanted - inside)[:, None]
        )

    if rows.kind == "instant":
        return np.asarray(turned(np.clip(at - rows.delay, time[0], time[-1]), 1))
    first, last = 2.0 * at[0] - at[1], 2.0 * at[-1] - at[-2]
    edges = np.concatenate([[first], at] if rows.kind == "before" else [at, [last]])
    return np.diff(until(edges - rows.delay), axis=0) / np.diff(edges)[:, None]


def increments(attitude: Float[Array, "n 4"]) -> Float[Array, "n-1 3"]:
    """Integral of the body rate between successive attitudes, rad, eq. (G1)."""
    d = turns(attitude)
    most = float(np.abs(d).max())
    if not most <= _MOST:
        msg = (
            f"the body turns by {most:.2g} rad in one step; its rate can be "
            f"found from its attitudes up to {_MOST:g} rad, so simulate with a "
            "shorter timestep"
        )
        raise InputError(msg)
    S = d
    for _ in range(_ROUNDS):
        before, S = S, d - coning(S)
        if np.abs(S - before).max() <= np.finfo(float).eps * most:
            break
    return S


def turns(attitude: Float[Array, "n 4"]) -> Float[Array, "n-1 3"]:
    """Rotation vectors from each attitude to the next, in body axes, rad."""
    return rotation_vector(compose(conjugate(attitude[:-1]), attitude[1:]))


def coning(S: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """The bracket of (G1), extended by straight lines beyond the ends."""
    ends = 2.0 * S[[0, -1]] - S[[min(1, len(S) - 1), max(len(S) - 2, 0)]]
    wide = np.concatenate([ends[:1], S, ends[1:]])
    return (np.cross(wide[:-2], S) + np.cross(S, wide[2:])) / 24.0


TRUTH = (
    "true t [s],true fx [m/s^2],true fy [m/s^2],true fz [m/s^2],"
    "true wx [rad/s],true wy [rad/s],true wz [rad/s],"
    "true instant wx [rad/s],true instant wy [rad/s],true instant wz [rad/s],"
    "true mx [T],true my [T],true mz [T],qx,qy,qz,qs,rest"
)
PLACES = ",px [m],py [m],pz [m]"
UNITS = (("a", "m/s^2"), ("w", "rad/s"), ("m", "T"))


def motion_of(trajectory: Trajectory, every: int = 1, rows: Rows = BEFORE) -> Motion:
    """Motion of a run, every n-th row, for the sensors of an IMU.

    The rate is the average over the step that ends at a row, and over all steps since
    the row before that is kept, or as the gyroscope's rows are of.
    """
    return Motion(
        time=trajectory.time[::every],
        specific_force=trajectory.specific_force[::every],
        rate=gyroscope_rows(trajectory, every, rows),
        field=trajectory.magnetic_field[::every],
    )


def write_signal(
    path: str | PathLike[str],
    trajectory: Trajectory,
    readings: ImuReadings | None = None,
    every: int = 1,
    rows: Rows = BEFORE,
) -> None:
    """Write a run as comma-separated text, a row for each instant.

    Columns: the time stamp; readings of accelerometer, gyroscope and magnetometer, the
    truth where there is no such sensor, the gyroscope's as `rows` says; the true time,
    specific force, average rate of the step that ends at the row, rate of the instant,
    and field, in sensor axes; the attitude world to sensor, vector first; the index of
    the rest that the row belongs
    to, -1 for none; the position, where it is known. ``simval calibrate`` reads the
    readings by their names, and any other calibrator the first columns.
    """
    motion = motion_of(trajectory, every, rows)
    kept = slice(None, None, every)
    table = np.column_stack(
        [
            *(motion.time if readings is None else readings.stamp,),
            *read_or_true(motion, readings),
            motion.time,
            motion.specific_force,
            average_rates(trajectory, every),
            trajectory.angular_velocity[kept],
            motion.field,
            trajectory.attitude[kept],
        ]
    )
    # seventeen digits: a reader gets the same bits
    rests = trajectory.hold[kept].tolist()
    where, names = [""] * len(rests), ""
    if trajectory.position is not None:
        names = PLACES
        where = ["".join(f",{x:.17g}" for x in p) for p in trajectory.position[kept]]
    lines = [
        ",".join([f"{value:.17g}" for value in row] + [str(rest)]) + more
        for row, rest, more in zip(table.tolist(), rests, where, strict=True)
    ]
    text = "\n".join([header(readings) + names, *lines, ""])
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}"
        raise InputError(msg) from None


def header(readings: ImuReadings | None = None) -> str:
    """Names of the columns; a missing sensor has the truth's units."""
    real = (
        [False] * 3
        if readings is None
        else [True, readings.gyroscope is not None, readings.magnetometer is not None]
    )
    names = [
        f"{letter}{axis} [{'raw' if there else unit}]"
        for (letter, unit), there in zip(UNITS, real, strict=True)
        for axis in "xyz"
    ]
    return ",".join(["t [s]", *names, TRUTH])


def read_or_true(
    motion: Motion, readings: ImuReadings | None
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Readings of the three sensors, or the truth where a sensor is missing."""
    force, rate, field = motion.specific_force, motion.rate, motion.field
    if readings is None:
        return force, rate, field
    gyroscope, magnetometer = readings.gyroscope, readings.magnetometer
    return (
        readings.accelerometer.raw,
        rate if gyroscope is None else gyroscope.raw,
        field if magnetometer is None else magnetometer.raw,
    )
