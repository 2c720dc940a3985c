r"""Scenarios for an attitude filter: motions recorded once, trials drawn over them.

================== ===============================================================
scenario           what happens; the accelerometer reads gravity alone, unless it
                   says otherwise
================== ===============================================================
gimbal slow        servos turn the body through twelve poses, 2 s a move
gimbal fast        the same with thirty poses, 0.8 s a move: to 730 degrees/s
lever arm          the same as slow, with what the IMU feels 27 mm from the axes
handheld           a trembling hand, with the acceleration that it gives
pivot              a spin about a pivot, off-centre, with its centripetal acceleration
long rest          nothing moves
vibration          gimbal slow, and 1 m/s^2 at 42 Hz along each axis
magnetic           gimbal slow; iron adds half a field for a third of the time
disturbance
unknown start      gimbal slow, started anywhere
================== ===============================================================

A reading of a trial is the truth with its own noise and, of the gyroscope, a bias b of
its own, which walks: over a step of h seconds the average of white noise has the
standard deviation :math:`N/\sqrt h`, and the average of the walk is the bias at the
step's start with :math:`K\sqrt h\,(\xi/2 + \zeta/\sqrt{12})`, where :math:`K\sqrt h\,
\xi` is the walk's step.

========================= ========================================================
words                     what is wrong
========================= ========================================================
``gyroscope noise X``     it is told X times the angle random walk
``accelerometer noise X`` it is told X times the noise of the accelerometer
``magnetometer noise X``  it is told X times the noise of the magnetometer
``scale X``               the gyroscope's three scales are off by X
``turned X``              the gyroscope's axes are turned by X rad about (1, 1, 1)
``calibration X``         each entry of the gyroscope's matrix is off by a random error
                          of standard deviation X, its own in each trial
========================= ========================================================

``gimbal slow, scale 1e-3, gyroscope noise 2`` is a scenario with two of them. It is one
string, so that a list of such is an axis of a suite.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from simval.arrays import Array, ReadOnly
from simval.errors import InputError
from simval.geometry import (
    attitude_matrix,
    compose,
    from_rotation_vector,
    random_quaternions,
)
from simval.imu.filters.signals import FilterInput, Told
from simval.scene import average_rates, simulate_cached
from simval.shapes import Float
from simval.theory import FilterPath

MOST: Final = MappingProxyType(
    {
        "gyroscope noise": (1e-3, 1e3),
        "accelerometer noise": (1e-3, 1e3),
        "magnetometer noise": (1e-3, 1e3),
        "scale": (-0.1, 0.1),
        "turned": (-0.1, 0.1),
        "calibration": (0.0, 0.1),
    }
)
"""Least and greatest X by its words."""


@dataclass(frozen=True, slots=True)
class Wrong:
    """Deliberate errors in a scenario; the defaults have none."""

    gyroscope_noise: float = 1.0
    accelerometer_noise: float = 1.0
    magnetometer_noise: float = 1.0
    scale: float = 0.0
    turned: float = 0.0
    calibration: float = 0.0

    @property
    def M(self) -> Float[Array, "3 3"]:
        """Matrix that multiplies the rate in the gyroscope."""
        half = self.turned / 2.0
        axis = np.ones(3) / np.sqrt(3.0)
        q = np.append(np.sin(half) * axis, np.cos(half))
        return (1.0 + self.scale) * attitude_matrix(q)

    def told(self, true: Told) -> Told:
        """Settings that the filter is given, from the true ones."""
        return replace(
            true,
            gyroscope_noise=self.gyroscope_noise * true.gyroscope_noise,
            accelerometer_noise=self.accelerometer_noise * true.accelerometer_noise,
            magnetometer_noise=self.magnetometer_noise * true.magnetometer_noise,
        )


def wrong_of(parts: Sequence[str]) -> Wrong:
    """Read deliberate errors from words."""
    found: dict[str, float] = {}
    for part in parts:
        name, _, number = part.rpartition(" ")
        least, most = MOST.get(name, (np.inf, -np.inf))
        try:
            value = float(number)
        except ValueError:
            value = np.nan
        if name in found:
            fault = f"`{name}` twice; give it once"
        elif name not in MOST:
            known = ", ".join(f"`{each} X`" for each in MOST)
            fault = f"{part[:60]!r}; after its name there may be {known}"
        elif not least <= value <= most:
            between = f"from {least:g} to {most:g}"
            fault = f"{part[:60]!r}; the number of `{name}` must be {between}"
        else:
            found[name] = value
            continue
        msg = f"`scenario` has {fault}"
        raise InputError(msg)
    return Wrong(**{name.replace(" ", "_"): value for name, value in found.items()})


ROWS: Final = 500.0  # Hz, of the scenes
SHAKE: Final = (1.0, 42.0)  # m/s^2 and Hz
IRON: Final = 0.5  # of the field, eastwards and up
ANYWHERE: Final = "unknown start"
UNKNOWN: Final = np.pi / np.sqrt(3.0)  # rad per axis of a turn that may be any


_SLOW = ("gimbal", {"poses": 12, "move_time": 2.0, "hold_time": 0.5})
_SCENES: Final[Mapping[str, tuple[str, dict[str, Any]]]] = MappingProxyType(
    {
        "gimbal slow": _SLOW,
        "gimbal fast": ("gimbal", {"poses": 30, "move_time": 0.8, "hold_time": 0.5}),
        "lever arm": _SLOW,
        "handheld": ("handheld", {"poses": 20}),
        "pivot": ("pivot", {"spin_rate": 4.0, "turns": 40.0}),
        "long rest": ("gimbal", {"poses": 2, "first_hold": 100.0}),
        "vibration": _SLOW,
        "magnetic disturbance": _SLOW,
        "unknown start": _SLOW,
    }
)
"""Name of the scene, and its parameters."""

FELT: Final = ("lever arm", "handheld", "pivot")
"""Scenarios whose own acceleration is felt."""

NAMES: Final = tuple(_SCENES)


def spelled(text: str) -> str:
    """Standard spelling of a scenario."""
    return ", ".join(" ".join(part.split()) for part in text.split(","))


def scenario_of(text: str) -> tuple[str, Wrong]:
    """Name of the scenario, and the errors in it."""
    name, *parts = text.split(", ")
    if name not in NAMES:
        msg = (
            f"`scenario` is {name[:60]!r}; it must be one of "
            f"{', '.join(NAMES)}, and faults may follow after a comma"
        )
        raise InputError(msg)
    return name, wrong_of(parts)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course(ReadOnly):
    """Motion of a scenario, with disturbances of its sensors, row by row.

    The first row of the attitude is before the first step.
    """

    dt: Float[Array, " T"]  # s
    attitude: Float[Array, "T+1 4"]  # world to body
    rate: Float[Array, "T 3"]  # average over the step, rad/s
    up: Float[Array, "T 3"]  # gravity's reaction in body axes, m/s^2
    field: Float[Array, "T 3"]  # in body axes, T
    acceleration: Float[Array, "T 3"]  # which the accelerometer reads besides, m/s^2
    iron: Float[Array, "T 3"]  # which the magnetometer reads besides, T
    g: float  # m/s^2
    magnetic: Float[Array, "3"]  # the field in the world, T

    @property
    def time(self) -> Float[Array, " T"]:
        """Time at the end of each step, s from the start."""
        return np.cumsum(self.dt)

    @property
    def path(self) -> FilterPath:
        """The motion, as theory takes it."""
        return FilterPath(dt=self.dt, attitude=self.attitude)

    @property
    def strength(self) -> float:
        """Strength of the field, T."""
        return float(np.linalg.norm(self.magnetic))

    @property
    def disturbed(self) -> bool:
        """True if a sensor has a disturbance that no filter knows."""
        return bool(np.any(self.acceleration) or np.any(self.iron))


@lru_cache(maxsize=16)
def course(scenario: str, rate: float, seconds: float) -> Course:
    """Motion of a scenario at a rate, for some seconds.

    Raises
    ------
    InputError
        If the rate does not divide that of the scenes, or the scenario is shorter.
    """
    scene, words = _SCENES[scenario]
    run = simulate_cached(scene, **words)
    every, count = steps_of(run.rate, rate, seconds)
    most = (len(run.time) - 1) // every
    if count > most:
        msg = (
            f"`seconds` is {seconds:g}, but the scenario {scenario!r} lasts "
            f"{most / rate:.4g} s; ask for less"
        )
        raise InputError(msg)
    kept = slice(None, count * every + 1, every)
    attitude, time = run.attitude[kept], run.time[kept]
    up = attitude_matrix(attitude[1:]) @ np.array([0.0, 0.0, run.g])
    felt = np.zeros_like(up)
    if scenario in FELT:
        felt = run.specific_force[kept][1:] - up
    clock = time[1:] - time[0]
    if scenario == "vibration":
        wave = np.sin(2.0 * np.pi * SHAKE[1] * clock)
        felt = felt + SHAKE[0] * wave[:, None]
    magnetic = np.array(run.magnetic)
    return Course(
        dt=np.diff(time),
        attitude=attitude,
        rate=average_rates(run, every)[1 : count + 1],
        up=up,
        field=attitude_matrix(attitude[1:]) @ magnetic,
        acceleration=felt,
        iron=_iron(scenario, attitude[1:], magnetic, clock),
        g=run.g,
        magnetic=magnetic,
    )


def steps_of(own: float, rate: float, seconds: float) -> tuple[int, int]:
    """Rows of the scene in one step, and the number of steps."""
    every = round(own / rate)
    if every < 1 or abs(own / every - rate) > 1e-6 * rate:
        msg = f"`rate` is {rate:g} Hz; it must be {own:g} divided by a whole number"
        raise InputError(msg)
    return every, round(seconds * rate)


def _iron(
    scenario: str,
    attitude: Float[Array, "T 4"],
    magnetic: Float[Array, "3"],
    clock: Float[Array, " T"],
) -> Float[Array, "T 3"]:
    """Field of a piece of iron that passes in the second third of the time."""
    if scenario != "magnetic disturbance":
        return np.zeros((len(clock), 3))
    share = np.clip(3.0 * clock / clock[-1] - 1.0, 0.0, 1.0)
    near = np.where(share < 1.0, np.sin(np.pi * share) ** 2, 0.0)  # comes and goes
    world = IRON * np.linalg.norm(magnetic) * np.array([0.0, -0.8, 0.6])
    return near[:, None] * (attitude_matrix(attitude) @ world)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Imperfect:
    """The sensors as they are, with noise, bias, and errors left by calibrations."""

    gyroscope_noise: float  # N, rad/s/sqrt(Hz)
    gyroscope_walk: float  # K, rad/s^2/sqrt(Hz)
    accelerometer_noise: float  # per axis and row, m/s^2
    magnetometer_noise: float  # per axis and row, T
    start_std: float  # per axis, rad, of the start that is given
    bias_std: float  # per axis, rad/s, about the 0 that is given
    M: Float[Array, "3 3"]  # which the gyroscope multiplies rates by; I is right
    calibration_std: float  # of each entry of M about that, a trial's own

    def told(self, course: Course) -> Told:
        """The true settings for a filter."""
        return Told(
            gyroscope_noise=self.gyroscope_noise,
            gyroscope_walk=self.gyroscope_walk,
            accelerometer_noise=self.accelerometer_noise,
            magnetometer_noise=self.magnetometer_noise,
            gravity=course.g,
            field=course.magnetic,
            start_std=self.start_std,
            bias_std=self.bias_std,
        )


Simulated = tuple[FilterInput, Float[Array, "n T 3"]]
"""Readings of some trials, and the gyroscope's bias after each step."""


