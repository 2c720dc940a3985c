"""Checks of the arguments of a calibration, once, at the public boundary."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arguments import choice, switch, whole_number
from simval.arrays import (
    Array,
    noise_levels,
    physical_array,
    positive_number,
    shaped_array,
)
from simval.calibrate.residuals import LOSSES, RESIDUALS, WEIGHTED
from simval.calibrate.solver import METHODS, Rules
from simval.errors import GeometryError, InputError
from simval.poses import PARAMETERS
from simval.sensor import forms
from simval.shapes import Float
from simval.text import shown

# Above it (singular values 1e4 apart) the moments, whose condition is the square, keep
# under eight digits, and 1 mm/s^2 of noise becomes 0.6 m/s^2 of bias or more.
CONDITION_LIMIT = 1e3
_GREATEST = 1e60  # fourth powers stay finite


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Options:
    """What to fit and how; checked when it is made."""

    # model, method, residual, loss: form, solver, residual and robust loss
    model: str
    method: str
    residual: str
    loss: str
    g: float  # gravity, m/s^2
    step: float  # fraction of each step taken
    tolerance: float  # limit of the stop rule
    max_iterations: int  # most steps for a trial
    full_scale: float | None  # greatest reading, raw units
    repeats: bool  # whether readings may repeat exactly
    condition_limit: float  # greatest condition of the poses
    covariance: bool  # whether the covariance is wanted

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            name: choice(name, getattr(self, name), allowed)
            for name, allowed in choices().items()
        }
        if self.loss != "linear" and self.residual not in ("squared", "weighted"):
            msg = (
                f"`loss` is {self.loss!r} with residual {self.residual!r}; a robust "
                "loss goes with the squared or the weighted residual"
            )
            raise InputError(msg)
        units = {"g": "m/s^2", "tolerance": "", "condition_limit": "", "step": ""}
        if self.full_scale is not None:
            units["full_scale"] = "raw units"
        for name, unit in units.items():
            checked[name] = positive_number(name, getattr(self, name), unit)
        if not checked["step"] <= 1.0:
            msg = f"`step` is {shown(self.step)}; it must be above 0 and at most 1"
            raise InputError(msg)
        checked["max_iterations"] = whole_number(
            "max_iterations", self.max_iterations, 1
        )
        for name in ("repeats", "covariance"):
            checked[name] = switch(name, getattr(self, name))
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def rules(self) -> Rules:
        """What governs the solver."""
        return Rules(
            method=self.method,
            step=self.step,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
        )


def choices() -> dict[str, tuple[str, ...]]:
    """Values of each option that is a choice."""
    return {
        "model": forms.MODELS,
        "method": METHODS,
        "residual": RESIDUALS,
        "loss": ("linear", *LOSSES),
    }


def checked_readings(poses: Any) -> Float[Array, "n 3"] | Float[Array, "trials n 3"]:
    """Return the readings as an array of nine poses or more.

    Raises
    ------
    InputError
        If the shape is wrong, or one set is not finite.
    GeometryError
        If there are fewer than nine poses.
    """
    readings = shaped_array("poses", poses, (None, 3))
    if readings.ndim > 3 or readings.size == 0:
        msg = f"`poses` has shape {readings.shape}; give (n, 3) or (trials, n, 3)"
        raise InputError(msg)
    count = readings.shape[-2]
    if count < PARAMETERS:
        msg = (
            f"{count} pose(s) given; nine parameters need {PARAMETERS} or more in "
            "different directions, and error bars need 10 or more: add poses"
        )
        raise GeometryError(msg)
    if readings.ndim == 2 and not np.isfinite(readings).all():
        pose, axis = (int(i) for i in np.argwhere(~np.isfinite(readings))[0])
        msg = (
            f"`poses` has {np.count_nonzero(~np.isfinite(readings))} non-finite "
            f"value(s), the first ({readings[pose, axis]}) in pose {pose}, axis "
            f"{'xyz'[axis]}; every reading must be finite, so remove that pose"
        )
        raise InputError(msg)
    with np.errstate(invalid="ignore"):
        greatest = float(
            np.max(np.abs(readings), initial=0.0, where=np.isfinite(readings))
        )
    if not (greatest == 0.0 or 1.0 / _GREATEST <= greatest <= _GREATEST):
        msg = (
            f"the greatest reading of `poses` is {greatest:g}, outside "
            f"{1.0 / _GREATEST:g} to {_GREATEST:g}; give raw counts or m/s^2"
        )
        raise InputError(msg)
    return readings


def checked_noise(
    noise_std: Any, count: int, residual: str
) -> Float[Array, " n"] | None:
    """Return the noise of each pose.

    Raises
    ------
    InputError
        If it is negative, not finite, of a wrong shape, or missing.
    """
    if noise_std is None:
        if residual == "adjusted":
            msg = (
                "`residual` is 'adjusted', which takes the known noise out of the "
                "moments, but `noise_std` is not given; give the standard deviation "
                "of a pose mean in raw units"
            )
            raise InputError(msg)
        return None
    sigma = noise_levels("noise_std", noise_std, count)
    if residual in WEIGHTED and not np.all(sigma > 0.0) and np.any(sigma > 0.0):
        msg = (
            f"`noise_std` is 0 for {np.count_nonzero(sigma == 0.0)} of {count} poses; "
            f"residual {residual!r} weighs each pose by 1/noise^2, so give every pose "
            "the noise that it has"
        )
        raise InputError(msg)
    return sigma


def checked_time(time: Any, count: int) -> Float[Array, " n"]:
    """Return when each pose was taken, 0, 1, 2 ... if not given.

    Raises
    ------
    InputError
        If the shape is wrong, a time is not finite, or all are the same.
    """
    if time is None:
        return np.arange(float(count))
    values = physical_array("time", time, (count,))
    if values.shape != (count,) or not np.ptp(values) > 0.0:
        msg = (
            f"`time` has shape {values.shape} and spans {shown(float(np.ptp(values)))} "
            f"s; give the time of each of the {count} poses, s"
        )
        raise InputError(msg)
    return values
