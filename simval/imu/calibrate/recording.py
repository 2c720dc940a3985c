"""What each sensor showed in each rest of a recording, from which it is calibrated.

Means over the rests and their noise, the rotations between them, and what was taken out
of the readings before: terms, and what the errors of these, which all rests share, do
to the means. `simval.imu.calibrate.reduction` makes one of rows; a simulation states
its trials as they are.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import (
    Array,
    ReadOnly,
    frozen,
    noise_levels,
    nonnegative_number,
    physical_array,
    positive_number,
    shaped_array,
)
from simval.errors import InputError
from simval.imu.calibrate.accelerometer import checked_time, pose_means
from simval.imu.calibrate.path_statistics import InterRestRotations
from simval.imu.calibrate.result import FitResult
from simval.imu.calibrate.thermal import Term
from simval.imu.sensor import forms
from simval.shapes import Float
from simval.spelling import counted
from simval.vocabulary import Model

Hemisphere = Literal["unstated", "north", "south"]
HEMISPHERES = get_args(Hemisphere)
Bias = Literal["constant", "first rest", "line"]
BIASES = get_args(Bias)
OTHERS = ("gyroscope", "magnetometer")
"""Sensors beside the accelerometer, without which there are no rests."""


class Taken(NamedTuple):
    """A known effect that was taken out of the readings, with its covariance."""

    thermal: Mapping[str, Term] = {}  # by sensor
    # what specific force does to the gyroscope, raw units per m/s^2, and its sd, (3, 3)
    G: Any = frozen(np.zeros((3, 3)))
    G_sd: Any = frozen(np.zeros((3, 3)))
    reasons: tuple[str, ...] = ()  # of what was chosen by evidence
    # what each of c independent errors of a sensor's terms does to its means, of one
    # standard deviation each, (c, n, 3)
    shifts: Mapping[str, Any] = {}
    # what the error of a scale's term adds to the covariance of the gyroscope's M
    of_scale: Any = frozen(np.zeros((9, 9)))


NOTHING = Taken()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording(ReadOnly):
    """What each sensor showed in each of n rests, of one recording or of many trials.

    Checked when made. Leading axes ``...`` are empty for one recording and (trials,)
    for a batch; a standard deviation is one number, one of each rest (n,), of each of
    its axes (n, 3), or of each trial's rests (trials, n).

    Attributes
    ----------
    poses : array_like
        Mean reading of the accelerometer, raw units, own axes, (..., n, 3).
    pose_std : float or array_like
        Noise of each axis of such a mean, raw units.
    fields, field_std : optional
        The same of a magnetometer.
    rotations : InterRestRotations or None
        A gyroscope between the rests, see `inter_rest_rotations`.
    angle_random_walk : float, array_like or None
        White noise N of the gyroscope, raw units per root hertz, one number or (3,);
        None: from the scatter within rests.
    bias_random_walk : float
        K, raw units times root hertz.
    clock_jitter : float
        Standard deviation of each time stamp, s, where the rows are even and their
        stamps are not.
    bias : {"constant", "first rest", "line"}
        Model of the gyroscope's bias. constant is estimated, from the rests and the
        rotations (unweighted: from the rests alone); first rest is the mean of that and
        kept (IMU-TK); line is what `rotations` have lost already.
    known_bias : array_like or None
        Raw units, (3,): kept instead of the mean of the first rest.
    bias_std : float, array_like or None
        How well the rests tell the bias, raw units, one number or (3,); None: by their
        white noise.
    time : array_like or None
        When each rest was, s, (n,); None: in their order.
    g, g_std : float
        Gravity there and its standard deviation, m/s^2; 0 takes it as exact.
    field : float
        Strength of the magnetic field there, in the unit that the magnetometer's M is
        wanted in; it changes nothing else.
    hemisphere : {"unstated", "north", "south"}
        Where it was made. (M, dip) and (-M, -dip) fit alike; unstated, the one with
        right-handed axes (det M > 0) is taken, and a left-handed order of columns
        cannot be seen.
    model : {"triangular", "upper", "symmetric"}
        Form of the accelerometer, whose axes all sensors get.
    accelerometer : FitResult or None
        The accelerometer's own calibration, of these poses as a rule: a start, and by
        what a gyroscope is calibrated that is not fitted together with it. None: found.
    taken : Taken
        What was taken out of the readings.

    Raises
    ------
    InputError
        If a value is not usable, or the sensors do not have the same rests.
    """

    poses: Float[Array, "... n 3"]
    pose_std: Any
    fields: Float[Array, "... n 3"] | None = None
    field_std: Any = None
    rotations: InterRestRotations | None = None
    angle_random_walk: Any = None
    bias_random_walk: float = 0.0
    clock_jitter: float = 0.0
    bias: Bias = "constant"
    known_bias: Any = None
    bias_std: Any = None
    time: Any = None
    g: float = 9.80665
    g_std: float = 0.0
    field: float = 1.0
    hemisphere: Hemisphere = "unstated"
    model: Model = "triangular"
    accelerometer: FitResult | None = None
    taken: Taken = NOTHING

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {"poses": pose_means("poses", self.poses)}
        shape = checked["poses"].shape
        checked["pose_std"] = std_of("pose_std", self.pose_std, shape)
        if self.fields is not None:
            checked["fields"] = pose_means("fields", self.fields)
            checked["field_std"] = std_of("field_std", self.field_std, shape)
            if checked["fields"].shape != shape:
                msg = (
                    f"`poses` has shape {shape} and `fields` {checked['fields'].shape};"
                    " give the means of both sensors over the same rests, in order"
                )
                raise InputError(msg)
        if self.rotations is not None:
            rests = instance("rotations", self.rotations, InterRestRotations).rest_rates
            trials = 1 if len(shape) == 2 else shape[0]
            if rests.shape != (trials, *shape[-2:]) or shape[-2] < 3:
                msg = (
                    f"`rotations` has {counted(len(rests), 'trial')} of "
                    f"{rests.shape[1]} rests, but `poses` has shape {shape}; give one "
                    "pose for each rest, three rests or more"
                )
                raise InputError(msg)
        if self.accelerometer is not None:
            own = instance("accelerometer", self.accelerometer, FitResult)
            require_same("accelerometer", own, self)
        checked |= self._noise()
        checked["time"] = checked_time(self.time, shape[-2])
        checked["g"] = positive_number("g", self.g, "m/s^2")
        checked["g_std"] = nonnegative_number("g_std", self.g_std, "m/s^2")
        checked["field"] = positive_number("field", self.field, "")
        checked["model"] = choice("model", self.model, forms.MODELS)
        checked["hemisphere"] = choice("hemisphere", self.hemisphere, HEMISPHERES)
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        ReadOnly.__post_init__(self)

    def _noise(self) -> dict[str, Any]:
        # of the gyroscope, checked
        K = nonnegative_number("bias_random_walk", self.bias_random_walk, "raw units")
        jitter = nonnegative_number("clock_jitter", self.clock_jitter, "s")
        checked: dict[str, Any] = {
            "bias": choice("bias", self.bias, BIASES), "bias_random_walk": K,
            "clock_jitter": jitter,
        }  # fmt: skip
        for name in ("angle_random_walk", "bias_std"):
            if (value := getattr(self, name)) is not None:
                checked[name] = np.array(noise_levels(name, value, 3, "axes"))
        if self.known_bias is not None:
            checked["known_bias"] = physical_array("known_bias", self.known_bias, (3,))
            if self.bias == "constant":
                msg = (
                    "`known_bias` is given, but `bias` is constant; ask for "
                    "bias='first rest'"
                )
                raise InputError(msg)
        return checked

    @property
    def single(self) -> bool:
        """True for one recording, False for a batch of trials."""
        return self.poses.ndim == 2

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors other than the accelerometer."""
        there = (self.rotations is not None, self.fields is not None)
        return tuple(n for n, given in zip(OTHERS, there, strict=True) if given)

    @property
    def shifts(self) -> list[dict[str, Array]]:
        """Each independent error of a term, as the change of its sensor's means."""
        return [
            {name: shift}
            for name, each in self.taken.shifts.items()
            for shift in each
            if name == "accelerometer" or name in self.sensors
        ]

    def moved(self, shift: Mapping[str, Array]) -> "Recording":
        """The same recording with its means shifted, and no term taken out.

        Parameters
        ----------
        shift : mapping of str to Array
            What is added to the means of a sensor, raw units, (n, 3).

        Returns
        -------
        Recording
            The recording.
        """
        poses = self.poses + shift.get("accelerometer", 0.0)
        fields = self.fields
        if fields is not None:
            fields = fields + shift.get("magnetometer", 0.0)
        return replace(self, poses=poses, fields=fields, taken=NOTHING)

    def of(self, sensors: tuple[str, ...]) -> "Recording":
        """The same recording with only these sensors.

        Parameters
        ----------
        sensors : tuple of str
            Sensors that are kept beside the accelerometer.

        Returns
        -------
        Recording
            The recording.
        """
        changed: dict[str, Any] = {}
        if "gyroscope" not in sensors:
            changed["rotations"] = None
        if "magnetometer" not in sensors:
            changed |= {"fields": None, "field_std": None}
        return replace(self, **changed)


