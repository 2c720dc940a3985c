"""Simulated IMUs with motions known in closed form, right and wrong.

The motion is a sum of sines, and its derivatives are written out; nothing of it is
shared with `simval.path`, which makes splines of poses.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.geometry import attitude_matrix, from_rotation_vector
from simval.imu.audit import Audit, Declared, SimulatedImu

G: Final = 9.81
LEVER: Final = np.array([0.10, -0.05, 0.20])
Rng = np.random.Generator


@dataclass(frozen=True)
class Motion:
    """A free motion: position and Euler angles as sums of sines."""

    amplitude: Array  # (3, k), m
    frequency: Array  # (3, k), rad/s
    phase: Array
    turn: Array  # (3, k), rad
    turning: Array  # (3, k), rad/s
    shift: Array
    spin: Array  # (3,), rad/s of the three angles

    @classmethod
    def of(
        cls,
        rng: Rng,
        pace: float = 1.0,
        move: float = 0.5,
        turn: float = 0.5,
        spin: float = 0.3,
    ) -> "Motion":
        """Draw a motion; its fastest parts have about 3 rad/s times the pace."""
        k = 3
        frequency = pace * rng.uniform(1.0, 3.0, (3, k))
        turning = pace * rng.uniform(1.0, 3.0, (3, k))
        return cls(
            move * rng.uniform(0.3, 1.0, (3, k)) / k, frequency,
            rng.uniform(0, 6.28, (3, k)), turn * rng.uniform(0.3, 1.0, (3, k)) / k,
            turning, rng.uniform(0, 6.28, (3, k)),
            spin * pace * rng.uniform(-1.0, 1.0, 3),
        )  # fmt: skip

    def place(self, t: Array, order: int = 0) -> Array:
        """Position, or a derivative of it, (n, 3)."""
        return _sines(t, self.amplitude, self.frequency, self.phase, order)

    def rotation(self, t: Array) -> Any:
        """Rotation body to world by SciPy, from angles about z, y, x."""
        angles = self._angles(t, 0)[:, ::-1]
        return scipy.spatial.transform.Rotation.from_euler("ZYX", angles)

    def _angles(self, t: Array, order: int) -> Array:
        found = _sines(t, self.turn, self.turning, self.shift, order)
        return (
            found
            + (self.spin * t[:, None] if order == 0 else 0.0)
            + (self.spin if order == 1 else 0.0)
        )

    def rates(self, t: Array) -> tuple[Array, Array]:
        """Body rate and its derivative, from Euler angles."""
        (x, y, _), (dx, dy, dz) = self._angles(t, 0).T, self._angles(t, 1).T
        ddx, ddy, ddz = self._angles(t, 2).T
        sx, cx, sy, cy = np.sin(x), np.cos(x), np.sin(y), np.cos(y)
        w = np.stack([dx - dz * sy, dy * cx + dz * sx * cy, -dy * sx + dz * cx * cy], 1)
        a = np.stack([
            ddx - ddz * sy - dz * dy * cy,
            ddy * cx - dy * dx * sx + ddz * sx * cy + dz * dx * cx * cy
            - dz * dy * sx * sy,
            -ddy * sx - dy * dx * cx + ddz * cx * cy - dz * dx * sx * cy
            - dz * dy * cx * sy,
        ], 1)  # fmt: skip
        return w, a


def _sines(t: Array, a: Array, f: Array, p: Array, order: int) -> Array:
    x = t[:, None, None] * f + p
    return np.sum(a * f**order * np.sin(x + order * np.pi / 2), axis=2)


@dataclass
class Truth:
    """Everything about a motion at the rows."""

    motion: Motion
    t: Array
    h: float
    lever: Array
    mount: Array  # body to sensor

    def __post_init__(self) -> None:
        t = self.t
        self.R = self.motion.rotation(t)
        self.w, self.al = self.motion.rates(t)
        self.v, self.a = self.motion.place(t, 1), self.motion.place(t, 2)

    def at(self, late: float) -> "Truth":
        """The truth so many steps earlier."""
        return Truth(
            self.motion, self.t - late * self.h, self.h, self.lever, self.mount
        )

    def body(self, x: Array) -> Array:
        """Turn world vectors into body axes."""
        return np.asarray(self.R.inv().apply(x))

    def arm(self, e: float = 1.0, c: float = 1.0) -> Array:
        """Acceleration by the lever arm, its two terms weighted."""
        r = self.lever
        return e * np.cross(self.al, r) + c * np.cross(self.w, np.cross(self.w, r))

    def force(self) -> Array:
        """Specific force in body axes."""
        return self.body(self.a + UP) + self.arm()


UP = np.array([0.0, 0.0, G])
ARM: Final = float(np.linalg.norm(LEVER))
Pair = tuple[Array, Array]
Wrong = Callable[[Truth, float], Pair]
"""What gyroscope and accelerometer read in body axes, with an error so great."""


def _arm(euler: float, centripetal: float, x: Truth, s: float) -> Pair:
    return x.w, x.force() + x.arm(euler * s / ARM, centripetal * s / ARM)


def _gravity(axis: int, x: Truth, s: float) -> Pair:
    return x.w, x.force() + s * x.body(G * np.eye(3)[axis] + 0 * x.a)


def _mixed(x: Truth, s: float) -> Pair:
    old = x.at(s)
    turn = x.body(old.R.apply(old.al))  # as a simulator keeps it, in the world
    force = x.body(old.a + UP) + np.cross(turn, x.lever)
    return x.w, force + np.cross(x.w, np.cross(x.w, x.lever))


def _difference(n: int, x: Truth, s: float) -> Pair:
    def velocity(y: Truth) -> Array:  # of the sensor
        return y.v + y.R.apply(np.cross(y.w, y.lever))

    return x.w, x.body((velocity(x) - velocity(x.at(n))) / (n * x.h) + UP)


class WrongBy(NamedTuple):
    """An error with a size, which is 0 for a right simulator."""

    read: Wrong
    named: str  # of gyroscope (g) or accelerometer (a)
    group: str
    floor: float = 0.0  # what nobody calls wrong


SIZED: Final[Mapping[str, WrongBy]] = MappingProxyType({
    "lever arm in m": WrongBy(partial(_arm, 1, 1), "a.lever", "arms"),
    "Euler term in m": WrongBy(partial(_arm, 1, 0), "a.Euler", "arms"),
    "centripetal term in m": WrongBy(partial(_arm, 0, 1), "a.centripetal", "arms"),
    "scale of the gyroscope": WrongBy(
        lambda x, s: (x.w * (1 + s), x.force()), "g.scale", "scales"),
    "scale of the accelerometer": WrongBy(
        lambda x, s: (x.w, x.force() * (1 + s)), "a.scale", "scales"),
    "linear term": WrongBy(
        lambda x, s: (x.w, x.force() + s * x.body(x.a)), "a.linear", "scales"),
    "tilt of gravity in rad": WrongBy(partial(_gravity, 0), "a.gravity", "scales"),
    "transport term": WrongBy(
        lambda x, s: (x.w, x.force() + s * np.cross(x.w, x.body(x.v))),
        "a.transport", "scales"),
    "gyroscope late in steps": WrongBy(
        lambda x, s: (x.at(s).w, x.force()), "g.delay", "times", 0.1),
    "accelerometer late in steps": WrongBy(
        lambda x, s: (x.w, x.at(s).force()), "a.delay", "times", 0.1),
    "two instants in steps": WrongBy(_mixed, "a.instants", "times", 0.1),
})  # fmt: skip


def _by(name: str, low: float, high: float | None = None) -> "Kind":
    return Kind(SIZED[name].read, (low, low if high is None else high),
                frozenset([SIZED[name].named]))  # fmt: skip


class Kind(NamedTuple):
    """A simulator with an error, the range of its size, and its name."""

    read: Wrong
    size: tuple[float, float]
    named: frozenset[str]


def _wholly(read: Wrong, *named: str) -> Kind:
    return Kind(read, (0.0, 0.0), frozenset(named))


def _right(x: Truth, s: float) -> Pair:
    return x.w, x.force()


ONE_SEED, DENSITY = "one seed", "density"
KINDS: Final[Mapping[str, Kind]] = MappingProxyType({
    "right": _wholly(_right),
    "no lever arm": _by("lever arm in m", -ARM),
    "other lever arm": _by("lever arm in m", 0.2 * ARM, ARM),
    "no centripetal": _by("centripetal term in m", -ARM),
    "no Euler": _by("Euler term in m", -ARM),
    "linear": _by("linear term", 0.2, 3.0),
    "no linear": _by("linear term", -1.0),
    "gravity sign": Kind(partial(_gravity, 2), (-2.0, -2.0), frozenset(["a.gravity"])),
    "no gravity": Kind(partial(_gravity, 2), (-1.0, -1.0), frozenset(["a.gravity"])),
    "gravity of the sensor": _wholly(
        lambda x, s: (x.w, x.force() - x.body(UP + 0 * x.a) + UP), "a.gravity",
        "a.constant"),
    "body difference": _by("transport term", -1.0),
    "g": _by("scale of the accelerometer", 1.0 / 9.80665 - 1.0),
    "deg/s": _by("scale of the gyroscope", 180.0 / np.pi - 1.0),
    "scale": _by("scale of the gyroscope", 0.05, 0.5),
    "world rate": _wholly(
        lambda x, s: (x.R.apply(x.w) @ x.mount, x.force()), "g.frame"),
    "world force": _wholly(
        lambda x, s: (x.w, x.R.apply(x.force()) @ x.mount), "a.frame"),
    "late": Kind(lambda x, s: (x.at(s).w, x.at(s).force()), (1.2, 6.0),
                 frozenset(["g.delay", "a.delay"])),
    "early": _by("gyroscope late in steps", -3.0, -1.0),
    "mixed": _by("two instants in steps", 0.7, 2.0),
    "backward difference": _wholly(partial(_difference, 1), "a.difference"),
    "difference of four": _wholly(partial(_difference, 4), "a.difference"),
    "exchanged": _wholly(
        lambda x, s: ((x.w @ x.mount.T)[:, [1, 0, 2]] @ x.mount, x.force()), "g.frame"),
    "sign of z": _wholly(
        lambda x, s: (x.w, x.force() @ (x.mount.T * [1, 1, -1]) @ x.mount), "a.frame"),
    "zero": _by("scale of the accelerometer", -1.0),
    ONE_SEED: _wholly(_right, "seed"),
    DENSITY: _wholly(_right, "noise"),
})  # fmt: skip
"""Right ones, and wrong ones as threads of simulators have them."""
MOUNT: Final = attitude_matrix(from_rotation_vector(np.array([0.3, -0.5, 0.2])))


def simulated(
    name: str,
    rng: Rng,
    *,
    rate: float = 200.0,
    seconds: float = 10.0,
    noise: float = 0.0,
    single: bool = False,
    size: float | None = None,
    **motion: float,
) -> SimulatedImu:
    """Readings of a simulator, with white noise.

    `name` is of `KINDS`, or of `SIZED` with a size.
    """
    h = 1.0 / rate
    t = np.arange(round(seconds * rate)) * h
    x = Truth(Motion.of(rng, **motion), t, h, LEVER, MOUNT)
    if size is None:
        size = rng.uniform(*KINDS[name].size)
    read = SIZED[name].read if name in SIZED else KINDS[name].read
    gyro, force = (each @ MOUNT.T for each in read(x, size))
    white = rng.standard_normal((2, len(t), 3))
    if name == ONE_SEED:
        white[1, :, 1] = white[1, :, 0]
    gyro, force = gyro + 0.1 * noise * white[0], force + noise * white[1]
    columns = [x.motion.place(t), x.R.as_quat(), gyro, force]
    if single:
        columns = [np.float32(each).astype(float) for each in columns]
    return SimulatedImu(
        time=t, position=columns[0], attitude=columns[1], gyroscope=columns[2],
        accelerometer=columns[3], source=name,
    )  # fmt: skip


def declared(noise: float = 0.0) -> Declared:
    """What is declared of all of them, with the accelerometer's noise density."""
    claim = {"accelerometer": (noise, 0.0, 0.0)} if noise else {}
    return Declared(lever=LEVER, mount=MOUNT, gravity=-UP, noise=claim)


def names(found: Audit) -> set[str]:
    """Names of what was found wrong, as in `KINDS`."""
    wrong = {f"{x.name[0]}.{name}" for x in found.sensors for name in x.wrong}
    wrong |= {f"{x.name[0]}.frame" for x in found.sensors if x.frame}
    wrong |= {"seed"} if found.shared else set()
    wrong |= {"spikes"} if len(found.spikes) else set()
    return wrong or ({"noise"} if found.exit_code == 1 else set())
