r"""What may be wrong with the rests of a sensor, as data.

A sensor that reads a vector of known length has, in the frame of its rest i,

.. math:: A\,(\mathrm{undo}(y)_i - b) \text{ of length } 1.

An explanation says what happened to the readings beside that: a map of them since some
rest, which is undone (a sign, an exchange of axes, a factor, the laps of a counter),
columns of small effects with a prior size (a step, a drift, a bend, a rest that is
off), or more noise than was measured. Its sentence and its remedy are made from its
fields.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from simval.arrays import Array, ReadOnly, physical_array, shaped_array
from simval.errors import InputError
from simval.shapes import Float
from simval.spelling import series

# first row of each in the columns of an explanation; a gain multiplies readings about
# the counter's zero, a scale about the bias
BIAS, SCALE, GAIN, LENGTH = 0, 3, 6, 9
ROWS: Final = 10

LEAST_FREEDOM: Final = 5.0  # below, Wallace's transformation is off by 1 %
_ROUNDING: Final = 1e-9  # of a covariance

Kind = Literal[
    "sign", "exchange", "unit or range", "wrap", "bias step", "scale step",
    "bias drift", "scale drift", "bias in temperature", "scale in temperature",
    "curvature", "rest off", "noise",
]  # fmt: skip
"""Kinds of explanations."""

Action = Literal["restore", "cut", "leave out", "estimate", "weigh"]
"""Steps by which a log is mended."""


class _Account(NamedTuple):
    # of a kind: its step, its sentence, and what a person does
    action: Action
    so: str
    do: str


_CUT = "cut the log there and calibrate one part"
_BY_TEMPERATURE = (
    "calibrate with the temperature and a linear loss, by rests at more temperatures"
)
ACCOUNTS: Final[Mapping[Kind, _Account]] = MappingProxyType({
    "sign": _Account(
        "restore", "the sign of {axes} changed {when}",
        "turn it back from there on, or " + _CUT,
    ),
    "exchange": _Account(
        "restore", "axes {axes} changed places {when}",
        "put them back from there on, or " + _CUT,
    ),
    "unit or range": _Account(
        "restore", "the readings became {size:.4g} times as large {when}",
        "bring all rows to one unit and range, or " + _CUT,
    ),
    "wrap": _Account(
        "restore", "the counter of {axes} wraps around a range of {size:.6g} {when}",
        "read the counts as signed or unsigned, as the sensor writes them",
    ),
    "bias step": _Account("cut", "the bias of {axes} changed {when}", _CUT),
    "scale step": _Account("cut", "the scale of {axes} changed {when}", _CUT),
    "bias drift": _Account(
        "estimate", "the bias of {axes} drifts over the log",
        "let the sensor warm up and record again, or calibrate a shorter part",
    ),
    "scale drift": _Account(
        "estimate", "the scale of {axes} drifts over the log",
        "let the sensor warm up and record again, or calibrate a shorter part",
    ),
    "bias in temperature": _Account(
        "estimate", "the bias of {axes} follows the temperature",
        _BY_TEMPERATURE,
    ),
    "scale in temperature": _Account(
        "estimate", "the scale of {axes} follows the temperature",
        _BY_TEMPERATURE,
    ),
    "curvature": _Account(
        "estimate", "{axes} is not linear (power {size:g})",
        "check the range of the sensor: three scales do not describe it",
    ),
    "rest off": _Account(
        "leave out", "gravity {when} is not that of the others",
        "look at the hold, leave {it} out and calibrate again",
    ),
    "noise": _Account(
        "weigh", "{axes} is about {size:g} times as noisy as in the rows",
        "state the noise of each axis",
    ),
})  # fmt: skip


class Remedy(NamedTuple):
    """A step that mends a log, which a program can carry out.

    Attributes
    ----------
    action : {"restore", "cut", "leave out", "estimate", "weigh"}
        Undo the change in the readings; keep the longer part; leave rests out; take
        the effect into the fit; weigh an axis by more noise.
    axes : str
        Axes that it is about, of "xyz"; none where all change alike.
    rests : tuple of int
        Rests since the change, or those to leave out; none where it is the whole log.
    size : float
        Factor, lap, power or times the noise; NaN where there is none.
    """

    action: Action
    axes: str
    rests: tuple[int, ...]
    size: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestMeans(ReadOnly):
    """Mean readings of a sensor in its rests, with their covariance.

    Attributes
    ----------
    readings : (n, 3) array
        Mean reading of each rest, any unit.
    covariance : (n, 3, 3) array
        Covariance of each mean, measured in its rest, that unit squared.
    time : (n,) array
        Time of each rest, s.
    temperature : (n,) array or None
        Temperature of each rest, any unit.
    freedom : (n,) array
        Degrees of freedom of each covariance; infinite where it is known.
    zero : (3,) array
        Reading about which a sign turns: the middle of unsigned counts.
    """

    readings: Float[Array, "n 3"]
    covariance: Float[Array, "n 3 3"]
    time: Float[Array, " n"]
    temperature: Float[Array, " n"] | None = None
    freedom: Float[Array, " n"]
    zero: Float[Array, " 3"]

    @classmethod
    def of(
        cls,
        readings: Float[Array, "n 3"],
        covariance: Float[Array, "n 3 3"],
        time: Float[Array, " n"],
        temperature: Float[Array, " n"] | None = None,
        *,
        freedom: float | Float[Array, " n"] = np.inf,
        zero: float | Float[Array, " 3"] = 0.0,
    ) -> "RestMeans":
        """Check the arrays of a log's rests and make them a value.

        Parameters
        ----------
        readings : (n, 3) array
            Mean reading of each rest, any unit.
        covariance : (n, 3, 3) array
            Covariance of each mean, that unit squared.
        time : (n,) array
            Time of each rest, s, not falling.
        temperature : (n,) array, optional
            Temperature of each rest.
        freedom : float or (n,) array, optional
            Degrees of freedom of each covariance, 5 or more.
        zero : float or (3,) array, optional
            Reading about which a sign turns.

        Returns
        -------
        RestMeans
            The rests.

        Raises
        ------
        InputError
            If a shape does not fit, a value is not finite, a variance is negative, or
            the times fall.
        """
        y = _whole("readings", readings, (None, 3))
        n = len(y)
        spread = _whole("covariance", covariance, (n, 3, 3))
        at = _whole("time", time, (n,))
        warm = None if temperature is None else _whole("temperature", temperature, (n,))
        degrees = np.broadcast_to(shaped_array("freedom", freedom, ()), (n,))
        if n == 0:
            msg = "`readings` has no rows; give the mean reading of each rest"
            raise InputError(msg)
        if np.any(np.diff(at) < 0.0):
            msg = (
                "`time` falls; give the rests in the order in which they were recorded"
            )
            raise InputError(msg)
        least = np.linalg.eigvalsh(spread).min()
        if not least >= -_ROUNDING * np.abs(spread).max():
            msg = (
                f"`covariance` has a negative variance ({least:g}); give the "
                "covariance of each mean"
            )
            raise InputError(msg)
        if not np.all(degrees >= LEAST_FREEDOM):
            msg = (
                f"`freedom` is {np.min(degrees):g}; noise measured with fewer than "
                f"{LEAST_FREEDOM:g} degrees of freedom cannot judge anything, so "
                "pool that of several rests"
            )
            raise InputError(msg)
        return cls(
            readings=y, covariance=spread, time=at, temperature=warm, freedom=degrees,
            zero=np.broadcast_to(physical_array("zero", zero, ()), (3,)),
        )  # fmt: skip


def _whole(name: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    array = physical_array(name, value, shape)
    if array.ndim != len(shape):
        msg = (
            f"`{name}` has {array.ndim} axes, and {len(shape)} are required; judge one "
            "log at a time"
        )
        raise InputError(msg)
    return array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Explanation(ReadOnly):
    """Something that may be wrong with the rests of a sensor.

    Attributes
    ----------
    kind : str
        The kind, of `Kind`.
    axes : str
        Axes that it is about, of "xyz"; none where all change alike.
    rests : tuple of int
        Rests since the change, or those that it is about; none where it is the whole
        log.
    size : float
        Factor, lap, power, time constant or times the noise; NaN where there is none.
    readings : (n, 3) array
        Readings with the change undone.
    unit : (n,) array
        Times by which that multiplied their noise.
    noise : (n,) array
        Times by which the noise is larger than measured.
    columns : (n, 10, m) array
        Effect of each of m parameters on the rests: bias of x, y, z in the unit of the
        readings; scale of x, y, z about the bias; about zero; length, of gravity.
    sd : (m,) array
        Prior standard deviations of the parameters.
    beside : Explanation or None
        Another thing that is wrong at the same time.
    """

    kind: Kind
    axes: str = ""
    rests: tuple[int, ...] = ()
    size: float = np.nan
    readings: Float[Array, "n 3"]
    unit: Float[Array, " n"]
    noise: Float[Array, " n"]
    columns: Float[Array, "n 10 m"]
    sd: Float[Array, " m"]
    beside: "Explanation | None" = None

    @property
    def parts(self) -> "tuple[Explanation, ...]":
        """The things that are wrong together, in the order in which they were found."""
        return (*(self.beside.parts if self.beside else ()), self)

    @property
    def kinds(self) -> frozenset[Kind]:
        """Kinds of its parts."""
        return frozenset(part.kind for part in self.parts)

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """A step that mends each part, in order."""
        return tuple(
            Remedy(ACCOUNTS[p.kind].action, p.axes, p.rests, p.size) for p in self.parts
        )

    def also(self, other: "Explanation") -> "Explanation":
        """Combine this explanation with another one that was found in its readings.

        Parameters
        ----------
        other : Explanation
            What was found in the readings of this one.

        Returns
        -------
        Explanation
            Both at the same time.
        """
        return replace(
            other, beside=self, unit=self.unit * other.unit,
            noise=self.noise * other.noise, sd=np.concatenate([self.sd, other.sd]),
            columns=np.concatenate([self.columns, other.columns], axis=-1),
        )  # fmt: skip

    def sentence(self, time: Float[Array, " n"] | None) -> str:
        """Say what is wrong.

        Parameters
        ----------
        time : (n,) array or None
            Time of each rest, s; None names them by their place, as poses.

        Returns
        -------
        str
            A clause for each part.
        """
        return ", and ".join(
            ACCOUNTS[part.kind].so.format(
                axes=series(part.axes) or "all axes alike", when=part._when(time),
                size=part.size,
            )
            for part in self.parts
        )  # fmt: skip

    @property
    def advice(self) -> str:
        """Say what to do."""
        several = "it" if len(self.rests) == 1 else "them"
        each = (ACCOUNTS[part.kind].do.format(it=several) for part in self.parts)
        return "; ".join(dict.fromkeys(each))

    def _when(self, time: Array | None) -> str:
        if not self.rests:
            return "over the log"
        noun, places = "pose", [str(k) for k in range(len(self.readings))]
        if time is not None:
            noun, places = "the rest", [f"at {t:.1f} s" for t in time]
        k, own = self.rests[0], [places[k] for k in self.rests]
        if ACCOUNTS[self.kind].action == "leave out":
            return f"in {noun}{'s' * (len(own) > 1)} {series(own)}"
        if self.kind == "wrap":
            return f"in {len(own)} of the rests, first in {noun} {own[0]}"
        return f"between {noun}s {places[k - 1]} and {places[k]}"
