r"""Noise of a three-axis sensor: white, flicker, walk, Markov bias, ramp and sine.

Each axis adds to its readings, at steps of :math:`h` seconds, the sum of

.. math:: n_k &= N\,h^{-1/2}\,g_k  \tag{C1}\\
   w_k &= K\,h^{1/2}\,(g'_1 + \dots + g'_k),\quad w_0 = 0  \tag{C2}\\
   b_k &= B \sum_{j \ge 0} c_j\,g''_{k-j},\quad
   c_0 = 1,\ c_j = c_{j-1}\,(j - 1/2)/j  \tag{C3}

of independent standard normal numbers; of a Markov bias (exponentially correlated
noise) of the driving noise q and the correlation time :math:`\tau`, exact at any step,
of a ramp and of a sine, its phase drawn once for each axis:

.. math:: m_k &= \varphi\,m_{k-1}
   + \sqrt{\tfrac12 q^2\tau\,(1 - \varphi^2)}\;g_k,\quad
   \varphi = e^{-h/\tau},\ m_0 = \sqrt{\tfrac12 q^2\tau}\;g_0  \tag{C4}\\
   s_k &= R\,h\,k + A \sin(2\pi f h k + \psi)  \tag{C5}

The spectra of the first three, of both signs of the frequency,
are :math:`N^2`, :math:`K^2/(2\pi f)^2` and :math:`B^2/(2\pi f)` far below the rate
(exactly, :math:`2\pi f` is :math:`2\sin(\pi f h)/h`), and so their Allan variances are
:math:`N^2/\tau`, :math:`K^2\tau/3` and :math:`(2\ln 2/\pi)\,B^2` for averages over many
rows. Flicker noise has no beginning: the filter runs over twice the rows, and the first
half is thrown away.

Effects of a real sensor, each optional, with the truth recorded: the three readings of
a row, :math:`y'` by the sensor's own model, leave it as

.. math:: y = \mathrm{clip}\bigl(q\,\mathrm{round}
   ((y' + b(t) + c(t) + d(t) + n)/q),\ y_{min}, y_{max}\bigr)  \tag{E3}

with the bias random walk :math:`b`, flicker noise :math:`c`, Markov bias, ramp and sine
:math:`d`, white noise :math:`n`, the quantum :math:`q` and the converter's limits.
Before the model, what is measured is late by the delay, and the sensing element stops
at its range. Each random effect draws from a stream of its own: switching one on leaves
the others' numbers alone.
"""

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arguments import instance, whole_number
from simval.arrays import (
    Array,
    ReadOnly,
    frozen,
    nonnegative_number,
    physical_array,
    positive_number,
)
from simval.errors import InputError
from simval.shapes import Float
from simval.text import did_you_mean, shown

