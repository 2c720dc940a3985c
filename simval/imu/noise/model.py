"""Noise model of a signal, the data behind it, and its JSON file."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, Final, NamedTuple

import numpy as np

from simval.arguments import file_path, switch, whole_number
from simval.arrays import (
    Array,
    ReadOnly,
    finite_array,
    nonnegative_number,
    positive_number,
)
from simval.errors import InputError, RefusedError
from simval.files import MOST_DOCUMENT, parsed, read_text
from simval.imu.noise.allan import allan_law
from simval.imu.noise.components import Component
from simval.shapes import Float, Int
from simval.text import shown

LEAST_ROWS: Final = 500  # averages over 1 to 50 rows: 17 lengths for four coefficients


@dataclass(frozen=True, slots=True, kw_only=True)
class Coefficient:
    """One coefficient of a noise model, or its upper bound.

    Attributes
    ----------
    kind : str
        ``N`` white noise, raw units per root hertz; ``B`` flicker, raw units; ``K``
        rate random walk, or the driving noise of Markov noise, raw units per root
        second; ``T`` its correlation time, s; ``Q`` rounding of increments, raw units
        times second; ``R`` ramp, raw units per second, with its sign where it is
        seen; ``A`` amplitude of a sine, raw units; ``f`` its frequency, Hz.
    value : float or None
        The estimate; None where the signal does not show the coefficient.
    sd : float or None
        Its standard deviation; None where there is no estimate.
    low, high : float
        Ends of its 95 % interval; 0 and the upper bound if the signal does not show the
        coefficient. `high` is infinite if nothing bounds it, and so is `low` of a ramp
        that falls. A correlation time that the signal does not show has a lower bound;
        that of a random walk is infinite.
    """

    kind: str
    value: float | None
    sd: float | None
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowNoise:
    """Slow noise of a signal, and the random walk that a filter is given for it.

    Attributes
    ----------
    seen : tuple of str
        Letters of the coefficients that every likely explanation has; empty if the kind
        of the slow noise is unknown.
    likely : tuple of str
        Explanations that the signal cannot distinguish, the most likely first: the
        kinds of the components of each, as ``NBK`` (`simval.imu.noise.components`).
    by_axes : bool
        Whether the axes of the sensor together rule out some explanations.
    walk : Coefficient
        The equivalent random walk, eq. (V14) of `simval.imu.noise.walk`, raw units per
        root second.
    horizon : float
        Longest time over which `walk` is equivalent, s.
    """

    seen: tuple[str, ...]
    likely: tuple[str, ...]
    by_axes: bool
    walk: Coefficient
    horizon: float

    @property
    def is_walk(self) -> bool:
        """True if the slow noise seen is a random walk, with a ramp at most."""
        return "K" in self.seen and set(self.seen) <= {"K", "T"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisNoise(ReadOnly):
    """Noise of one signal.

    Attributes
    ----------
    rate_hz : float
        Rows per second, Hz.
    rows : int
        Rows of the signal.
    counts : Array
        Rows to an average, (m,).
    variances : Array
        Overlapping Allan variances, raw units squared, (m,).
    variance_sd : Array
        Their standard deviations by (V4), (m,).
    used : tuple of int
        The fit used the lengths ``counts[used[0]:used[1]]``.
    coefficients : tuple of Coefficient
        N, B, K (and Q), and any further component; empty if the model fits no range of
        lengths.
    squares : Array
        N^2, B^2, K^2 and Q^2 of the fit, with time in rows, raw units squared, (4,).
    further : tuple of (Component, float)
        Markov noise, ramp and sine of the fit, each with its square in the same units.
    chi2 : float
        Chi-square of the fit.
    dof : int
        Its degrees of freedom.
    p_value : float
        Chance of a chi-square at least as high if the model is right.
    step : float
        Step of the converter, raw units; 0 if the readings show none.
    slow : SlowNoise or None
        Slow noise of the signal; None if the signal shows none.
    statements : tuple of str
        Notes on the coefficients.
    """

    rate_hz: float
    rows: int
    counts: Int[Array, " m"]
    variances: Float[Array, " m"]
    variance_sd: Float[Array, " m"]
    used: tuple[int, int]
    coefficients: tuple[Coefficient, ...]
    squares: Float[Array, "4"]
    further: tuple[tuple[Component, float], ...]
    chi2: float
    dof: int
    p_value: float
    step: float
    slow: SlowNoise | None
    statements: tuple[str, ...]

    @property
    def seconds(self) -> Float[Array, " m"]:
        """Averaging times, s, (m,)."""
        return self.counts / self.rate_hz

    @property
    def given(self) -> tuple[Coefficient, ...]:
        """The coefficients, K an equivalent walk if the slow noise is no walk."""
        if self.slow is None or self.slow.is_walk:
            return self.coefficients
        others = (c for c in self.coefficients if c.kind != "K")
        return (*others, self.slow.walk)

    def law(self, seconds: Float[Array, " t"]) -> Float[Array, " t"]:
        """Allan variance of the fitted model at averaging times.

        Parameters
        ----------
        seconds : Array
            Averaging times, s, (t,).

        Returns
        -------
        Array
            Raw units squared, (t,).
        """
        m = np.asarray(seconds) * self.rate_hz
        more = sum(square * each.law(m) for each, square in self.further)
        return np.asarray(allan_law(m) @ self.squares + more)

    def variance_at(self, seconds: float) -> float:
        """Measured Allan variance at an averaging time.

        Parameters
        ----------
        seconds : float
            Averaging time, s, within those that were measured.

        Returns
        -------
        float
            Raw units squared, by straight lines between logarithms.

        Raises
        ------
        RefusedError
            If the time is shorter or longer than those that were measured.
        """
        seconds = positive_number("seconds", seconds, "s")
        times = self.seconds
        near = 1e-9  # relative: a time that is one of them, but for rounding
        if not times[0] * (1.0 - near) <= seconds <= times[-1] * (1.0 + near):
            msg = (
                f"the noise was measured for averages over {times[0]:.3g} s to "
                f"{times[-1]:.3g} s, but {seconds:.3g} s is asked for; measure a "
                f"rest of {10.0 * seconds:.3g} s"
            )
            raise RefusedError(msg)
        if not np.all(self.variances > 0.0):
            msg = "the readings do not vary, so they show no noise"
            raise RefusedError(msg)
        logs = np.interp(np.log(seconds), np.log(times), np.log(self.variances))
        return float(np.exp(logs))


class Largest(NamedTuple):
    """A coefficient for programs that know only white noise and a random walk."""

    value: float | None  # the largest of the axes
    bound: float | None  # the largest of the axes that show nothing
    horizon: float | None  # s, of a walk that is equivalent and not the noise's own
    low: float = 0.0  # of the value's 95 % interval
    high: float = np.inf


def largest(
    axes: Sequence[AxisNoise], kind: str, scales: Float[Array, " axes"]
) -> Largest:
    """Largest N or K of the three axes, and the largest bound where none is seen."""
    seen: list[tuple[float, float | None, float, float]] = []
    bounds = []
    for axis, scale in zip(axes, scales.tolist(), strict=True):
        own = next((c for c in axis.given if c.kind == kind), None)
        if own is None:
            continue
        equivalent = axis.slow is not None and own is axis.slow.walk
        horizon = axis.slow.horizon if axis.slow and equivalent else None
        if own.value is None:
            bounds.append(scale * own.high)
        else:
            seen.append((scale * own.value, horizon, scale * own.low, scale * own.high))
    bound = max(filter(np.isfinite, bounds), default=None)
    if not seen:
        return Largest(None, bound, None)
    value, horizon, *interval = max(seen, key=lambda each: each[0])
    return Largest(value, bound, horizon, *interval)


def equivalent_words(horizon: float | None) -> str:
    """Say that a random walk is only equivalent; empty if it was measured."""
    if horizon is None:
        return ""
    return f"equivalent over up to {horizon:.3g} s, not a random walk that was measured"


FORMAT: Final = "simval noise 1"
AXES: Final = ("x", "y", "z")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseFile:
    """Noise of an accelerometer, and of the other sensors in its file.

    Attributes
    ----------
    accelerometer : tuple of AxisNoise
        Of the three axes, raw units.
    si_per_raw : float or None
        m/s^2 per raw unit; None where it was not known.
    gravity_raw : float
        Length of the mean reading at rest, raw units.
    gyro : tuple of AxisNoise
        Of the three axes, raw units; empty where the file has none.
    gyro_si_per_raw : float or None
        rad/s per raw unit; None where it was not known.
    magnetometer : tuple of AxisNoise
        Of the three axes, raw units; empty where the file has none.
    magnetometer_si_per_raw : float or None
        T per raw unit; None where it was not known.
    """

    accelerometer: tuple[AxisNoise, ...]
    si_per_raw: float | None
    gravity_raw: float
    gyro: tuple[AxisNoise, ...] = ()
    gyro_si_per_raw: float | None = None
    magnetometer: tuple[AxisNoise, ...] = ()
    magnetometer_si_per_raw: float | None = None


def axis_to_json(axis: AxisNoise) -> dict[str, Any]:
    """Return the noise of one signal as plain JSON values; infinity becomes null."""
    return {
        "rate_hz": axis.rate_hz,
        "rows": axis.rows,
        "coefficients": {c.kind: _coefficient(c) for c in axis.coefficients},
        "squares_per_row": axis.squares.tolist(),
        "further": [
            {"kind": c.kind, "rows": c.rows, "square_per_row": square}
            for c, square in axis.further
        ],
        "rows_to_an_average": axis.counts.tolist(),
        "seconds": axis.seconds.tolist(),
        "allan_variance": axis.variances.tolist(),
        "allan_variance_sd": axis.variance_sd.tolist(),
        "fitted_lengths": list(axis.used),
        "chi2": axis.chi2,
        "dof": axis.dof,
        "p_value": axis.p_value,
        "rounding_step": axis.step,
        "slow_noise": axis.slow and _slow_to_json(axis.slow),
        "statements": list(axis.statements),
    }


def _slow_to_json(slow: SlowNoise) -> dict[str, Any]:
    return {
        "seen": list(slow.seen),
        "likely": list(slow.likely),
        "by_axes": slow.by_axes,
        "equivalent_walk": _coefficient(slow.walk),
        "horizon_s": slow.horizon,
    }


EMPTY: Final = {"value": None, "sd": None, "low": -np.inf, "high": np.inf}
"""Numbers of a coefficient, and what null stands for in a file."""


def _coefficient(found: Coefficient) -> dict[str, float | None]:
    numbers = {name: getattr(found, name) for name in EMPTY}
    return {
        name: None if value is None or not np.isfinite(value) else value
        for name, value in numbers.items()
    }


def axis_from_json(data: dict[str, Any]) -> AxisNoise:
    """Read the noise of one signal from JSON values.

    Raises
    ------
    InputError
        If a value is missing, or cannot be one.
    """
    counts = _array(data, "rows_to_an_average")
    variances = _array(data, "allan_variance", len(counts))
    squares = _array(data, "squares_per_row", 4)
    used = _array(data, "fitted_lengths", 2)
    if not (
        len(counts)
        and np.all(np.diff(counts) > 0.0)
        and counts[0] >= 1.0
        and np.all(variances >= 0.0)
        and np.all(squares >= 0.0)
        and 0.0 <= used[0] < used[1] <= len(counts)
    ):
        msg = "its lengths do not increase, or a variance is negative"
        raise InputError(msg)
    coefficients = _checked(
        data.get("coefficients"), "coefficients", dict, dict, "an object of objects"
    )
    further = _checked(data.get("further"), "further", list, dict, "a list of objects")
    statements = _checked(
        data.get("statements"), "statements", list, str, "a list of texts"
    )
    return AxisNoise(
        rate_hz=positive_number("rate_hz", data.get("rate_hz"), "Hz"),
        rows=whole_number("rows", data.get("rows"), 1),
        counts=counts.astype(np.int64),
        variances=variances,
        variance_sd=_array(data, "allan_variance_sd", len(counts)),
        used=(int(used[0]), int(used[1])),
        coefficients=tuple(_rebuilt(*each) for each in coefficients.items()),
        squares=squares,
        further=_further(further),
        chi2=float(finite_array("chi2", data.get("chi2"), ())),
        dof=whole_number("dof", data.get("dof"), 0),
        p_value=float(finite_array("p_value", data.get("p_value"), ())),
        step=float(finite_array("rounding_step", data.get("rounding_step"), ())),
        slow=_slow_from_json(data.get("slow_noise")),
        statements=tuple(statements),
    )


def _slow_from_json(given: Any) -> SlowNoise | None:
    if given is None:
        return None
    walk = _checked(
        given.get("equivalent_walk") if isinstance(given, dict) else given,
        "equivalent_walk",
        dict,
        object,
        "an object",
    )
    words = {
        name: tuple(_checked(given.get(name), name, list, str, "a list of texts"))
        for name in ("seen", "likely")
    }
    return SlowNoise(
        **words,
        by_axes=switch("by_axes", given.get("by_axes")),
        walk=_rebuilt("K", walk),
        horizon=positive_number("horizon_s", given.get("horizon_s"), "s"),
    )


def _further(given: list[dict[str, Any]]) -> tuple[tuple[Component, float], ...]:
    made = []
    for each in given:
        kind, rows = each.get("kind"), each.get("rows")
        square = nonnegative_number("square_per_row", each.get("square_per_row"), "")
        if kind not in ("M", "R", "A"):
            msg = f"`kind` is {shown(kind)}; further components are M, R and A"
            raise InputError(msg)
        timed = kind != "R"
        time = positive_number("rows", rows, "rows") if timed else 0.0
        made.append((Component(kind, time), square))
    return tuple(made)


def _checked(given: Any, name: str, many: type, one: type, words: str) -> Any:
    of = given.values() if isinstance(given, dict) else given
    if not isinstance(given, many) or not all(isinstance(each, one) for each in of):
        msg = f"`{name}` is {shown(given)}; it must be {words}"
        raise InputError(msg)
    return given


def _rebuilt(kind: str, data: dict[str, Any]) -> Coefficient:
    def number(name: str) -> Any:
        value = data.get(name)
        return EMPTY[name] if value is None else float(finite_array(name, value, ()))

    return Coefficient(kind=kind, **{name: number(name) for name in EMPTY})


def _array(
    data: dict[str, Any], name: str, size: int | None = None
) -> Float[Array, " m"]:
    array = finite_array(name, data.get(name), (size,))
    if array.ndim != 1:
        msg = f"`{name}` has shape {array.shape}; a list of numbers is needed"
        raise InputError(msg)
    return array


def load_noise(path: str | PathLike[str]) -> NoiseFile:
    """Read the output of ``simval noise LOG --json``.

    Parameters
    ----------
    path : path-like
        JSON file.

    Returns
    -------
    NoiseFile
        Noise of its accelerometer, and of its magnetometer if it has one.

    Raises
    ------
    InputError
        If the file cannot be read, or has no noise of an accelerometer.
    """
    file = file_path("path", path)
    how = "write one with `simval noise LOG --json > FILE`"
    try:
        data = parsed(json.loads, read_text(file, MOST_DOCUMENT))
    except OSError as error:
        msg = f"cannot read the noise file {file}: {error.strerror}; {how}"
        raise InputError(msg) from None
    except ValueError as error:
        msg = f"the noise file {file} is not JSON ({error}); {how}"
        raise InputError(msg) from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        msg = f"{file} is not a noise file (no format {FORMAT!r}); {how}"
        raise InputError(msg)
    try:
        return _sensors(data.get("sensors"))
    except (InputError, OverflowError) as error:
        msg = f"the noise file {file}: {error}; {how}"
        raise InputError(msg) from None


def _sensors(sensors: Any) -> NoiseFile:
    known = sensors if isinstance(sensors, dict) else {}
    axes = _axes("accelerometer", known.get("accelerometer"))
    compass, gyro = known.get("magnetometer"), known.get("gyro")
    sensor = known["accelerometer"]
    return NoiseFile(
        accelerometer=axes,
        si_per_raw=_unit(sensor),
        gravity_raw=positive_number("gravity_raw", sensor.get("gravity_raw"), "raw"),
        gyro=() if gyro is None else _axes("gyro", gyro),
        gyro_si_per_raw=None if gyro is None else _unit(gyro),
        magnetometer=() if compass is None else _axes("magnetometer", compass),
        magnetometer_si_per_raw=None if compass is None else _unit(compass),
    )


def _axes(name: str, sensor: Any) -> tuple[AxisNoise, ...]:
    axes = sensor.get("axes") if isinstance(sensor, dict) else None
    known = isinstance(axes, dict) and all(isinstance(axes.get(a), dict) for a in AXES)
    if not (isinstance(axes, dict) and known):
        msg = f"it has no {name} with the axes x, y and z"
        raise InputError(msg)
    return tuple(axis_from_json(axes[a]) for a in AXES)


def _unit(sensor: dict[str, Any]) -> float | None:
    size = sensor.get("si_per_raw")
    return None if size is None else positive_number("si_per_raw", size, "")