def require_same(name: str, fit: FitResult, recording: Recording) -> None:
    """Check that a calibration has the gravity and the form of a recording."""
    g, g_std, model = recording.g, recording.g_std, recording.model
    if (fit.g, fit.g_std, fit.model) != (g, g_std, model):
        msg = (
            f"`{name}` was calibrated with g = {fit.g:g} ± {fit.g_std:.2g} "
            f"m/s^2 in the {fit.model} form, but the recording has {g:g} ± "
            f"{g_std:.2g} and {model}; make them the same: g=fit.g, "
            "g_std=fit.g_std, model=fit.model"
        )
        raise InputError(msg)


def std_of(name: str, value: Any, shape: tuple[int, ...]) -> Float[Array, "..."]:
    """Check the noise of means: one number, one a rest, an axis or a trial.

    Raises
    ------
    InputError
        If there is none, its shape is another, or one is negative or not finite.
    """
    if value is None:
        msg = (
            f"`{name}` is missing; the equations of a rest are weighted by the "
            "noise of the sensors, so give the standard deviation of each axis "
            "of a mean in raw units (usually that of a rest over the root of "
            "its samples)"
        )
        raise InputError(msg)
    given, count = shaped_array(name, value, ()), shape[-2]
    trials = shape[0] if len(shape) == 3 else None
    each = given.shape[:-2] in ((), (trials,)) and given.shape[-2:-1] == (count,)
    if each and given.shape[-1] in (1, 3):  # of the axes
        rows = np.moveaxis(given, -2, -1).reshape(-1, count)
        noise_levels(name, rows, count, trials=len(rows))
        return given
    return np.array(noise_levels(name, given, count, trials=trials)[..., None])