FORGOTTEN: Final = 40.0  # correlation times: 4e-18 of a number is left
MOST_ROWS: Final = 10**8  # 2.4 GB for each effect; more is a slip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseModel:
    """Noise of a three-axis sensor; the defaults have none.

    Each is (3,), or one number for all axes, in the raw units of the readings: counts,
    m/s^2 or rad/s.

    Attributes
    ----------
    white_raw_per_sqrt_hz : Array
        White noise N, raw units per square root of a hertz: its standard deviation in
        a row is N times the square root of the rate.
    flicker_raw : Array
        Flicker B, raw units: the Allan deviation stays at 0.664 B. Some data sheets
        call this floor the bias instability.
    walk_raw_per_sqrt_s : Array
        Rate random walk K, raw units per square root of a second: the standard
        deviation that the walk has reached after one second.
    markov_raw_per_sqrt_s : Array
        Driving noise q of a Markov bias, raw units per square root of a second: it has
        the standard deviation q times the square root of half its correlation time,
        and is a walk of K = q over times far below it.
    markov_s : Array
        Its correlation time, s; above 0 where it has a driving noise.
    ramp_raw_per_s : Array
        Rate ramp R, raw units per second, of either sign.
    sine_raw : Array
        Amplitude A of a sine in the output, raw units.
    sine_hz : float
        Its frequency, Hz.

    Raises
    ------
    InputError
        If a value is not finite, or negative and no ramp, a Markov bias has no
        correlation time, or a sine no frequency.
    """

    white_raw_per_sqrt_hz: Array | float = 0.0
    flicker_raw: Array | float = 0.0
    walk_raw_per_sqrt_s: Array | float = 0.0
    markov_raw_per_sqrt_s: Array | float = 0.0
    markov_s: Array | float = 0.0
    ramp_raw_per_s: Array | float = 0.0
    sine_raw: Array | float = 0.0
    sine_hz: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if name != "sine_hz":
                levels = levels_of_axes(name, getattr(self, name))
                object.__setattr__(self, name, levels)
        frequency = nonnegative_number("sine_hz", self.sine_hz, "Hz")
        object.__setattr__(self, "sine_hz", frequency)
        _require_time(self, "markov_raw_per_sqrt_s", "markov_s")
        _require_time(self, "sine_raw", "sine_hz")

    def parts(
        self, n: int, rate_hz: float, rng: "np.random.Generator"
    ) -> tuple[Float[Array, "n 3"], ...]:
        """Draw each kind of noise of consecutive rows by itself.

        Parameters
        ----------
        n : int
            Number of rows, from 1 to 1e8.
        rate_hz : float
            Rows per second, Hz.
        rng : numpy.random.Generator
            Spawns one stream for each part: switching one on, or making it larger,
            leaves the others' numbers alone.

        Returns
        -------
        tuple of Array
            White noise, flicker, walk, Markov bias, and ramp and sine together, raw
            units, each (n, 3); walk and ramp start from 0.

        Raises
        ------
        InputError
            If the number of rows or the rate cannot be used.
        """
        n = whole_number("n", n, 1, MOST_ROWS)
        rate_hz = positive_number("rate_hz", rate_hz, "Hz")
        instance("rng", rng, np.random.Generator)
        for_white, for_flicker, for_walk = rng.spawn(3)
        for_markov, for_sine = for_walk.spawn(2)  # where the next draw's stay
        white = np.asarray(self.white_raw_per_sqrt_hz) * np.sqrt(rate_hz)
        walk = np.asarray(self.walk_raw_per_sqrt_s) / np.sqrt(rate_hz)
        steps = for_walk.standard_normal((n, 3))
        steps[0] = 0.0
        flicker = (
            _flicker(n, for_flicker) if np.any(self.flicker_raw) else np.zeros((n, 3))
        )
        return (
            white * for_white.standard_normal((n, 3)),
            np.asarray(self.flicker_raw) * flicker,
            walk * np.cumsum(steps, axis=0),
            self._markov(n, rate_hz, for_markov),
            self._certain(n, rate_hz, for_sine),
        )

    def _markov(
        self, n: int, rate_hz: float, rng: "np.random.Generator"
    ) -> Float[Array, "n 3"]:
        # (C4)
        rows = np.zeros((n, 3))
        for axis in np.flatnonzero(self.markov_raw_per_sqrt_s):
            time = np.asarray(self.markov_s)[axis]
            size = np.asarray(self.markov_raw_per_sqrt_s)[axis] * np.sqrt(0.5 * time)
            driving = size * rng.standard_normal(n)
            driving[1:] *= np.sqrt(-np.expm1(-2.0 / (time * rate_hz)))
            rows[:, axis] = _remembered(driving, time * rate_hz)
        return rows

    def _certain(
        self, n: int, rate_hz: float, rng: "np.random.Generator"
    ) -> Float[Array, "n 3"]:
        # (C5)
        if not (np.any(self.ramp_raw_per_s) or np.any(self.sine_raw)):
            return np.zeros((n, 3))
        seconds = np.arange(n)[:, None] / rate_hz
        phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        swing = np.sin(2.0 * np.pi * self.sine_hz * seconds + phase)
        ramp = np.asarray(self.ramp_raw_per_s) * seconds
        return np.asarray(ramp + np.asarray(self.sine_raw) * swing)

    def draw(
        self, n: int, rate_hz: float, rng: "np.random.Generator"
    ) -> Float[Array, "n 3"]:
        """Draw the noise of consecutive rows.

        Parameters
        ----------
        n : int
            Number of rows, from 1 to 1e8.
        rate_hz : float
            Rows per second, Hz.
        rng : numpy.random.Generator
            Source of the noise, see `parts`.

        Returns
        -------
        Array
            Their sum, raw units, (n, 3).

        Raises
        ------
        InputError
            If the number of rows or the rate cannot be used.
        """
        first, *others = self.parts(n, rate_hz, rng)
        return sum(others, first)


