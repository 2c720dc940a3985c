r"""The rate gyroscope.

.. math:: y = M^{-1} \omega + B + G f + n, \qquad
   \omega = M\,(y - B - G f)  \tag{N0}

:math:`\omega` is the body rate, rad/s, and :math:`f` the specific force, m/s^2, both in
the axes of the accelerometer; :math:`y` and :math:`B` are in raw units (rad/s or
counts), M is rad/s per raw unit and G raw units per m/s^2. The mean of the noise n over
a time t has the standard deviation :math:`N/\sqrt{t}` on each axis.

**Gauge.** Norms of gravity leave the accelerometer's axes open up to a rotation, and
its form picks one (`simval.sensor.forms`). Forms whose forces are related by
:math:`f' = Q f` give the gyroscope :math:`M' = Q M` and :math:`G' = G Q^T`: a
gyroscope's misalignment means nothing without the form of the accelerometer.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arguments import instance
from simval.arrays import (
    GREATEST,
    Array,
    frozen,
    nonnegative_number,
    physical_array,
    positive_number,
)
from simval.errors import InputError
from simval.sensor.rows import unscaled
from simval.shapes import Float

_ORTHOGONAL = 1e-9  # of a rotation, by element; rounding leaves 1e-15


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

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[int, ...]] = {"M": (3, 3), "B": (3,)}
        if self.G is not None:
            shapes["G"] = (3, 3)
        for name, shape in shapes.items():
            value = physical_array(name, getattr(self, name), shape, GREATEST**2)
            if value.shape != shape:
                msg = f"`{name}` has shape {value.shape}; one sensor needs {shape}"
                raise InputError(msg)
            object.__setattr__(self, name, frozen(value))
        unit = "raw units per root hertz"
        walk = nonnegative_number("angle_random_walk", self.angle_random_walk, unit)
        object.__setattr__(self, "angle_random_walk", walk)
        values = np.linalg.svd(self.M, compute_uv=False)
        condition = values[0] / values[2] if values[2] > 0.0 else np.inf
        if not condition < 1.0 / np.finfo(float).eps:
            msg = (
                f"`M` is singular (condition {condition:.1e}); each axis needs a scale "
                "other than 0 and the axes must not lie in a plane"
            )
            raise InputError(msg)

    def distort(
        self,
        rate: Float[Array, "... 3"],
        rng: np.random.Generator,
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
        self, raw: Float[Array, "... 3"], *, specific_force: Any = None
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

    def in_frame(self, rotation: Any) -> "GyroscopeModel":
        """Return the same gyroscope beside an accelerometer of another form.

        Parameters
        ----------
        rotation : array_like
            Q, which takes the present axes to the wanted ones, (3, 3).

        Returns
        -------
        GyroscopeModel
            With Q M and G Q'.
        """
        Q = physical_array("rotation", rotation, (3, 3))
        off = float(np.abs(Q @ Q.T - np.eye(3)).max()) if Q.ndim == 2 else np.inf
        if not (off <= _ORTHOGONAL and np.linalg.det(Q) > 0.0):
            msg = (
                f"`rotation` is off by {off:.1e} from a rotation matrix; give one that "
                "is orthogonal and right-handed, (3, 3)"
            )
            raise InputError(msg)
        return GyroscopeModel(
            M=Q @ self.M,
            B=self.B,
            G=None if self.G is None else self.G @ Q.T,
            angle_random_walk=self.angle_random_walk,
        )

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
