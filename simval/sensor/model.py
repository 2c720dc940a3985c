r"""The accelerometer of the IMU-TK derivation.

.. math:: T K (y - B) = f, \qquad y = (T K)^{-1} f + B + n,
   \quad n \sim N(0, \sigma^2 I_3)  \tag{S1}

:math:`f` is the specific force in sensor coordinates, m/s^2; :math:`y` and
:math:`B` are in raw units (m/s^2 or counts), and :math:`K` is m/s^2 per raw unit.
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
from simval.sensor import forms
from simval.sensor.rows import unscaled
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AccelerometerModel:
    """A calibrated accelerometer, eq. (S1).

    Attributes
    ----------
    T : Array
        Misalignment, (3, 3).
    K : Array
        Scale, m/s^2 per raw unit, (3,); or a full matrix, (3, 3).
    B : Array
        Bias, raw units, (3,).
    noise_std : float, default 0.0
        Standard deviation of white noise on each axis and sample, raw units.

    Raises
    ------
    InputError
        If an argument has the wrong shape, is not finite, or T K is singular.
    """

    T: Float[Array, "3 3"]
    K: Float[Array, "3"]
    B: Float[Array, "3"]
    noise_std: float = 0.0

    def __post_init__(self) -> None:
        scale = physical_array("K", self.K, (), GREATEST**2)
        if scale.shape not in ((3,), (3, 3)):
            msg = f"`K` has shape {scale.shape}; it must be (3,) or (3, 3)"
            raise InputError(msg)
        shapes = {"T": (3, 3), "K": scale.shape, "B": (3,)}
        for name, shape in shapes.items():
            value = physical_array(name, getattr(self, name), shape, GREATEST**2)
            if value.shape != shape:
                msg = f"`{name}` has shape {value.shape}; one sensor needs {shape}"
                raise InputError(msg)
            object.__setattr__(self, name, frozen(value))
        noise = nonnegative_number("noise_std", self.noise_std, "raw units")
        object.__setattr__(self, "noise_std", noise)
        values = np.linalg.svd(self.matrix, compute_uv=False)
        if not (values[0] == 0.0 or LEAST**2 <= values[0] <= GREATEST**2):
            msg = (
                f"T K has size {values[0]:.1e}; from {LEAST**2:g} to {GREATEST**2:g} "
                "m/s^2 per raw unit can be worked with, so check the unit of K"
            )
            raise InputError(msg)
        condition = values[0] / values[2] if values[2] > 0.0 else np.inf
        if not condition < 1.0 / np.finfo(float).eps:
            msg = (
                f"T K is singular (condition {condition:.1e}); each axis needs a scale "
                "other than 0 and the axes must not lie in a plane"
            )
            raise InputError(msg)

    @property
    def matrix(self) -> Float[Array, "3 3"]:
        """M = T K, raw units to m/s^2, (3, 3)."""
        scale = np.diag(self.K) if self.K.ndim == 1 else self.K
        return self.T @ scale

    @property
    def gain(self) -> Array:
        """Another name of `matrix`."""
        return self.matrix

    @property
    def parameters(self) -> Float[Array, "9"]:
        """The nine parameters of the triangular form, (9,); exact only in that form."""
        if self.K.ndim == 1 and np.array_equal(self.T, np.tril(self.T)):
            off = [self.T[1, 0], -self.T[2, 0], self.T[2, 1]]
            return np.concatenate([off, self.K, self.B])
        gram = self.matrix.T @ self.matrix
        return forms.from_gram("triangular", gram, self.B)

    @classmethod
    def from_parameters(
        cls,
        parameters: Float[Array, "9"],
        *,
        model: str = "triangular",
        noise_std: float = 0.0,
    ) -> "AccelerometerModel":
        """Build the sensor from nine parameters.

        Parameters
        ----------
        parameters : Array
            Nine parameters in the order of ``names(model)``, (9,).
        model : str, default "triangular"
            Form of the parameters.
        noise_std : float, default 0.0
            Noise per axis and sample, raw units.

        Returns
        -------
        AccelerometerModel
            The sensor.
        """
        model = forms.check_model(model)
        values = physical_array("parameters", parameters, (9,), GREATEST**2)
        if values.ndim != 1:
            msg = f"`parameters` has shape {values.shape}; one sensor has nine: (9,)"
            raise InputError(msg)
        T, K, B = forms.factors(model, values)
        return cls(T=T, K=K, B=B, noise_std=noise_std)

    def distort(
        self, f_s: Float[Array, "... 3"], rng: np.random.Generator
    ) -> Float[Array, "... 3"]:
        """Raw readings of a specific force, eq. (S1).

        Parameters
        ----------
        f_s : Array
            Specific force, sensor coordinates, m/s^2, (..., 3).
        rng : numpy.random.Generator
            The stream of the noise; not drawn from when `noise_std` is 0.

        Returns
        -------
        Array
            Raw readings, (..., 3).
        """
        force = physical_array("f_s", f_s, (3,))
        instance("rng", rng, np.random.Generator)
        raw = unscaled(self.matrix, force) + self.B
        if self.noise_std == 0.0:
            return raw
        return raw + self.noise_std * rng.standard_normal(raw.shape)

    def correct(self, raw: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
        """Specific force of raw readings, the inverse of eq. (S1) without noise.

        Parameters
        ----------
        raw : Array
            Raw readings, (..., 3).

        Returns
        -------
        Array
            Specific force, sensor coordinates, m/s^2, (..., 3).
        """
        reading = physical_array("raw", raw, (3,))
        return (reading - self.B) @ self.matrix.T
