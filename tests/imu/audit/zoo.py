"""Simulated IMUs of a motion that is known in closed form, right ones and wrong ones.

The motion is a sum of sines, and its derivatives are written out; nothing of it is
shared with `simval.path`, which makes splines of poses.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simval.imu.audit import Audit, Declared, SimulatedImu

G = 9.81
LEVER = np.array([0.10, -0.05, 0.20])
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """A free motion: position by sines, attitude by angles that are sums of sines."""

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
        rng: np.random.Generator,
        pace: float = 1.0,
        move: float = 0.5,
        turn: float = 0.5,
        spin: float = 0.3,
    ) -> "Motion":
        """Draw one whose fastest parts are of about 3 rad/s times its pace."""
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
        """Position or a derivative, (n, 3)."""
        return _sines(t, self.amplitude, self.frequency, self.phase, order)

    def rotation(self, t: Array) -> Rotation:
        """Body to world, by angles about z, y, x."""
        return Rotation.from_euler("ZYX", self._angles(t, 0)[:, ::-1])

    def _angles(self, t: Array, order: int) -> Array:
        found = _sines(t, self.turn, self.turning, self.shift, order)
        return (
            found
            + (self.spin * t[:, None] if order == 0 else 0.0)
            + (self.spin if order == 1 else 0.0)
        )

    def rates(self, t: Array) -> tuple[Array, Array]:
        """Body rate and its derivative, by the kinematics of Euler angles."""
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
        """The same so many steps before."""
        return Truth(
            self.motion, self.t - late * self.h, self.h, self.lever, self.mount
        )

    def body(self, x: Array) -> Array:
        """World to body."""
        return self.R.inv().apply(x)

    def arm(self, e: float = 1.0, c: float = 1.0) -> Array:
        """Terms of the lever arm."""
        r = self.lever
        return e * np.cross(self.al, r) + c * np.cross(self.w, np.cross(self.w, r))

    def force(self) -> Array:
        """Specific force, body axes."""
        return self.body(self.a + UP) + self.arm()


UP = np.array([0.0, 0.0, G])
Wrong = Callable[[Truth, float], tuple[Array, Array]]


def _mixed(x: Truth, s: float) -> tuple[Array, Array]:
    old = x.at(s)
    turn = x.body(old.R.apply(old.al))  # as a simulator keeps it, in the world
    force = x.body(old.a + UP) + np.cross(turn, x.lever)
    return x.w, force + np.cross(x.w, np.cross(x.w, x.lever))


def _difference(x: Truth, n: int) -> Array:
    def velocity(y: Truth) -> Array:  # of the sensor
        return y.v + y.R.apply(np.cross(y.w, y.lever))

    return (velocity(x) - velocity(x.at(n))) / (n * x.h)


ZOO: dict[str, tuple[Wrong, tuple[float, float], set[str]]] = {
    # simulator, range of its size, what is wrong of gyroscope (g) or accelerometer (a)
    "right": (lambda x, s: (x.w, x.force()), (0, 0), set()),
    "no lever arm": (lambda x, s: (x.w, x.body(x.a + UP)), (0, 0), {"a.lever"}),
    "no centripetal": (
        lambda x, s: (x.w, x.body(x.a + UP) + x.arm(1, 0)), (0, 0), {"a.centripetal"}),
    "no Euler": (
        lambda x, s: (x.w, x.body(x.a + UP) + x.arm(0, 1)), (0, 0), {"a.Euler"}),
    "other lever arm": (
        lambda x, s: (x.w, x.force() + s * x.arm()), (0.2, 1.0), {"a.lever"}),
    "linear": (
        lambda x, s: (x.w, x.force() + (s - 1) * x.body(x.a)), (1.2, 4.0),
        {"a.linear"}),
    "no linear": (lambda x, s: (x.w, x.force() - x.body(x.a)), (0, 0), {"a.linear"}),
    "gravity sign": (lambda x, s: (x.w, x.force() - 2 * x.body(UP + 0 * x.a)), (0, 0),
                     {"a.gravity"}),
    "no gravity": (lambda x, s: (x.w, x.force() - x.body(UP + 0 * x.a)), (0, 0),
                   {"a.gravity"}),
    "gravity of the sensor": (
        lambda x, s: (x.w, x.force() - x.body(UP + 0 * x.a) + UP), (0, 0),
        {"a.gravity", "a.constant"}),
    "body difference": (lambda x, s: (x.w, x.force() - np.cross(x.w, x.body(x.v))),
                        (0, 0), {"a.transport"}),
    "g": (lambda x, s: (x.w, x.force() / 9.80665), (0, 0), {"a.scale"}),
    "deg/s": (lambda x, s: (np.degrees(x.w), x.force()), (0, 0), {"g.scale"}),
    "scale": (lambda x, s: (x.w * s, x.force()), (1.05, 1.5), {"g.scale"}),
    "world rate": (lambda x, s: (x.R.apply(x.w) @ x.mount, x.force()), (0, 0),
                   {"g.frame"}),
    "world force": (lambda x, s: (x.w, x.R.apply(x.force()) @ x.mount), (0, 0),
                    {"a.frame"}),
    "late": (lambda x, s: (x.at(s).w, x.at(s).force()), (1.2, 6.0),
             {"g.delay", "a.delay"}),
    "early": (lambda x, s: (x.at(-s).w, x.force()), (1.0, 3.0), {"g.delay"}),
    "mixed": (_mixed, (0.7, 2.0), {"a.instants"}),
    "backward difference": (
        lambda x, s: (x.w, x.body(_difference(x, 1) + UP)), (0, 0), {"a.difference"}),
    "difference of four": (
        lambda x, s: (x.w, x.body(_difference(x, 4) + UP)), (0, 0), {"a.difference"}),
    "exchanged": (lambda x, s: ((x.w @ x.mount.T)[:, [1, 0, 2]] @ x.mount, x.force()),
                  (0, 0), {"g.frame"}),
    "sign of z": (lambda x, s: (x.w, x.force() @ (x.mount.T * [1, 1, -1]) @ x.mount),
                  (0, 0), {"a.frame"}),
    "zero": (lambda x, s: (x.w, 0 * x.a), (0, 0), {"a.scale"}),
}  # fmt: skip
MOUNT = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix().T


def simulated(
    name: str,
    rng: np.random.Generator,
    *,
    rate: float = 200.0,
    seconds: float = 10.0,
    noise: float = 0.0,
    single: bool = False,
    **motion: float,
) -> SimulatedImu:
    """Readings of a simulator of the zoo, with white noise of a row, m/s^2."""
    h = 1.0 / rate
    t = np.arange(round(seconds * rate)) * h
    x = Truth(Motion.of(rng, **motion), t, h, LEVER, MOUNT)
    wrong, sizes, _ = ZOO[name]
    gyro, force = (each @ MOUNT.T for each in wrong(x, rng.uniform(*sizes)))
    gyro = gyro + 0.1 * noise * rng.standard_normal(gyro.shape)
    force = force + noise * rng.standard_normal(force.shape)
    columns = [x.motion.place(t), x.R.as_quat(), gyro, force]
    if single:
        columns = [np.float32(each).astype(float) for each in columns]
    return SimulatedImu(
        time=t, position=columns[0], attitude=columns[1], gyroscope=columns[2],
        accelerometer=columns[3], source=name,
    )  # fmt: skip


def declared() -> Declared:
    """What is said of them all."""
    return Declared(lever=LEVER, mount=MOUNT, gravity=-UP)


def names(found: Audit) -> set[str]:
    """What was found wrong, as the zoo spells it."""
    wrong = {f"{x.name[0]}.{name}" for x in found.sensors for name in x.wrong}
    return wrong | {f"{x.name[0]}.frame" for x in found.sensors if x.frame}
