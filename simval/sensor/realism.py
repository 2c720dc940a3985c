r"""What a real accelerometer adds to the model: each effect optional, truth recorded.

A row of specific force passes, in this order, through

.. math:: f' &= \mathrm{clip}(f + v(t),\ \pm r g_0)  \tag{E1}\\
   y' &= (T K)^{-1} f' + B + b(t) + n  \tag{E2}\\
   y &= \mathrm{clip}(q\,\mathrm{round}(y'/q),\ y_{min}, y_{max})  \tag{E3}

with the vibration :math:`v`, the mechanical range :math:`r`, the bias random walk
:math:`b`, white noise :math:`n`, the quantum :math:`q` and the converter's limits.
Each random effect draws from a stream of its own: switching one on leaves the others'
numbers alone.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arguments import instance
from simval.arrays import (
    Array,
    frozen,
    nonnegative_number,
    physical_array,
    positive_number,
)
from simval.errors import InputError
from simval.sensor.model import AccelerometerModel
from simval.shapes import Float
from simval.text import shown

STANDARD_GRAVITY = 9.80665  # m/s^2, the unit of `range_g`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effects:
    """Imperfections beside misalignment, scale and bias; the defaults switch all off.

    Attributes
    ----------
    noise_std_raw : Array or None
        White noise of each axis and sample, raw units, (3,) or one number for all;
        None takes the model's own.
    bias_walk_raw_per_sqrt_s : Array
        Bias random walk of each axis, raw units per square root of a second, (3,): the
        standard deviation that it has reached after one second.
    vibration_m_s2 : Array
        Amplitude of a sine vibration along each sensor axis, m/s^2, (3,).
    vibration_hz : float
        Its frequency, Hz.
    range_g : float or None
        The sensing element stops at plus and minus this, standard gravities.
    quantum_raw : float
        Step of the converter, raw units; 0 does not quantise.
    limits_raw : tuple of float or None
        Least and greatest reading of the converter, raw units.

    Raises
    ------
    InputError
        If a value is negative, not finite, or the limits are not in order.
    """

    noise_std_raw: Array | float | None = None
    bias_walk_raw_per_sqrt_s: Array | float = 0.0
    vibration_m_s2: Array | float = 0.0
    vibration_hz: float = 0.0
    range_g: float | None = None
    quantum_raw: float = 0.0
    limits_raw: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("noise_std_raw", "bias_walk_raw_per_sqrt_s", "vibration_m_s2"):
            own = name == "noise_std_raw" and self.noise_std_raw is None  # the model's
            if not own:
                object.__setattr__(self, name, _axes(name, getattr(self, name)))
        for name, unit in (("vibration_hz", "Hz"), ("quantum_raw", "raw units")):
            number = nonnegative_number(name, getattr(self, name), unit)
            object.__setattr__(self, name, number)
        if self.range_g is not None:
            reach = positive_number("range_g", self.range_g, "g")
            object.__setattr__(self, "range_g", reach)
        if self.limits_raw is not None:
            low, high = _limits(self.limits_raw)
            object.__setattr__(self, "limits_raw", (low, high))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Readings:
    """Raw readings, and the truth of every effect in them.

    Attributes
    ----------
    raw : Array
        What the sensor puts out, raw units, (n, 3).
    vibration_m_s2 : Array
        Vibration that was added to the specific force, m/s^2, (n, 3).
    bias_walk_raw : Array
        Bias beyond the model's, raw units, (n, 3).
    noise_raw : Array
        White noise, raw units, (n, 3).
    out_of_range : NDArray[np.bool_]
        Where the sensing element stopped, (n, 3).
    saturated : NDArray[np.bool_]
        Where the converter stopped, (n, 3).
    """

    raw: Float[Array, "n 3"]
    vibration_m_s2: Float[Array, "n 3"]
    bias_walk_raw: Float[Array, "n 3"]
    noise_raw: Float[Array, "n 3"]
    out_of_range: NDArray[np.bool_]
    saturated: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for name in ("raw", "vibration_m_s2", "bias_walk_raw", "noise_raw"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


def read_sensor(
    model: AccelerometerModel,
    effects: Effects,
    time: Float[Array, " n"],
    specific_force: Float[Array, "n 3"],
    rng: np.random.Generator,
) -> Readings:
    """Readings of an imperfect sensor, eqs. (E1) to (E3).

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
    time = physical_array("time", time, (None,))
    force = physical_array("specific_force", specific_force, (None, 3))
    if not (time.ndim == 1 and force.shape == (len(time), 3)):
        msg = (
            f"`time` has shape {time.shape} and `specific_force` {force.shape}; "
            "(n,) and (n, 3) of one recording are needed"
        )
        raise InputError(msg)
    if not np.all(np.diff(time) > 0.0):
        msg = "`time` does not increase; give the rows in order of time"
        raise InputError(msg)
    for_noise, for_walk, for_phase = rng.spawn(3)
    shaken, felt = _felt(effects, time, force, for_phase)
    std = model.noise_std if effects.noise_std_raw is None else effects.noise_std_raw
    noise = np.asarray(std) * for_noise.standard_normal(force.shape)
    walk = _walk(effects, time, for_walk)
    raw = np.linalg.solve(model.matrix, felt.T).T + model.B + walk + noise
    if effects.quantum_raw > 0.0:
        raw = effects.quantum_raw * np.round(raw / effects.quantum_raw)
    low, high = effects.limits_raw or (-np.inf, np.inf)
    return Readings(
        raw=np.clip(raw, low, high),
        vibration_m_s2=shaken - force,
        bias_walk_raw=walk,
        noise_raw=noise,
        out_of_range=felt != shaken,
        saturated=(raw < low) | (raw > high),
    )