def _remembered(driving: Float[Array, " n"], time: float) -> Float[Array, " n"]:
    # each number and what is left of those before: sums, over parts of a signal, of
    # numbers as great as they were at its first row; a part leaves less of the last
    # but one than rounding does
    size = min(int(np.ceil(FORGOTTEN * time)), len(driving))
    left = np.exp(-np.arange(size + 1) / time)
    parts = np.zeros((-(-len(driving) // size), size))
    parts.ravel()[: len(driving)] = driving
    parts /= left[:-1]
    np.cumsum(parts, axis=1, out=parts)
    parts *= left[:-1]
    parts[1:] += parts[:-1, -1:] * left[1:]
    return parts.ravel()[: len(driving)]


def _flicker(n: int, rng: "np.random.Generator") -> Float[Array, "n 3"]:
    # (C3) with B = 1: the second half of 2n rows
    size, spectrum = _flicker_filter(n)
    rows = np.empty((n, 3))
    for axis, stream in enumerate(rng.spawn(3)):
        driven = scipy.fft.rfft(stream.standard_normal(2 * n), size) * spectrum
        rows[:, axis] = scipy.fft.irfft(driven, size)[n : 2 * n]
    return rows


@lru_cache(maxsize=1)  # a sensor's noise is drawn for the same rows many times
def _flicker_filter(n: int) -> tuple[int, NDArray[np.complex128]]:
    # what wraps around a cyclic convolution of 3n - 1 or more falls into the first half
    lags = np.arange(1.0, 2.0 * n)
    response = np.cumprod(np.concatenate(([1.0], (lags - 0.5) / lags)))
    size = scipy.fft.next_fast_len(3 * n - 1, real=True)
    return size, scipy.fft.rfft(response, size)


def _require_time(noise: Any, size: str, name: str) -> None:
    # a time or a frequency of each axis that has a Markov bias or a sine
    of, times = getattr(noise, size), getattr(noise, name)
    if np.any((np.asarray(of) > 0.0) & ~(np.asarray(times) > 0.0)):
        msg = (
            f"`{name}` is {shown(times)}, and `{size}` is {shown(of)}; give "
            f"`{name}` above 0, or no `{size}`"
        )
        raise InputError(msg)


_SIGNED: Final = ("ramp_raw_per_s", "bias_ramp_raw_per_s")


def levels_of_axes(name: str, value: Any) -> Float[Array, "3"]:
    """One number for each axis, from three or one; only a ramp may be negative.

    Raises
    ------
    InputError
        If it is neither.
    """
    array = physical_array(name, value, ())
    signed = name in _SIGNED
    if array.shape not in ((), (3,)) or not np.all(signed | (array >= 0.0)):
        least = "" if signed else ", each 0 or more"
        msg = f"`{name}` is {shown(value)}; give one number or three{least}"
        raise InputError(msg)
    return frozen(np.broadcast_to(array, (3,)))


_LEVELS: Final = (
    "flicker_raw",
    "bias_walk_raw_per_sqrt_s",
    "bias_markov_raw_per_sqrt_s",
    "bias_markov_s",
    "bias_ramp_raw_per_s",
    "sine_raw",
)
STANDARD_GRAVITY: Final = 9.80665  # m/s^2, the unit of `range_g`
UNEVEN: Final = 1e-3  # share of a step that a clock of even steps may be off by
E = TypeVar("E", bound="Electronics")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Electronics:
    """Imperfections that any three-axis sensor may have; the defaults have none.

    Attributes
    ----------
    noise_std_raw : Array or None
        White noise of each axis and sample, raw units, (3,) or one number for all;
        None takes the model's own.
    white_raw_per_sqrt_hz : Array or None
        The same as a density N, raw units per square root of a hertz: a sample has N
        times the square root of the rate. One of the two is given at most.
    flicker_raw : Array
        Flicker noise B of each axis, raw units, (3,): its Allan deviation is 0.664 B.
    bias_walk_raw_per_sqrt_s : Array
        Bias random walk K of each axis, raw units per square root of a second, (3,):
        the standard deviation that it has reached after one second.
    bias_markov_raw_per_sqrt_s : Array
        Driving noise of a Markov bias of each axis, raw units per square root of a
        second, (3,), see `NoiseModel`.
    bias_markov_s : Array
        Its correlation time, s, (3,); above 0 where it has a driving noise.
    bias_ramp_raw_per_s : Array
        Rate ramp R of each axis, raw units per second, (3,), from the first row.
    sine_raw : Array
        Amplitude of a sine in the output of each axis, raw units, (3,).
    sine_hz : float
        Its frequency, Hz.
    quantum_raw : float
        Step of the converter, raw units; 0 does not quantise.
    limits_raw : tuple of float or None
        Least and greatest reading of the converter, raw units.
    delay_s : float
        Time by which a reading is late, s; what is between two rows is on the straight
        line through them.

    Raises
    ------
    InputError
        If a value is negative and no ramp, not finite, or the limits are not in order.
    """

    RANGE: ClassVar[tuple[str, str, float]] = ("", "", 1.0)  # name, unit, in SI

    noise_std_raw: Array | float | None = None
    white_raw_per_sqrt_hz: Array | float | None = None
    flicker_raw: Array | float = 0.0
    bias_walk_raw_per_sqrt_s: Array | float = 0.0
    bias_markov_raw_per_sqrt_s: Array | float = 0.0
    bias_markov_s: Array | float = 0.0
    bias_ramp_raw_per_s: Array | float = 0.0
    sine_raw: Array | float = 0.0
    sine_hz: float = 0.0
    quantum_raw: float = 0.0
    limits_raw: tuple[float, float] | None = None
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        optional = ("noise_std_raw", "white_raw_per_sqrt_hz")  # None: the model's
        for name in (*optional, *_LEVELS):
            value = getattr(self, name)
            if value is not None or name not in optional:
                object.__setattr__(self, name, levels_of_axes(name, value))
        _require_time(self, "bias_markov_raw_per_sqrt_s", "bias_markov_s")
        if self.noise_std_raw is not None and self.white_raw_per_sqrt_hz is not None:
            msg = (
                f"`noise_std_raw` is {shown(self.noise_std_raw)} and "
                f"`white_raw_per_sqrt_hz` {shown(self.white_raw_per_sqrt_hz)}; both "
                "state the white noise, so give one of them"
            )
            raise InputError(msg)
        units = (("quantum_raw", "raw units"), ("delay_s", "s"), ("sine_hz", "Hz"))
        for name, unit in units:
            number = nonnegative_number(name, getattr(self, name), unit)
            object.__setattr__(self, name, number)
        _require_time(self, "sine_raw", "sine_hz")
        if self.limits_raw is not None:
            limits = physical_array("limits_raw", self.limits_raw, (2,))
            if limits.shape != (2,) or not limits[0] < limits[1]:
                words = shown(self.limits_raw)
                msg = f"`limits_raw` is {words}; give the least and the greatest"
                raise InputError(msg)
            object.__setattr__(self, "limits_raw", tuple(limits.tolist()))
        name, unit, _ = self.RANGE
        if name and getattr(self, name) is not None:
            number = positive_number(name, getattr(self, name), unit)
            object.__setattr__(self, name, number)

    @property
    def reach(self) -> float:
        """Range of the sensing element, SI units; infinite if it has none."""
        name, _, size = self.RANGE
        value = getattr(self, name) if name else None
        return np.inf if value is None else float(value * size)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effects(Electronics):
    """Imperfections of an accelerometer: those of `Electronics`, and of its element.

    Attributes
    ----------
    vibration_m_s2 : Array
        Amplitude of a sine vibration along each sensor axis, m/s^2, (3,).
    vibration_hz : float
        Its frequency, Hz.
    range_g : float or None
        The sensing element stops at plus and minus this, standard gravities.
    """

    RANGE: ClassVar[tuple[str, str, float]] = ("range_g", "g", STANDARD_GRAVITY)

    vibration_m_s2: Array | float = 0.0
    vibration_hz: float = 0.0
    range_g: float | None = None

    def __post_init__(self) -> None:
        Electronics.__post_init__(self)
        vibration = levels_of_axes("vibration_m_s2", self.vibration_m_s2)
        object.__setattr__(self, "vibration_m_s2", vibration)
        number = nonnegative_number("vibration_hz", self.vibration_hz, "Hz")
        object.__setattr__(self, "vibration_hz", number)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopeEffects(Electronics):
    """Imperfections of a gyroscope: those of `Electronics`, and its range.

    Attributes
    ----------
    range_rad_s : float or None
        The sensing element stops at plus and minus this, rad/s.
    """

    RANGE: ClassVar[tuple[str, str, float]] = ("range_rad_s", "rad/s", 1.0)

    range_rad_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MagnetometerEffects(Electronics):
    """Imperfections of a magnetometer: those of `Electronics`, and its range.

    Attributes
    ----------
    range_t : float or None
        The sensing element stops at plus and minus this, T.
    """

    RANGE: ClassVar[tuple[str, str, float]] = ("range_t", "T", 1.0)

    range_t: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Readings(ReadOnly):
    """Raw readings, with the true size of every effect in them.

    Attributes
    ----------
    raw : Array
        What the sensor puts out, raw units, (n, 3).
    vibration_m_s2 : Array
        Vibration that was added to an accelerometer's specific force, m/s^2, (n, 3).
    bias_walk_raw : Array
        Bias random walk, raw units, (n, 3).
    flicker_raw : Array
        Flicker noise, raw units, (n, 3).
    drift_raw : Array
        Markov bias, ramp and sine together, raw units, (n, 3).
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
    flicker_raw: Float[Array, "n 3"]
    drift_raw: Float[Array, "n 3"]
    noise_raw: Float[Array, "n 3"]
    out_of_range: NDArray[np.bool_]
    saturated: NDArray[np.bool_]


def delayed(
    truth: Float[Array, "n 3"], delay: float, time: Float[Array, " n"]
) -> Float[Array, "n 3"]:
    """Delay the truth by some seconds; its first row holds before the start."""
    if delay == 0.0:
        return truth
    axes = [np.interp(time - delay, time, axis) for axis in truth.T]
    return np.stack(axes, axis=1)


def white_std(
    effects: Electronics, own: float | Array, time: Float[Array, " n"]
) -> Float[Array, "3"]:
    """White noise of a sample: as the effects state it, else the model's own."""
    if effects.white_raw_per_sqrt_hz is not None:
        return np.full(3, effects.white_raw_per_sqrt_hz) * np.sqrt(even_rate(time))
    stated = own if effects.noise_std_raw is None else effects.noise_std_raw
    return np.full(3, stated)


def even_rate(time: Float[Array, " n"]) -> float:
    """Rate of an evenly spaced clock, Hz.

    Raises
    ------
    InputError
        If the steps differ, since a density is noise of a rate.
    """
    steps = np.diff(time)
    if not (len(steps) and np.ptp(steps) <= UNEVEN * steps.mean()):
        longest = f"{steps.min():.3g} to {steps.max():.3g} s" if len(steps) else "none"
        msg = (
            f"the steps of `time` are {longest}; a noise density, flicker and a drift "
            "are of one rate, so give rows at even steps, or, for white noise, "
            "`noise_std_raw`"
        )
        raise InputError(msg)
    return len(steps) / float(time[-1] - time[0])


def effects_from(values: dict[str, Any], kind: type[E]) -> E:
    """Build the effects of a sensor from plain values, as a file holds them.

    Raises
    ------
    InputError
        If a name is unknown or a value cannot be used.
    """
    known = [field.name for field in fields(kind)]
    for name in values:
        if name not in known:
            near = did_you_mean(name, known)
            listed = ", ".join(known)
            msg = f"there is no effect `{name:.60}`{near}; there are {listed}"
            raise InputError(msg)
    try:
        return kind(**values)
    except TypeError as error:
        msg = f"an effect cannot be used: {error}"
        raise InputError(msg) from None
