r"""Models of the three sensors, and calibrations of fewer parameters.

The accelerometer is that of the IMU-TK derivation.

.. math:: T K (y - B) = f, \qquad y = (T K)^{-1} f + B + n,
   \quad n \sim N(0, \sigma^2 I_3)  \tag{S1}

:math:`f` is the specific force in sensor coordinates, m/s^2; :math:`y` and
:math:`B` are in raw units (m/s^2 or counts), and :math:`K` is m/s^2 per raw unit.

The rate gyroscope:

.. math:: y = M^{-1} \omega + B + G f + n, \qquad
   \omega = M\,(y - B - G f)  \tag{N0}

:math:`\omega` is the body rate, rad/s, and :math:`f` the specific force, m/s^2, both in
the axes of the accelerometer; :math:`y` and :math:`B` are in raw units (rad/s or
counts), M is rad/s per raw unit and G raw units per m/s^2. The mean of the noise n over
a time t has the standard deviation :math:`N/\sqrt{t}` on each axis.

**Gauge.** Norms of gravity leave the accelerometer's axes open up to a rotation, and
its form picks one (`simval.imu.sensor.forms`). Forms whose forces are related by
:math:`f' = Q f` give the gyroscope :math:`M' = Q M` and :math:`G' = G Q^T`: a
gyroscope's misalignment means nothing without the form of the accelerometer.

The magnetometer has a full matrix, because its axes are told by the accelerometer's.

.. math:: M (y - b) = m, \qquad y = M^{-1} m + b + n, \quad n \sim N(0, \sigma^2 I_3)
   \tag{M0}

:math:`m` is the field in the axes of the body, as a rule the accelerometer's, in any
unit of field; :math:`y` and the hard iron :math:`b` are in raw units. M holds scales,
misalignment, soft iron and the turn between the two sensors, nine numbers.

**Fewer parameters.** A calibrator may estimate three biases, three scales and three
biases, or all nine; the rest of its model is fixed, :math:`T = I` without misalignments
and :math:`K = 1` without scales. What it leaves of the specific force is the error of
:math:`\hat M(y - \hat B)`, over all directions of a force of length g. No reading at
rest fixes the frame, so it is taken in the frame that fits best; with
:math:`s_i` the singular values of :math:`\hat M M^{-1}`,

.. math:: \min_Q E_u |Q \hat M (y - \hat B) - g u|^2
   = \tfrac{g^2}{3} \sum_i (s_i - 1)^2 + |\hat M (B - \hat B)|^2.  \tag{L1}
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from simval.arguments import instance
from simval.arrays import (
    GREATEST,
    LEAST,
    Array,
    Matrix,
    Vector,
    frozen,
    nonnegative_number,
    physical_array,
    positive_number,
)
from simval.errors import InputError
from simval.imu.sensor import forms
from simval.shapes import Float
from simval.vocabulary import Model


def unscaled(
    matrix: Float[Array, "3 3"], values: Float[Array, "... 3"]
) -> Float[Array, "... 3"]:
    """Multiply by M^-1: the readings, less bias, that give these values."""
    # LAPACK takes ten times as long for many rows as their product with the inverse
    return values @ np.linalg.inv(matrix).T


def _keep_arrays(model: Any, shapes: Mapping[str, tuple[int, ...]]) -> None:
    # checked and read-only, in place of what was given
    for name, shape in shapes.items():
        value = physical_array(name, getattr(model, name), shape, GREATEST**2)
        if value.shape != shape:
            msg = f"`{name}` has shape {value.shape}; one sensor needs {shape}"
            raise InputError(msg)
        object.__setattr__(model, name, frozen(value))


def _require_usable(name: str, matrix: Float[Array, "3 3"], unit: str = "") -> None:
    # not singular, and of a size that can be worked with where a unit is named
    values = np.linalg.svd(matrix, compute_uv=False)
    if unit and not (values[0] == 0.0 or LEAST**2 <= values[0] <= GREATEST**2):
        msg = (
            f"{name} has size {values[0]:.1e}; from {LEAST**2:g} to {GREATEST**2:g} "
            f"{unit} can be worked with, so check its unit"
        )
        raise InputError(msg)
    condition = values[0] / values[2] if values[2] > 0.0 else np.inf
    if not condition < 1.0 / np.finfo(float).eps:
        msg = (
            f"{name} is singular (condition {condition:.1e}); each axis needs a scale "
            "other than 0 and the axes must not lie in a plane"
        )
        raise InputError(msg)


def _with_noise(
    raw: Float[Array, "... 3"], std: float, rng: "np.random.Generator"
) -> Float[Array, "... 3"]:
    # the stream is left alone where there is no noise
    if std == 0.0:
        return raw
    noise = rng.standard_normal(raw.shape)
    noise *= std
    noise += raw
    return noise


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
        If an argument has the wrong shape or is not finite, or if T K is singular.
    """

    T: Float[Array, "3 3"]
    K: Float[Array, "3"]
    B: Float[Array, "3"]
    noise_std: float = 0.0

    if TYPE_CHECKING:  # lists are taken as well

        def __init__(
            self, *, T: Matrix, K: Vector | Matrix, B: Vector, noise_std: float = 0.0
        ) -> None: ...

    def __post_init__(self) -> None:
        scale = physical_array("K", self.K, (), GREATEST**2)
        if scale.shape not in ((3,), (3, 3)):
            msg = f"`K` has shape {scale.shape}; it must be (3,) or (3, 3)"
            raise InputError(msg)
        shapes = {"T": (3, 3), "K": scale.shape, "B": (3,)}
        _keep_arrays(self, shapes)
        noise = nonnegative_number("noise_std", self.noise_std, "raw units")
        object.__setattr__(self, "noise_std", noise)
        _require_usable("T K", self.matrix, "m/s^2 per raw unit")

    @property
    def matrix(self) -> Float[Array, "3 3"]:
        """M = T K, raw units to m/s^2, (3, 3)."""
        scale = np.diag(self.K) if self.K.ndim == 1 else self.K
        return self.T @ scale

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
        parameters: Vector,
        *,
        model: Model = "triangular",
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
        self, f_s: ArrayLike, rng: "np.random.Generator"
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
        return _with_noise(raw, self.noise_std, rng)

    def correct(self, raw: ArrayLike) -> Float[Array, "... 3"]:
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopeModel:
    """A calibrated rate gyroscope, eq. (N0).

    Attributes
    ----------
    M : Array
        Raw units to body rate in the accelerometer's axes, rad/s per raw unit, (3, 3).
    B : Array
        Bias, raw units, (3,).
    G : Array or None
        Sensitivity to specific force, raw units per m/s^2, (3, 3); None is none.
    angle_random_walk : float, default 0.0
        White noise N of each axis, raw units per root hertz: the Allan deviation at
        one second, and over the root of the step the standard deviation of a sample.

    Raises
    ------
    InputError
        If an argument has the wrong shape, is not finite, or M is singular.
    """

    M: Float[Array, "3 3"]
    B: Float[Array, "3"]
    G: Float[Array, "3 3"] | None = None
    angle_random_walk: float = 0.0

    if TYPE_CHECKING:  # lists are taken as well

        def __init__(
            self,
            *,
            M: Matrix,
            B: Vector,
            G: Matrix | None = None,
            angle_random_walk: float = 0.0,
        ) -> None: ...

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[int, ...]] = {"M": (3, 3), "B": (3,)}
        if self.G is not None:
            shapes["G"] = (3, 3)
        _keep_arrays(self, shapes)
        unit = "raw units per root hertz"
        walk = nonnegative_number("angle_random_walk", self.angle_random_walk, unit)
        object.__setattr__(self, "angle_random_walk", walk)
        _require_usable("`M`", self.M)

    def distort(
        self,
        rate: ArrayLike,
        rng: "np.random.Generator",
        *,
        timestep: float | None = None,
        specific_force: Any = None,
    ) -> Float[Array, "... 3"]:
        """Raw readings of average body rates, eq. (N0).

        Parameters
        ----------
        rate : Array
            Average body rate over each step, accelerometer's axes, rad/s, (..., 3).
        rng : numpy.random.Generator
            The stream of the noise; not drawn from when there is none.
        timestep : float, optional
            Time that each reading averages, s; needed for the noise.
        specific_force : array_like, optional
            Specific force of each row, m/s^2, (..., 3); needed with `G`.

        Returns
        -------
        Array
            Raw readings, (..., 3).
        """
        rate = physical_array("rate", rate, (3,))
        instance("rng", rng, np.random.Generator)
        raw = unscaled(self.M, rate) + self._offset(specific_force, rate.shape)
        if self.angle_random_walk == 0.0:
            return raw
        if timestep is None:
            msg = "`timestep` is not given; noise of a sample depends on it, give it, s"
            raise InputError(msg)
        std = self.angle_random_walk / positive_number("timestep", timestep, "s") ** 0.5
        return raw + std * rng.standard_normal(raw.shape)

    def correct(
        self, raw: ArrayLike, *, specific_force: Any = None
    ) -> Float[Array, "... 3"]:
        """Body rate of raw readings, the inverse of eq. (N0) without noise.

        Parameters
        ----------
        raw : Array
            Raw readings, (..., 3).
        specific_force : array_like, optional
            Specific force of each row, m/s^2, (..., 3); needed with `G`.

        Returns
        -------
        Array
            Body rate, accelerometer's axes, rad/s, (..., 3).
        """
        reading = physical_array("raw", raw, (3,))
        return (reading - self._offset(specific_force, reading.shape)) @ self.M.T

    def _offset(self, specific_force: Any, shape: tuple[int, ...]) -> Array:
        # B + G f
        if self.G is None:
            return self.B
        if specific_force is None:
            msg = (
                "`specific_force` is not given; a gyroscope with a sensitivity `G` to "
                "it needs that of each row, m/s^2"
            )
            raise InputError(msg)
        force = physical_array("specific_force", specific_force, (3,))
        if force.shape not in ((3,), shape):
            msg = (
                f"`specific_force` has shape {force.shape} for rows of shape {shape}; "
                "give one of each row, or one for all"
            )
            raise InputError(msg)
        return self.B + force @ self.G.T


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

    if TYPE_CHECKING:  # lists are taken as well

        def __init__(self, *, M: Matrix, b: Vector, noise_std: float = 0.0) -> None: ...

    def __post_init__(self) -> None:
        _keep_arrays(self, {"M": (3, 3), "b": (3,)})
        noise = nonnegative_number("noise_std", self.noise_std, "raw units")
        object.__setattr__(self, "noise_std", noise)
        _require_usable("`M`", self.M, "units of field per raw unit")

    @property
    def right_handed(self) -> bool:
        """True if the axes of the sensor are right-handed: det M > 0."""
        return bool(np.linalg.det(self.M / np.abs(self.M).max()) > 0.0)

    def distort(
        self, field_b: ArrayLike, rng: "np.random.Generator"
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
        return _with_noise(raw, self.noise_std, rng)

    def correct(self, raw: ArrayLike) -> Float[Array, "... 3"]:
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


ALL = ("misalignment", "scale", "bias")

PLACES: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {"misalignment": (0, 1, 2), "scale": (3, 4, 5), "bias": (6, 7, 8)}
)
"""Places of each kind of parameter among the nine."""

CLASSES = (("bias",), ("scale", "bias"), ALL)
"""Sets of parameters that a calibrator can estimate."""

FIXED = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""The nine parameters of a reading that needs no calibration."""


def places_of(estimates: tuple[str, ...]) -> tuple[int, ...]:
    """Indices of the estimated parameters among the nine, in their order."""
    return tuple(k for name in ALL if name in estimates for k in PLACES[name])


def own_sensor(
    sensor: AccelerometerModel, estimates: tuple[str, ...]
) -> AccelerometerModel:
    """The same sensor, without the errors that are not estimated."""
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
