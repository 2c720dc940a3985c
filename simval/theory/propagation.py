r"""Linear propagation of errors from the readings to the attitude.

The predicted error budget carries each source of noise through the calibration of both
sensors to the attitude. With the 22 parameters :math:`\theta` of the accelerometer and
the magnetometer beside it, the directions :math:`b_1 = M_a (y_a - B)/|f|` and
:math:`b_2 = M_m (y_m - b)/|m|` turn the estimate by

.. math:: \delta\rho = A_1\,\delta b_1 + A_2\,\delta b_2, \qquad
   \delta b_i = \tfrac{\partial b_i}{\partial\theta}\,\delta\theta
   + \tfrac{\partial b_i}{\partial y_i}\, n_i,  \tag{B1}

with the gains :math:`A_i` of the linear part of the two-vector theory, eq. (X1); the
references have no noise. The weighted fit of a tumble's poses, eqs. (M1), (M2), moves
by

.. math:: \delta\theta = -\Bigl(\sum_i J_i^T W_i J_i\Bigr)^{-1} \sum_i J_i^T W_i D_i
   n_i,  \tag{B2}

J and D the derivatives of a pose's equations by the parameters and by its readings, so
what either sensor's noise in the tumble leaves in the calibration is a covariance of
its own, and the two add up to the bound.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array, ReadOnly
from simval.geometry import compose, conjugate
from simval.imu.sensor import forms
from simval.shapes import Float, Inexact
from simval.theory.estimating import inverse_of
from simval.theory.expansion import mean_linear_error
from simval.theory.magnetometer import PARAMETERS, Problem, equations_of
from simval.theory.two_vector import tangent_projector, two_vector_geometry

PARTS = (
    "accelerometer noise in the tumble",
    "magnetometer noise in the tumble",
    "accelerometer noise",
    "magnetometer noise",
    "total",
)
UP = np.array([0.0, 0.0, 1.0])
STEP = 1e-20  # of the complex-step derivative: exact to rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wanted:
    """True vectors and attitudes in the rests of the second tumble.

    Attributes
    ----------
    force : Array
        Specific force, sensor axes, m/s^2.
    field : Array
        Magnetic field, sensor axes, of length 1.
    q : Array
        World to sensor, vector first.
    field_world : Array
        Direction of the field in world axes.
    """

    force: Float[Array, "k 3"]
    field: Float[Array, "k 3"]
    q: Float[Array, "k 4"]
    field_world: Float[Array, "3"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Carrier(ReadOnly):
    """Linear maps from each source of error to the attitude in one pose.

    Attributes
    ----------
    jacobian : Array
        Of the small rotation by the 22 parameters.
    force : Array
        Covariance of the small rotation from the accelerometer's noise, rad^2.
    field : Array
        The same from the magnetometer's.
    """

    jacobian: Float[Array, "3 22"]
    force: Float[Array, "3 3"]
    field: Float[Array, "3 3"]

    def parts(
        self, calibration: Float[Array, "... 2 22 22"]
    ) -> Float[Array, "... 5 3 3"]:
        """Covariance of the attitude error by source, in the order of PARTS."""
        tumble = self.jacobian @ calibration @ self.jacobian.T
        own = np.broadcast_to([self.force, self.field], tumble.shape)
        parts = np.concatenate([tumble, own], axis=-3)
        return np.concatenate([parts, parts.sum(axis=-3, keepdims=True)], axis=-3)


def calibration_parts(problem: Problem, ends: Any = ()) -> Float[Array, "t 2 22 22"]:
    """Covariance of the 22 parameters by the sensor that causes it, eq. (B2).

    Of each set of poses, which end at `ends`, calibrated by itself. The last parameter
    is the sine of the dip.
    """
    estimate = equations_of(problem)
    J, Z = estimate.jacobians[0], estimate.by_noises[0]
    V = np.stack([own @ own.mT for own in (Z[..., :3], Z[..., 3:])])
    weighed = np.linalg.solve(V.sum(axis=0), J)
    parts = []
    for rows in np.split(np.arange(len(J)), ends):
        w, j = weighed[rows], J[rows].reshape(-1, PARAMETERS)
        flat = w.reshape(-1, PARAMETERS)
        pushed = (V[:, rows] @ w).reshape(2, -1, PARAMETERS)
        inverse = inverse_of(flat.T @ j)
        parts.append(inverse @ (flat.T @ pushed) @ inverse)
    return np.array(parts)


def carrier(
    problem: Problem, wanted: Wanted, k: int, force_std: float, field_std: float
) -> Carrier:
    """Linearise the way from readings to attitude in one pose, eq. (B1)."""
    gains = _gains(wanted.q[k], wanted.field_world)
    truth, count = (wanted.force[k], wanted.field[k]), PARAMETERS
    at = np.concatenate([problem.theta, np.zeros(6)])  # and noise of both readings

    def direction(i: int, at: Inexact[Array, " p"]) -> Inexact[Array, "3"]:
        own, own_bias = _sensor(problem, problem.theta, i)
        M, bias = _sensor(problem, at, i)
        raw = np.linalg.solve(own, truth[i]) + own_bias
        v = M @ (raw + at[count + 3 * i : count + 3 * i + 3] - bias)
        return v / np.sqrt(v @ v)

    ways = at + 1j * STEP * np.eye(len(at))
    slopes = np.array([[direction(i, way) for i in (0, 1)] for way in ways])
    turned = np.einsum("iab,pib->ap", gains, slopes.imag / STEP)
    force, field = force_std * turned[:, count : count + 3], field_std * turned[:, -3:]
    return Carrier(
        jacobian=turned[:, :count], force=force @ force.T, field=field @ field.T
    )


def _gains(
    q: Float[Array, "4"], field_world: Float[Array, "3"]
) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
    # small rotation of the estimate, body side, by the two measured directions
    geometry = two_vector_geometry(q, UP, field_world)
    means = np.zeros((2, 3, 4, 3))
    means[0, :, 0], means[1, :, 1] = np.eye(3), np.eye(3)
    turned = np.array(
        [[mean_linear_error(geometry, mean) for mean in each] for each in means]
    )
    tangent = turned @ tangent_projector(geometry.q)
    error = tangent @ geometry.back.T  # truth minus estimate
    rotation = -2.0 * compose(conjugate(geometry.back @ geometry.q), error)[..., :3]
    return rotation[0].T, rotation[1].T


def _sensor(
    problem: Problem, theta: Inexact[Array, " p"], i: int
) -> tuple[Inexact[Array, "3 3"], Inexact[Array, "3"]]:
    # M and bias of the accelerometer, then of the magnetometer
    if i == 0:
        return forms.matrix(problem.form, theta[:9]), theta[6:9]
    return theta[9:18].reshape(3, 3), theta[18:21]
