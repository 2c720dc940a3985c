"""Input of an audit: readings, poses of the body, and what is declared of them."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from simval.arrays import Array, ReadOnly, physical_array, shaped_array
from simval.errors import InputError, RefusedError
from simval.geometry import unit_quaternions
from simval.shapes import Float
from simval.units import G0

SENSORS: Final = ("gyroscope", "accelerometer")
LEAST: Final = 40  # rows; of fewer the ends, which are left out, are a half
EVEN: Final = 0.01  # of a step, by which the stamps of even steps may be rounded
LONG_AGO: Final = 1e5  # s; a double of a longer time is off by more than 1e-11 s
ORTHOGONAL: Final = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedImu(ReadOnly):
    """Readings of a simulated IMU and the poses of its body.

    Attributes
    ----------
    time : Array
        Of the readings, s, (n,), increasing.
    gyroscope : Array or None
        Angular rate, (n, 3), rad/s.
    accelerometer : Array or None
        Specific force, (n, 3), m/s^2: at rest it is g upwards.
    pose_time : Array
        Of the poses, s, (m,), increasing; the readings' where it is not given.
    position : Array
        Of the body's origin in a world that does not turn, m, (m, 3).
    attitude : Array
        Unit quaternions world to body, vector first, (m, 4). The same four numbers,
        scalar last, are SciPy's rotation from body to world.
    source : str
        Name of what it came from.
    origin : float
        Time that is 0 in `time` and `pose_time`, s: 0 unless a clock counts from long
        ago, of which a double has few digits.

    Raises
    ------
    InputError
        If the arrays do not belong together, or there are too few rows.
    """

    time: Float[Array, " n"]
    position: Float[Array, "m 3"]
    attitude: Float[Array, "m 4"]
    gyroscope: Float[Array, "n 3"] | None = None
    accelerometer: Float[Array, "n 3"] | None = None
    pose_time: Float[Array, " m"] | None = None
    source: str = "recording"
    origin: float = 0.0

    def __post_init__(self) -> None:
        time = shaped_array("time", self.time, (None,))
        poses = time if self.pose_time is None else self.pose_time
        poses = shaped_array("pose_time", poses, (None,))
        first = float(time[0]) if time.size else 0.0
        began = first if abs(first) > LONG_AGO else 0.0
        own: dict[str, Any] = {
            "origin": self.origin + began, "time": evened("time", time - began),
            "pose_time": evened("pose_time", poses - began),
            "position": physical_array("position", self.position, (len(poses), 3)),
            "attitude": unit_quaternions("attitude", self.attitude),
        }  # fmt: skip
        for name in SENSORS:
            if getattr(self, name) is not None:
                own[name] = physical_array(name, getattr(self, name), (len(time), 3))
        if own["attitude"].shape != (len(poses), 4):
            shape = own["attitude"].shape
            msg = f"`attitude` has shape {shape}, and there are {len(poses)} poses"
            raise InputError(msg)
        if self.gyroscope is None and self.accelerometer is None:
            msg = "there is neither a gyroscope nor an accelerometer to audit; give one"
            raise InputError(msg)
        if min(len(time), len(poses)) < LEAST:
            msg = (
                f"{len(time)} readings and {len(poses)} poses are too few to audit; "
                f"{LEAST} of each are needed, so record longer"
            )
            raise RefusedError(msg)
        for name, value in own.items():
            object.__setattr__(self, name, value)
        ReadOnly.__post_init__(self)

    @property
    def poses(self) -> Float[Array, " m"]:
        """Times of the poses, s."""
        assert self.pose_time is not None
        return self.pose_time

    @property
    def step(self) -> float:
        """Step of the readings, s."""
        return float(np.median(np.diff(self.time)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Declared(ReadOnly):
    """What is declared of a simulated IMU; anything None is fitted.

    Attributes
    ----------
    lever : Array or None
        Place of the sensor in the body, body axes, m, (3,).
    mount : Array or None
        Matrix from body to sensor axes, (3, 3).
    gravity : Array or None
        Acceleration of gravity, world axes, m/s^2, (3,), such as (0, 0, -9.81).
    noise : Mapping
        Of ``gyroscope`` and ``accelerometer``: N, B and K in SI units, one-sided as a
        data sheet has them, (3,) of all axes.

    Raises
    ------
    InputError
        If the matrix is no rotation, or gravity is none.
    """

    lever: Float[Array, "3"] | None = None
    mount: Float[Array, "3 3"] | None = None
    gravity: Float[Array, "3"] | None = None
    noise: dict[str, tuple[float, float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, shape in (("lever", (3,)), ("gravity", (3,)), ("mount", (3, 3))):
            if getattr(self, name) is not None:
                value = physical_array(name, getattr(self, name), shape)
                object.__setattr__(self, name, value)
        if not np.linalg.norm(self.down) > 0.0:
            msg = "`gravity` is zero; give its acceleration, m/s^2, as 0,0,-9.81"
            raise InputError(msg)
        C = np.eye(3) if self.mount is None else self.mount
        off = float(np.abs(C @ C.T - np.eye(3)).max())
        if not (off <= ORTHOGONAL and np.linalg.det(C) > 0.0):
            msg = (
                f"`mount` is no rotation (its rows are off by {off:.2g}); give the "
                "matrix from body to sensor axes"
            )
            raise InputError(msg)
        ReadOnly.__post_init__(self)

    @property
    def down(self) -> Float[Array, "3"]:
        """Acceleration of gravity in the ideal reading, world axes."""
        return np.array([0.0, 0.0, -G0]) if self.gravity is None else self.gravity

    @property
    def up(self) -> Float[Array, "3"]:
        """Direction of what an accelerometer reads at rest, world axes."""
        return -self.down / np.linalg.norm(self.down)


def evened(name: str, value: Array) -> Array:
    """Check that stamps increase, and even them out if they were only rounded."""
    if not (value.ndim == 1 and np.all(np.diff(value) > 0.0)):
        msg = f"`{name}` does not increase; give the rows in order of time"
        raise InputError(msg)
    if len(value) < 2:
        return value
    even, step = np.linspace(value[0], value[-1], len(value), retstep=True)
    return even if np.abs(even - value).max() <= EVEN * step else value
