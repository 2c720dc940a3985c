r"""Rounding of a converter: its step, and what it leaves in the noise.

Rounding to a step q adds, where the noise is half a step or more, white noise of the
variance :math:`q^2/12`  (V7), to 1.5 % of that. Below, a reading sticks to one value
and its error follows the signal: neither white nor a noise of the sensor.
"""

from typing import Final

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

SHARE: Final = 12.0  # of a squared step: its variance
LEAST: Final = 0.5  # standard deviations of the noise in steps, rounding taken off
_SAME: Final = 1e-3  # relative: a file's decimals round a step that is no power of ten
_FEW: Final = 4  # readings to a value: with fewer the steps between them are chance


def rounding_step(signal: Float[Array, " n"]) -> float:
    """Step of which all differences of readings are multiples; 0 if there is none."""
    values = np.unique(signal)
    if not 2 <= len(values) <= len(signal) / _FEW:
        return 0.0
    gaps = np.diff(values)
    step = float(gaps.min())
    if _noise(values, step) >= LEAST:  # steps of the readings' last digits
        return 0.0
    steps = gaps / step
    odd = np.abs(steps - np.round(steps)) > _SAME * np.round(steps) + _noise(
        values, step
    )
    return 0.0 if np.any(odd) else step


def _noise(values: Float[Array, " n"], step: float) -> float:
    # digits that a difference of large readings has lost, in steps
    return float(8.0 * np.finfo(float).eps * np.abs(values).max() / step)


def is_dithered(variance: float, step: float) -> bool:
    """Whether noise of a total variance in a row makes rounding to a step white."""
    return variance - step**2 / SHARE >= (LEAST * step) ** 2