def drawn(
    course: Course,
    sensors: Imperfect,
    told: Told,
    count: int,
    rng: np.random.Generator,
    anywhere: bool = False,
) -> Simulated:
    """Draw the noise of some trials."""
    shape = (count, len(course.dt), 3)
    start = _start(course, sensors.start_std, count, rng, anywhere)
    first = sensors.bias_std * rng.standard_normal((count, 1, 3))
    root = np.sqrt(course.dt)[:, None]
    xi, zeta = rng.standard_normal(shape), rng.standard_normal(shape)
    step = sensors.gyroscope_walk * root * xi
    bias = first + np.cumsum(step, axis=1)
    inside = bias - step / 2.0 + sensors.gyroscope_walk * root * zeta / np.sqrt(12.0)
    white = sensors.gyroscope_noise / root * rng.standard_normal(shape)
    force, magnetic = (rng.standard_normal(shape) for _ in range(2))
    M = sensors.M + sensors.calibration_std * rng.standard_normal((count, 3, 3))
    given = FilterInput(
        dt=course.dt,
        gyroscope=course.rate @ M.mT + inside + white,
        accelerometer=course.up
        + course.acceleration
        + sensors.accelerometer_noise * force,
        magnetometer=course.field + course.iron + sensors.magnetometer_noise * magnetic,
        start=start,
        told=told,
    )
    return given, bias


def _start(
    course: Course, std: float, count: int, rng: np.random.Generator, anywhere: bool
) -> Float[Array, "n 4"]:
    if anywhere:
        return random_quaternions(count, rng)
    truth = np.broadcast_to(course.attitude[0], (count, 4))
    q = compose(truth, from_rotation_vector(std * rng.standard_normal((count, 3))))
    return q / np.linalg.norm(q, axis=1, keepdims=True)
