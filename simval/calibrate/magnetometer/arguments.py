"""Checks of the arguments of a magnetometer's calibration, once, at its boundary."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arguments import choice, instance, whole_number
from simval.arrays import (
    Array,
    noise_levels,
    physical_array,
    positive_number,
    shaped_array,
)
from simval.calibrate.result import FitResult
from simval.errors import GeometryError, InputError, RefusedError
from simval.sensor import forms
from simval.shapes import Float

FEWEST = 8
"""Poses: three equations each for 22 parameters."""
FEWEST_KNOWN = 7
"""Poses with a known accelerometer: two equations each for the other 13 parameters."""
HEMISPHERES = ("unstated", "north", "south")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Options:
    """What to fit and how; checked when it is made."""

    g: float  # gravity, m/s^2
    field: float  # strength of the field, in the unit that is wanted
    model: str  # form of the accelerometer's parameters
    hemisphere: str  # one of `HEMISPHERES`
    max_iterations: int  # most steps for a trial
    known: FitResult | None  # the accelerometer, from poses other than these

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            "g": positive_number("g", self.g, "m/s^2"),
            "field": positive_number("field", self.field, ""),
            "model": choice("model", self.model, forms.MODELS),
            "hemisphere": choice("hemisphere", self.hemisphere, HEMISPHERES),
            "max_iterations": whole_number("max_iterations", self.max_iterations, 1),
        }
        if self.known is not None:
            checked["known"] = _known(self.known, checked["g"])
            checked["model"] = checked["known"].model
        for name, value in checked.items():
            object.__setattr__(self, name, value)


def _known(known: Any, g: float) -> FitResult:
    known = instance("known", known, FitResult)
    if known.g != g:
        msg = (
            f"`known` was calibrated with g = {known.g:g} m/s^2 and `g` is {g:g}; the "
            "two must be the same, so pass `g=known.g`"
        )
        raise InputError(msg)
    scaled = known.covariance / (known.sd[..., :, None] * known.sd[..., None, :])
    usable = np.isfinite(scaled).all() and np.isfinite(known.parameters).all()
    if not (usable and np.all(np.linalg.eigvalsh(scaled) > 1e-12)):
        msg = (
            "`known` has no covariance that can be inverted "
            f"(covariance_kind is {known.covariance_kind!r}); calibrate the "
            "accelerometer with `noise_std`, or from ten poses or more, or leave "
            "`known` out and both sensors are fitted together"
        )
        raise InputError(msg)
    return known


def checked_pair(
    accelerometer: Any, magnetometer: Any, known: FitResult | None
) -> tuple[Array, Array]:
    """Return the pose means of both sensors, (n, 3) or (trials, n, 3).

    Raises
    ------
    InputError
        If a shape is wrong or the two differ, or one set is not finite.
    GeometryError
        If there are too few poses.
    """
    pair = [
        _readings("accelerometer", accelerometer),
        _readings("magnetometer", magnetometer),
    ]
    shapes = [readings.shape for readings in pair]
    if shapes[0] != shapes[1]:
        msg = (
            f"`accelerometer` has shape {shapes[0]} and `magnetometer` {shapes[1]}; "
            "give the means of both sensors over the same poses, in the same order"
        )
        raise InputError(msg)
    count, fewest = shapes[0][-2], FEWEST if known is None else FEWEST_KNOWN
    if known is not None and known.parameters.shape[:-1] not in ((), shapes[0][:-2]):
        msg = (
            f"`known` holds {known.parameters.shape[0]} calibrations for readings of "
            f"shape {shapes[0]}; give one, or one for each trial"
        )
        raise InputError(msg)
    if count < fewest:
        what = (
            "three equations, and 22 parameters need"
            if known is None
            else "two equations for the magnetometer, and its 13 parameters need"
        )
        msg = (
            f"{count} pose(s) given; each gives {what} {fewest} poses or more, turned "
            "and tilted to all sides: add poses"
        )
        raise GeometryError(msg)
    return pair[0], pair[1]


def _readings(name: str, value: Any) -> Array:
    readings = shaped_array(name, value, (None, 3))
    if readings.ndim > 3 or readings.size == 0:
        msg = f"`{name}` has shape {readings.shape}; give (n, 3) or (trials, n, 3)"
        raise InputError(msg)
    if readings.ndim == 2 and not np.isfinite(readings).all():
        pose, axis = (int(i) for i in np.argwhere(~np.isfinite(readings))[0])
        msg = (
            f"`{name}` has {np.count_nonzero(~np.isfinite(readings))} non-finite "
            f"value(s), the first ({readings[pose, axis]}) in pose {pose}, axis "
            f"{'xyz'[axis]}; every reading must be finite, so remove that pose from "
            "both sensors"
        )
        raise InputError(msg)
    physical_array(name, readings[np.isfinite(readings)], ())
    return readings


def checked_std(name: str, value: Any, count: int) -> Float[Array, " n"]:
    """Return the noise of each pose mean, which must be above zero.

    Raises
    ------
    InputError
        If it is missing, not above zero, or of a wrong shape.
    """
    if value is None:
        msg = (
            f"`{name}` is not given; the equations of a pose are weighed by the noise "
            "of both sensors, so give the standard deviation of each axis of a pose "
            "mean in raw units, as a rule that of a rest over the root of its samples"
        )
        raise InputError(msg)
    sigma = noise_levels(name, value, count)
    if not np.all(sigma > 0.0):
        msg = (
            f"`{name}` is 0 for {np.count_nonzero(sigma == 0.0)} of {count} poses; "
            "each pose is weighed by 1/noise^2, so give every pose the noise it has"
        )
        raise InputError(msg)
    return sigma


def refuse_repeated(accelerometer: Array, magnetometer: Array) -> None:
    """Refuse a set in which two poses are the same in every bit.

    Raises
    ------
    RefusedError
        If there are such poses.
    """
    both = np.concatenate([accelerometer, magnetometer], axis=1)
    _, first = np.unique(both, axis=0, return_index=True)
    again = np.setdiff1d(np.arange(len(both)), first)
    if again.size and len(first) > 1:
        same = int(np.flatnonzero((both == both[again[0]]).all(axis=1))[0])
        msg = (
            f"poses {same} and {again[0]} are identical in every bit of both sensors; "
            "means of two holds never are, so the same data was counted twice: remove "
            "one"
        )
        raise RefusedError(msg)