def _felt(
    effects: Effects,
    time: Float[Array, " n"],
    force: Float[Array, "n 3"],
    rng: np.random.Generator,
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    # force with vibration, and the same within the element's range, (E1)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    swing = np.sin(2.0 * np.pi * effects.vibration_hz * time[:, None] + phase)
    shaken = force + np.asarray(effects.vibration_m_s2) * swing
    if effects.range_g is None:
        return shaken, shaken
    most = effects.range_g * STANDARD_GRAVITY
    return shaken, np.clip(shaken, -most, most)


def _walk(
    effects: Effects, time: Float[Array, " n"], rng: np.random.Generator
) -> Float[Array, "n 3"]:
    # a Wiener process from zero: increments of variance density^2 dt
    steps = np.sqrt(np.diff(time, prepend=time[:1]))[:, None]
    density = np.asarray(effects.bias_walk_raw_per_sqrt_s)
    return np.cumsum(density * steps * rng.standard_normal((len(time), 3)), axis=0)


def _axes(name: str, value: Any) -> Float[Array, "3"]:
    array = physical_array(name, value, ())
    if array.shape not in ((), (3,)) or not np.all(array >= 0.0):
        msg = f"`{name}` is {shown(value)}; give one number or three, each 0 or more"
        raise InputError(msg)
    return frozen(np.broadcast_to(array, (3,)))


def _limits(value: Any) -> tuple[float, float]:
    array = physical_array("limits_raw", value, (2,))
    if array.shape != (2,) or not array[0] < array[1]:
        msg = f"`limits_raw` is {shown(value)}; give the least and the greatest"
        raise InputError(msg)
    return float(array[0]), float(array[1])


def effects_from(values: dict[str, Any]) -> Effects:
    """Effects from plain values, as a file holds them.

    Raises
    ------
    InputError
        If a name is unknown or a value cannot be used.
    """
    instance("values", values, dict)
    known = Effects.__dataclass_fields__
    for name in values:
        if name not in known:
            msg = f"there is no effect `{name}`; there are {', '.join(known)}"
            raise InputError(msg)
    try:
        return Effects(**values)
    except TypeError as error:
        msg = f"an effect cannot be used: {error}"
        raise InputError(msg) from None
