r"""Calibrations of fewer than nine parameters, and what any calibration leaves.

A calibrator may estimate three biases, three scales and three biases, or all nine; the
rest of its model is fixed, :math:`T = I` without misalignments and :math:`K = 1`
without scales. What it leaves of the specific force is the error of
:math:`\hat M(y - \hat B)`, over all directions of a force of length g. No reading at
rest fixes the frame, so it is taken in the frame that fits best; with
:math:`s_i` the singular values of :math:`\hat M M^{-1}`,

.. math:: \min_Q E_u |Q \hat M (y - \hat B) - g u|^2
   = \tfrac{g^2}{3} \sum_i (s_i - 1)^2 + |\hat M (B - \hat B)|^2.  \tag{L1}
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from simval.arrays import Array
from simval.sensor.model import AccelerometerModel
from simval.shapes import Float

ALL = ("misalignment", "scale", "bias")

PLACES: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {"misalignment": (0, 1, 2), "scale": (3, 4, 5), "bias": (6, 7, 8)}
)
"""Where each kind of parameter stands among the nine."""

CLASSES = (("bias",), ("scale", "bias"), ALL)
"""What a calibrator can estimate."""

FIXED = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""The nine parameters of a reading that needs no calibration."""


def places_of(estimates: tuple[str, ...]) -> tuple[int, ...]:
    """Places of what is estimated among the nine parameters, in their order."""
    return tuple(k for name in ALL if name in estimates for k in PLACES[name])


def own_sensor(
    sensor: AccelerometerModel, estimates: tuple[str, ...]
) -> AccelerometerModel:
    """Return the same sensor without the errors that are not estimated."""
    values, places = FIXED.copy(), list(places_of(estimates))
    values[places] = sensor.parameters[places]
    return AccelerometerModel.from_parameters(values)


def mean_square_left(
    matrix: Float[Array, "3 3"],
    bias: Float[Array, "3"],
    sensor: AccelerometerModel,
    g: float,
) -> float:
    """Mean square of the specific-force error that a calibration leaves, eq. (L1)."""
    stretch = np.linalg.svd(matrix @ np.linalg.inv(sensor.matrix), compute_uv=False)
    shift = matrix @ (sensor.B - bias)
    return float(g**2 / 3.0 * np.sum((stretch - 1.0) ** 2) + shift @ shift)
