"""Confidence intervals from standard deviations, the same for every sensor."""

import numpy as np
import scipy

from simval.arrays import Array, real_number
from simval.errors import InputError
from simval.shapes import Float
from simval.text import shown


def one_tail(level: float) -> float:
    """Probability beyond either end of an interval.

    Raises
    ------
    InputError
        If `level` is not between 0 and 1.
    """
    if not 0.0 < real_number("level", level, "") < 1.0:
        msg = f"`level` is {shown(level)}; it must be a probability between 0 and 1"
        raise InputError(msg)
    return (1.0 - level) / 2.0


def around(
    parameters: Float[Array, "... p"], half: Float[Array, "... p"]
) -> Float[Array, "... p 2"]:
    """Ends at half a width on either side."""
    return np.stack([parameters - half, parameters + half], axis=-1)


def normal_intervals(
    parameters: Float[Array, "... p"], sd: Float[Array, "... p"], level: float
) -> Float[Array, "... p 2"]:
    """Intervals of a known noise, by normal quantiles."""
    return around(parameters, -scipy.special.ndtri(one_tail(level)) * sd)
