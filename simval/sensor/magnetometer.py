r"""The magnetometer: a full matrix, because its axes are told by the accelerometer's.

.. math:: M (y - b) = m, \qquad y = M^{-1} m + b + n, \quad n \sim N(0, \sigma^2 I_3)
   \tag{M0}

:math:`m` is the field in the axes of the body, as a rule the accelerometer's, in any
unit of field; :math:`y` and the hard iron :math:`b` are in raw units. M holds scales,
misalignment, soft iron and the turn between the two sensors, nine numbers.
"""

from dataclasses import dataclass

import numpy as np

from simval.arguments import instance
from simval.arrays import (
    GREATEST,
    LEAST,
    Array,
    frozen,
    nonnegative_number,
    physical_array,
)
from simval.errors import InputError
from simval.sensor.rows import unscaled
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MagnetometerModel:
    """A calibrated magnetometer, eq. (M0).

    Attributes
    ----------
    M : Array
        Raw units to units of field, onto the axes of the body, (3, 3).
    b : Array
        Hard iron, raw units, (3,).
    noise_std : float, default 0.0
        Standard deviation of white noise on each axis and sample, raw units.

    Raises
    ------
    InputError
        If an argument has the wrong shape, is not finite, or M is singular.
    """

    M: Float[Array, "3 3"]
    b: Float[Array, "3"]
    noise_std: float = 0.0

    def __post_init__(self) -> None:
        for name, shape in {"M": (3, 3), "b": (3,)}.items():
            value = physical_array(name, getattr(self, name), shape, GREATEST**2)
            if value.shape != shape:
                msg = f"`{name}` has shape {value.shape}; one sensor needs {shape}"
                raise InputError(msg)
            object.__setattr__(self, name, frozen(value))
        noise = nonnegative_number("noise_std", self.noise_std, "raw units")
        object.__setattr__(self, "noise_std", noise)
        values = np.linalg.svd(self.M, compute_uv=False)
        if not LEAST**2 <= values[0] <= GREATEST**2:
            msg = (
                f"M has size {values[0]:.1e}; from {LEAST**2:g} to {GREATEST**2:g} "
                "units of field per raw unit can be worked with, so check the unit of M"
            )
            raise InputError(msg)
        if not values[2] > np.finfo(float).eps * values[0]:
            msg = (
                "M is singular; each axis needs a scale other than 0 and the axes must "
                "not lie in a plane"
            )
            raise InputError(msg)

    @property
    def right_handed(self) -> bool:
        """Whether the axes of the sensor are right-handed: det M > 0."""
        return bool(np.linalg.det(self.M / np.abs(self.M).max()) > 0.0)

    def distort(
        self, field_b: Float[Array, "... 3"], rng: np.random.Generator
    ) -> Float[Array, "... 3"]:
        """Raw readings of a field, eq. (M0).

        Parameters
        ----------
        field_b : Array
            Field, axes of the body, units of field, (..., 3).
        rng : numpy.random.Generator
            The stream of the noise; not drawn from when `noise_std` is 0.

        Returns
        -------
        Array
            Raw readings, (..., 3).
        """
        field = physical_array("field_b", field_b, (3,))
        instance("rng", rng, np.random.Generator)
        raw = unscaled(self.M, field) + self.b
        if self.noise_std == 0.0:
            return raw
        return raw + self.noise_std * rng.standard_normal(raw.shape)

    def correct(self, raw: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
        """Field of raw readings, the inverse of eq. (M0) without noise.

        Parameters
        ----------
        raw : Array
            Raw readings, (..., 3).

        Returns
        -------
        Array
            Field, axes of the body, units of field, (..., 3).
        """
        reading = physical_array("raw", raw, (3,))
        return (reading - self.b) @ self.M.T
