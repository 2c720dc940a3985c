"""What a filter is told wrongly, or a calibration left: words after a scenario's name.

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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.geometry import attitude_matrix
from simval.plugins.filter_signals import Told
from simval.shapes import Float

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
    """What is wrong; the defaults are right."""

    gyroscope_noise: float = 1.0
    accelerometer_noise: float = 1.0
    magnetometer_noise: float = 1.0
    scale: float = 0.0
    turned: float = 0.0
    calibration: float = 0.0

    @property
    def M(self) -> Float[Array, "3 3"]:
        """Matrix by which the gyroscope multiplies a rate."""
        half = self.turned / 2.0
        axis = np.ones(3) / np.sqrt(3.0)
        q = np.append(np.sin(half) * axis, np.cos(half))
        return (1.0 + self.scale) * attitude_matrix(q)

    def told(self, true: Told) -> Told:
        """What the filter is told instead of the truth."""
        return replace(
            true,
            gyroscope_noise=self.gyroscope_noise * true.gyroscope_noise,
            accelerometer_noise=self.accelerometer_noise * true.accelerometer_noise,
            magnetometer_noise=self.magnetometer_noise * true.magnetometer_noise,
        )


def wrong_of(parts: Sequence[str]) -> Wrong:
    """Read the words.

    Raises
    ------
    InputError
        If they are none of the table, or X is not allowed.
    """
    found: dict[str, float] = {}
    for part in parts:
        name, _, number = part.rpartition(" ")
        value = _number(number)
        least, most = MOST.get(name, (np.inf, -np.inf))
        if name in found or not least <= value <= most:
            raise _refused(part, name, name in found)
        found[name] = value
    return Wrong(**{name.replace(" ", "_"): value for name, value in found.items()})


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def _refused(part: str, name: str, twice: bool) -> InputError:
    if twice:
        return InputError(f"`scenario` has `{name}` twice; give it once")
    if name in MOST:
        least, most = MOST[name]
        msg = (
            f"`scenario` has {part[:60]!r}; the number of `{name}` must be from "
            f"{least:g} to {most:g}"
        )
        return InputError(msg)
    words = ", ".join(f"`{each} X`" for each in MOST)
    msg = f"`scenario` has {part[:60]!r}; after its name there may be {words}"
    return InputError(msg)
