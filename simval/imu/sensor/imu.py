r"""An inertial measurement unit: what each sensor of it reads of one motion.

A row of specific force passes, in this order, through

.. math:: f' &= \mathrm{clip}(f(t - d) + v(t),\ \pm r g_0)  \tag{E1}\\
   y' &= (T K)^{-1} f' + B  \tag{E2}

with the vibration :math:`v`, the delay :math:`d` and the mechanical range :math:`r`,
and then through the electronics, eq. (E3). A gyroscope's rate, with the g-sensitivity
of its model, and a magnetometer's field pass in the same way. Each sensor draws from a
stream of its own.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arguments import instance
from simval.arrays import Array, frozen, nonnegative_number, physical_array
from simval.errors import InputError
from simval.imu.sensor.effects import (
    Effects,
    EffectStreams,
    Electronics,
    GyroscopeEffects,
    MagnetometerEffects,
    Readings,
    converted,
    delayed,
    even_rate,
    streams_of,
    white_std,
)
from simval.imu.sensor.models import (
    AccelerometerModel,
    GyroscopeModel,
    MagnetometerModel,
    unscaled,
)
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """What the sensors of an IMU are to measure, in their common axes.

    Attributes
    ----------
    time : Array
        Seconds, (n,), increasing.
    specific_force : Array
        Of each instant, m/s^2, (n, 3).
    rate : Array
        Body rate, rad/s, (n, 3): the average over the step that ends at the row, as
        `simval.scene.average_rates` gives it.
    field : Array
        Magnetic field of each instant, T, (n, 3).

    Raises
    ------
    InputError
        If the rows do not belong together, or time does not increase.
    """

    time: Float[Array, " n"]
    specific_force: Float[Array, "n 3"]
    rate: Float[Array, "n 3"]
    field: Float[Array, "n 3"]

    def __post_init__(self) -> None:
        time = _clock(self.time)
        for name in ("specific_force", "rate", "field"):
            rows = _rows(name, getattr(self, name), time)
            object.__setattr__(self, name, frozen(rows))
        object.__setattr__(self, "time", frozen(time))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuModel:
    """Three sensors on one clock; one that is None is ideal.

    Attributes
    ----------
    accelerometer : AccelerometerModel
        Its noise where its effects state none.
    accelerometer_effects : Effects
        What the accelerometer adds to its model.
    gyroscope : GyroscopeModel or None
        Its noise where its effects state none.
    gyroscope_effects : GyroscopeEffects
        What the gyroscope adds to its model.
    magnetometer : MagnetometerModel or None
        Its noise where its effects state none.
    magnetometer_effects : MagnetometerEffects
        What the magnetometer adds to its model.
    clock_jitter_s : float
        Standard deviation of each row's time stamp about the time that it is of, s.

    Raises
    ------
    InputError
        If the jitter is negative or not finite, or a part is of another kind.
    """

    accelerometer: AccelerometerModel
    accelerometer_effects: Effects = field(default_factory=Effects)
    gyroscope: GyroscopeModel | None = None
    gyroscope_effects: GyroscopeEffects = field(default_factory=GyroscopeEffects)
    magnetometer: MagnetometerModel | None = None
    magnetometer_effects: MagnetometerEffects = field(
        default_factory=MagnetometerEffects
    )
    clock_jitter_s: float = 0.0

    def __post_init__(self) -> None:
        instance("accelerometer", self.accelerometer, AccelerometerModel)
        instance("accelerometer_effects", self.accelerometer_effects, Effects)
        instance("gyroscope_effects", self.gyroscope_effects, GyroscopeEffects)
        kind = MagnetometerEffects
        instance("magnetometer_effects", self.magnetometer_effects, kind)
        if self.gyroscope is not None:
            instance("gyroscope", self.gyroscope, GyroscopeModel)
        if self.magnetometer is not None:
            instance("magnetometer", self.magnetometer, MagnetometerModel)
        jitter = nonnegative_number("clock_jitter_s", self.clock_jitter_s, "s")
        object.__setattr__(self, "clock_jitter_s", jitter)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuReadings:
    """What the three sensors put out, and when they say that they did.

    Attributes
    ----------
    stamp : Array
        Time stamps, s, (n,); the true times are the motion's.
    accelerometer : Readings
        Raw readings and the truth of its effects.
    gyroscope : Readings or None
        The same; None where the model has no gyroscope, which is ideal then.
    magnetometer : Readings or None
        The same of the magnetometer.
    """

    stamp: Float[Array, " n"]
    accelerometer: Readings
    gyroscope: Readings | None
    magnetometer: Readings | None


def read_imu(imu: ImuModel, motion: Motion, rng: np.random.Generator) -> ImuReadings:
    """Readings of an imperfect IMU, eqs. (E1) to (E3) for each of its sensors.

    Parameters
    ----------
    imu : ImuModel
        The sensors.
    motion : Motion
        What they are to measure.
    rng : numpy.random.Generator
        Spawns one stream for each sensor, and one for the clock.

    Returns
    -------
    ImuReadings
        Raw readings, the truth of each effect, and the time stamps.

    Raises
    ------
    InputError
        If the jitter puts time stamps out of order, or a density is asked for at steps
        that are not even.
    """
    instance("imu", imu, ImuModel)
    instance("motion", motion, Motion)
    instance("rng", rng, np.random.Generator)
    for_force, for_rate, for_field, for_clock = rng.spawn(4)
    return ImuReadings(
        stamp=_stamped(motion.time, imu.clock_jitter_s, for_clock),
        accelerometer=read_sensor(
            imu.accelerometer,
            imu.accelerometer_effects,
            motion.time,
            motion.specific_force,
            for_force,
        ),
        gyroscope=None
        if imu.gyroscope is None
        else _read_gyroscope(imu.gyroscope, imu.gyroscope_effects, motion, for_rate),
        magnetometer=None
        if imu.magnetometer is None
        else _read_magnetometer(
            imu.magnetometer, imu.magnetometer_effects, motion, for_field
        ),
    )


def read_sensor(
    model: AccelerometerModel,
    effects: Effects,
    time: Float[Array, " n"],
    specific_force: Float[Array, "n 3"],
    rng: np.random.Generator,
) -> Readings:
    """Readings of an imperfect accelerometer, eqs. (E1) to (E3).

    Parameters
    ----------
    model : AccelerometerModel
        Misalignment, scale and bias; its noise where the effects state none.
    effects : Effects
        The imperfections.
    time : Array
        Seconds, (n,), increasing.
    specific_force : Array
        Truth in sensor axes, m/s^2, (n, 3).
    rng : numpy.random.Generator
        Spawns one stream for each random effect.

    Returns
    -------
    Readings
        Raw readings and the truth of each effect.

    Raises
    ------
    InputError
        If time and force do not belong together.
    """
    instance("model", model, AccelerometerModel)
    instance("effects", effects, Effects)
    instance("rng", rng, np.random.Generator)
    time = _clock(time)
    force = _rows("specific_force", specific_force, time)
    streams = streams_of(rng)
    phase = streams.phase.uniform(0.0, 2.0 * np.pi, 3)
    swing = np.sin(2.0 * np.pi * effects.vibration_hz * time[:, None] + phase)
    late = delayed(force, effects.delay_s, time)
    shaken = late + np.asarray(effects.vibration_m_s2) * swing
    felt = np.clip(shaken, -effects.reach, effects.reach)
    ideal = unscaled(model.matrix, felt) + model.B
    std = white_std(effects, model.noise_std, time)
    return _readings(ideal, effects, std, time, streams, shaken - late, felt != shaken)


def _read_gyroscope(
    model: GyroscopeModel,
    effects: GyroscopeEffects,
    motion: Motion,
    rng: np.random.Generator,
) -> Readings:
    # the rate within the range, then the model with its g-sensitivity
    time, streams = motion.time, streams_of(rng)
    rate = delayed(motion.rate, effects.delay_s, time)
    felt = np.clip(rate, -effects.reach, effects.reach)
    force = delayed(motion.specific_force, effects.delay_s, time)
    ideal = unscaled(model.M, felt) + model.B
    if model.G is not None:
        ideal = ideal + force @ model.G.T
    density = model.angle_random_walk
    own = density * np.sqrt(even_rate(time)) if density else 0.0
    std = white_std(effects, own, time)
    still = np.zeros(rate.shape)
    return _readings(ideal, effects, std, time, streams, still, felt != rate)


def _read_magnetometer(
    model: MagnetometerModel,
    effects: MagnetometerEffects,
    motion: Motion,
    rng: np.random.Generator,
) -> Readings:
    # the field within the range, then the model
    time, streams = motion.time, streams_of(rng)
    late = delayed(motion.field, effects.delay_s, time)
    felt = np.clip(late, -effects.reach, effects.reach)
    ideal = unscaled(model.M, felt) + model.b
    std = white_std(effects, model.noise_std, time)
    still = np.zeros(late.shape)
    return _readings(ideal, effects, std, time, streams, still, felt != late)


def _readings(
    ideal: Float[Array, "n 3"],
    effects: Electronics,
    std: Float[Array, "3"],
    time: Float[Array, " n"],
    streams: EffectStreams,
    vibration: Float[Array, "n 3"],
    out_of_range: NDArray[np.bool_],
) -> Readings:
    # the model's readings through the electronics, with the element's own truth
    parts, saturated = converted(ideal, effects, std, time, streams)
    return Readings(
        vibration_m_s2=vibration,
        out_of_range=out_of_range,
        saturated=saturated,
        **parts,
    )


def _stamped(
    time: Float[Array, " n"], jitter: float, rng: np.random.Generator
) -> Float[Array, " n"]:
    # time stamps that are off by white noise, but in order
    stamp = time + jitter * rng.standard_normal(len(time)) if jitter else time
    if not np.all(np.diff(stamp) > 0.0):
        step = float(np.diff(time).min())
        msg = (
            f"`clock_jitter_s` is {jitter:g} s and rows are {step:g} s apart, so time "
            f"stamps are out of order; give a tenth of the step, {step / 10:.2g} s, at "
            "the most"
        )
        raise InputError(msg)
    return frozen(stamp)


def _clock(time: Any) -> Float[Array, " n"]:
    clock = physical_array("time", time, (None,))
    if not (clock.ndim == 1 and np.all(np.diff(clock) > 0.0)):
        msg = "`time` does not increase; give the rows in order of time"
        raise InputError(msg)
    return clock


def _rows(name: str, value: Any, time: Float[Array, " n"]) -> Float[Array, "n 3"]:
    rows = physical_array(name, value, (None, 3))
    if rows.shape != (len(time), 3):
        msg = (
            f"`time` has shape {time.shape} and `{name}` {rows.shape}; (n,) and (n, 3) "
            "of one recording are needed"
        )
        raise InputError(msg)
    return rows
