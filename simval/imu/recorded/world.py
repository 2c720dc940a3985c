"""World frame of the truth: stated, that of its data set, or found from the sensors.

The log's sensors show up, the mean specific force of each rest in the truth's world,
and north, the horizontal part of the mean magnetic field of all rows there. That north
is the magnetometer's own: the place may turn the field, or a calibration, by as much as
its direction scatters over the log, and no mean takes that out. So a world that is
known is taken as it is, and what the log shows is stated too; errors are turned to
the log's north only where a user asks for that.

A log without a magnetometer shows up alone. Its north is then that of the nearest
named world, and carries no claim: `heading_dof` is 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
import scipy

from simval.arrays import Array, ReadOnly
from simval.errors import GeometryError, RefusedError
from simval.geometry import FRAME_AXES, FRAMES, Frame
from simval.imu.recorded.attitudes import of_matrix, rotated, rotation_vector
from simval.imu.recorded.errors import ALPHA, mean_with_error, quantile
from simval.imu.statics import Intervals
from simval.shapes import Bool, Float
from simval.spelling import counted

STEEPEST: Final = np.radians(85.0)  # dip beyond which a field has no north
NEAR: Final = np.radians(10.0)  # of a named world, to be called by its name
LEAST: Final = 20  # rows of a rest with truth

STANDARD: Final[Mapping[tuple[str, ...], tuple[Frame, str]]] = MappingProxyType(
    {tuple(f"opt_quat_{k}" for k in range(4)): ("ENU", "BROAD")}
)
"""Worlds of data sets, by the names of their columns: BROAD (D. Laidig, M. Caruso,
A. Cereatti, T. Seel, Data 6(7), 2021) has east-north-up."""

TruthWorld = Frame | Literal["estimated"]
WorldSource = Literal["stated", "standard", "nearest", "estimated"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World(ReadOnly):
    """The turn from north-west-up to the truth's world, and how well it is known.

    Attributes
    ----------
    matrix : Array
        Rows are north, west and up in the truth's world, (3, 3).
    tilt_sd : float
        Standard deviation of up about each horizontal axis, rad; NaN from one rest.
    tilt_dof : int
        Its degrees of freedom; 0 where it is not known.
    heading_sd : float
        Standard deviation of north, rad; NaN without a magnetometer.
    heading_dof : int
        Its degrees of freedom; 0 without a magnetometer.
    deviation : float
        Standard deviation over the log of the field's horizontal direction, rad.
    rests : int
        Rests that up is from.
    name : str
        Named world that the truth's is nearest to, or is stated to be; empty for none.
    off : Array
        Rotation vector from what the log shows to that named world, rad, (3,).
    taken : {"stated", "standard", "nearest", "estimated"}
        Why `matrix` is that of the named world; what the log shows if estimated.
    """

    matrix: Float[Array, "3 3"]
    tilt_sd: float
    tilt_dof: int
    heading_sd: float
    heading_dof: int
    deviation: float
    rests: int
    name: str
    off: Float[Array, "3"]
    taken: WorldSource = "estimated"

    @property
    def covariance(self) -> Float[Array, "3 3"]:
        """Covariance of that turn in north-west-up, rad^2; the unknown counts as 0.

        Of an estimated north against the log's mean field, not the true north.
        """
        if self.taken != "estimated":
            return np.zeros((3, 3))
        tilt = 0.0 if np.isnan(self.tilt_sd) else self.tilt_sd**2
        return np.diag([tilt, tilt, self.heading_sd**2 if self.heading_dof else 0.0])

    def half(self, which: str) -> float:
        """Half width of the 95 % interval of ``tilt`` or ``heading``, rad.

        That of the heading has the field's own deviation in it.
        """
        sd, dof = (
            (self.tilt_sd, self.tilt_dof)
            if which == "tilt"
            else (float(np.hypot(self.heading_sd, self.deviation)), self.heading_dof)
        )
        return sd * quantile(dof) if dof else np.nan

    @property
    def norths(self) -> tuple[float, float]:
        """Turns of the north, rad, that a comparison of filters should withstand.

        Of an estimated one the ends of its interval; else to the log's magnetometer.
        """
        if not self.heading_dof:
            return 0.0, 0.0
        if self.taken == "estimated":
            half = self.half("heading")
            return -half, half
        return 0.0, -float(self.off[2])

    @property
    def upright(self) -> bool:
        """True if the rests agree with up, or are too few to contradict it.

        By a test of two horizontal axes at the false-alarm rate `ALPHA`.
        """
        if not self.tilt_dof or self.taken == "estimated":
            return True
        ratio = 0.5 * float(self.off[:2] @ self.off[:2]) / self.tilt_sd**2
        return float(scipy.special.fdtrc(2.0, self.tilt_dof, ratio)) >= ALPHA


def find_world(
    q: Float[Array, "n 4"],
    force: Float[Array, "n 3"],
    field: Float[Array, "n 3"] | None,
    rests: Intervals,
    axes: Float[Array, "3 3"],
) -> World:
    """Find north and up from attitudes, which turn the truth's world to the sensor.

    `axes` is the covariance of the sensor's axes in those attitudes, rad^2, which goes
    into both; and what up is off by itself counts by the tangent of the dip in north.

    Raises
    ------
    RefusedError
        If no rest has truth, or the field has no north.
    """
    there = np.asarray(np.isfinite(q).all(axis=1))
    ups = _ups(rotated(q, force), there, rests)
    axis = (np.tile(e, (len(q[there]), 1)) for e in np.eye(3))
    turn = np.stack([rotated(q[there], e).mean(axis=0) for e in axis], axis=1)
    common = turn @ axes @ turn.T
    up = ups.mean(axis=0)
    up /= np.linalg.norm(up)
    tilt_sd, tilt_dof = _tilt(ups, up)
    leak = 0.0 if np.isnan(tilt_sd) else tilt_sd
    tilt_sd = float(np.sqrt(tilt_sd**2 + 0.5 * (np.trace(common) - up @ common @ up)))
    if field is None:
        upright = max(map(_axes_of, FRAMES), key=lambda own: float(own[2] @ up))
        matrix = _level(up, upright[0])
        name, off = _named(matrix)
        return World(
            matrix=matrix, tilt_sd=tilt_sd, tilt_dof=tilt_dof, heading_sd=np.nan,
            heading_dof=0, deviation=np.nan, rests=len(ups), name=name, off=off,
        )  # fmt: skip
    there_field = rotated(q, field)[there]
    mean, covariance, dof = mean_with_error(there_field)
    flat = mean - (mean @ up) * up
    length = float(np.linalg.norm(flat))
    if not length > np.cos(STEEPEST) * float(np.linalg.norm(mean)):
        msg = (
            "the mean magnetic field in the truth's world is vertical within "
            f"{90 - np.degrees(STEEPEST):.0f} degrees and has no north; look at the "
            "magnetometer, or calibrate it (--calibration)"
        )
        raise GeometryError(msg)
    north = flat / length
    west = np.cross(up, north)
    matrix = np.stack([north, west, up])
    name, off = _named(matrix)
    east = np.arctan2(there_field @ west, there_field @ north)
    leak *= float(mean @ up) / length
    heading = west @ covariance @ west / length**2 + leak**2 + up @ common @ up
    return World(
        matrix=matrix,
        tilt_sd=tilt_sd,
        tilt_dof=tilt_dof,
        heading_sd=float(np.sqrt(heading)),
        heading_dof=dof,
        deviation=float(np.sqrt(np.mean(east**2))),
        rests=len(ups),
        name=name,
        off=off,
    )


def taken_world(
    shown: World, columns: Sequence[str], asked: TruthWorld | None
) -> World:
    """The world in which errors are measured, with what the log shows of it.

    Raises
    ------
    RefusedError
        If none is stated, standard or near.
    """
    if asked == "estimated":
        return shown
    if asked is not None:
        return _as(shown, asked, "stated")
    if tuple(columns) in STANDARD:
        return _as(shown, STANDARD[tuple(columns)][0], "standard")
    if shown.name:
        return _as(shown, shown.name, "nearest")
    by, to = "rests", ""
    if shown.heading_dof:
        half = np.degrees(shown.half("heading"))
        by, to = "magnetometer", f", to +- {half:.2g} degrees"
    msg = (
        f"the truth's world is none of {', '.join(FRAMES)}: the nearest is "
        f"{np.degrees(np.linalg.norm(shown.off)):.0f} degrees off by what the log's "
        "sensors show; state it (--truth-world), or turn the truth to the log's own "
        f"{by} (--truth-world estimated){to}. A gyroscope whose rows are late by more "
        "than a step or two looks so too (--gyro-rows, --gyro-delay)"
    )
    raise RefusedError(msg)


def _as(world: World, name: str, taken: WorldSource) -> World:
    own = _axes_of(name)
    shown = world.matrix if world.heading_dof else _level(world.matrix[2], own[0])
    return replace(world, matrix=own, name=name, off=_off(shown, own), taken=taken)


def _axes_of(name: str) -> Float[Array, "3 3"]:
    # north, west and up of a named world
    north, up = (np.array(axis) for axis in FRAME_AXES[name])
    return np.stack([north, np.cross(up, north), up])


def _off(matrix: Float[Array, "3 3"], own: Float[Array, "3 3"]) -> Float[Array, "3"]:
    return -rotation_vector(of_matrix(matrix @ own.T))


def _ups(
    force: Float[Array, "n 3"], there: Bool[np.ndarray, " n"], rests: Intervals
) -> Float[Array, "m 3"]:
    # mean direction of each rest with truth
    means = []
    for start, stop in rests:
        good = there[start:stop]
        if np.count_nonzero(good) >= LEAST:
            means.append(force[start:stop][good].mean(axis=0))
    if not means:
        msg = (
            f"no rest of the log ({counted(len(rests), 'rest')}) has recorded "
            "attitudes, and up is found at rest; record a rest in view of the "
            "optical system"
        )
        raise RefusedError(msg)
    each = np.array(means)
    return each / np.linalg.norm(each, axis=1, keepdims=True)


def _level(up: Float[Array, "3"], north: Float[Array, "3"]) -> Float[Array, "3 3"]:
    # the world of this up whose north is the nearest to that one
    flat = np.asarray(north) - (north @ up) * up
    if not np.linalg.norm(flat) > 0.1:  # it is upright: any other
        flat = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    flat /= np.linalg.norm(flat)
    return np.stack([flat, np.cross(up, flat), up])


def _tilt(ups: Float[Array, "m 3"], up: Float[Array, "3"]) -> tuple[float, int]:
    # of the mean, per horizontal axis, by the scatter of the rests
    if len(ups) < 2:
        return np.nan, 0
    off = ups - (ups @ up)[:, None] * up
    dof = 2 * (len(ups) - 1)
    return float(np.sqrt(np.sum(off**2) / dof / len(ups))), dof


def _named(matrix: Float[Array, "3 3"]) -> tuple[str, Float[Array, "3"]]:
    # the named world whose north and up are nearest, and the rotation from it
    offs = {name: _off(matrix, _axes_of(name)) for name in FRAMES}
    best = min(FRAMES, key=lambda name: float(np.linalg.norm(offs[name])))
    return best if np.linalg.norm(offs[best]) <= NEAR else "", offs[best]
