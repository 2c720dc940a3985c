r"""An inertial measurement unit: what its sensors read during one motion.

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

from simval.arguments import instance
from simval.arrays import Array, frozen, nonnegative_number, physical_array
from simval.errors import InputError
from simval.imu.sensor.effects import (
    Effects,
    Electronics,
    GyroscopeEffects,
    MagnetometerEffects,
    NoiseModel,
    Readings,
    delayed,
    even_rate,
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
    """A motion that the sensors of an IMU measure, in their common axes.

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
    """Three sensors on one clock; a sensor that is None is ideal.

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
        for name, kind, needed in (
            ("accelerometer", AccelerometerModel, True),
            ("accelerometer_effects", Effects, True),
            ("gyroscope_effects", GyroscopeEffects, True),
            ("magnetometer_effects", MagnetometerEffects, True),
            ("gyroscope", GyroscopeModel, False),
            ("magnetometer", MagnetometerModel, False),
        ):
            if needed or getattr(self, name) is not None:
                instance(name, getattr(self, name), kind)
        jitter = nonnegative_number("clock_jitter_s", self.clock_jitter_s, "s")
        object.__setattr__(self, "clock_jitter_s", jitter)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuReadings:
    """Readings of the three sensors, with their time stamps.

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


def read_imu(imu: ImuModel, motion: Motion, rng: "np.random.Generator") -> ImuReadings:
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
    time, force = motion.time, motion.specific_force
    accelerometer = read_sensor(
        imu.accelerometer, imu.accelerometer_effects, time, force, for_force
    )
    gyroscope = magnetometer = None
    if imu.gyroscope is not None:
        turning, effects = imu.gyroscope, imu.gyroscope_effects
        G = np.zeros((3, 3)) if turning.G is None else turning.G
        offset = delayed(force, effects.delay_s, time) @ G.T
        density = turning.angle_random_walk
        own = density * np.sqrt(even_rate(time)) if density else 0.0
        linear = turning.M, turning.B, offset
        gyroscope = _read(linear, effects, own, time, motion.rate, for_rate)
    if imu.magnetometer is not None:
        compass = imu.magnetometer
        magnetometer = _read(
            (compass.M, compass.b, 0.0), imu.magnetometer_effects, compass.noise_std,
            time, motion.field, for_field,
        )  # fmt: skip
    return ImuReadings(
        stamp=_stamped(time, imu.clock_jitter_s, for_clock),
        accelerometer=accelerometer,
        gyroscope=gyroscope,
        magnetometer=magnetometer,
    )


def read_sensor(
    model: AccelerometerModel,
    effects: Effects,
    time: Float[Array, " n"],
    specific_force: Float[Array, "n 3"],
    rng: "np.random.Generator",
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
    linear = model.matrix, model.B, 0.0
    return _read(linear, effects, model.noise_std, time, force, rng)


def _read(
    linear: tuple[Float[Array, "3 3"], Float[Array, "3"], Any],
    effects: Electronics,
    own_std: float,
    time: Float[Array, " n"],
    truth: Float[Array, "n 3"],
    rng: "np.random.Generator",
) -> Readings:
    # (E1) to (E3) of a sensor's matrix, bias, and what else its readings are off by; a
    # new effect's stream is a child of another's, so the others' stay
    for_noise, for_walk, for_phase, for_flicker = rng.spawn(4)
    late = shaken = delayed(truth, effects.delay_s, time)
    if isinstance(effects, Effects):
        phase = for_phase.uniform(0.0, 2.0 * np.pi, 3)
        swing = np.sin(2.0 * np.pi * effects.vibration_hz * time[:, None] + phase)
        shaken = late + np.asarray(effects.vibration_m_s2) * swing
    felt = np.clip(shaken, -effects.reach, effects.reach)
    std = white_std(effects, own_std, time)
    noise = std * for_noise.standard_normal(truth.shape)
    # a Wiener process from zero: increments of variance density^2 dt
    steps = np.sqrt(np.diff(time, prepend=time[:1]))[:, None]
    density = np.asarray(effects.bias_walk_raw_per_sqrt_s)
    walk = np.cumsum(density * steps * for_walk.standard_normal(truth.shape), axis=0)
    coloured = NoiseModel(flicker_raw=effects.flicker_raw)
    flicker = _drawn(coloured, time, for_flicker)
    drifting = NoiseModel(
        markov_raw_per_sqrt_s=effects.bias_markov_raw_per_sqrt_s,
        markov_s=effects.bias_markov_s,
        ramp_raw_per_s=effects.bias_ramp_raw_per_s,
        sine_raw=effects.sine_raw,
        sine_hz=effects.sine_hz,
    )
    drift = _drawn(drifting, time, for_walk.spawn(1)[0])
    matrix, bias, offset = linear
    raw = unscaled(matrix, felt) + bias + offset + walk + noise + flicker + drift
    if effects.quantum_raw > 0.0:
        raw = effects.quantum_raw * np.round(raw / effects.quantum_raw)
    low, high = effects.limits_raw or (-np.inf, np.inf)
    return Readings(
        raw=np.clip(raw, low, high),
        vibration_m_s2=shaken - late,
        bias_walk_raw=walk,
        flicker_raw=flicker,
        drift_raw=drift,
        noise_raw=noise,
        out_of_range=felt != shaken,
        saturated=(raw < low) | (raw > high),
    )


def _drawn(
    model: NoiseModel, time: Float[Array, " n"], rng: "np.random.Generator"
) -> Float[Array, "n 3"]:
    # of a clock with even steps, where there is any
    sizes = (model.flicker_raw, model.markov_raw_per_sqrt_s, model.ramp_raw_per_s)
    if not any(np.any(size) for size in (*sizes, model.sine_raw)):
        return np.zeros((len(time), 3))
    return model.draw(len(time), even_rate(time), rng)


def _stamped(
    time: Float[Array, " n"], jitter: float, rng: "np.random.Generator"
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
