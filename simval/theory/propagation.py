r"""Linear error propagation from the readings to the attitude.

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

import numpy as np

from simval.arrays import Array, ReadOnly
from simval.geometry import compose, conjugate
from simval.imu.sensor import forms
from simval.shapes import Float, Inexact
from simval.theory.expansion import mean_linear_error, tangent_projector
from simval.theory.magnetometer import PARAMETERS, Problem, equations_of
from simval.theory.two_vector import two_vector_geometry

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
    """True vectors and attitudes of the second tumble's rests.

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
    """Linear maps from each source of error to the attitude at one true pose.

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

    def parts(self, calibration: Float[Array, "2 22 22"]) -> Float[Array, "5 3 3"]:
        """Covariance of the small rotation by source of error, in PARTS' order."""
        tumble = self.jacobian @ calibration @ self.jacobian.T
        total = tumble[0] + tumble[1] + self.force + self.field
        return np.stack([*tumble, self.force, self.field, total])


def calibration_parts(problem: Problem) -> Float[Array, "2 22 22"]:
    """Covariance of the 22 parameters by the sensor whose noise it is, eq. (B2).

    The last parameter is the sine of the dip.
    """
    slope = equations_of(problem).slope.reshape(PARAMETERS, -1, 2, 3)
    return np.einsum("insk,jnsk->sij", slope, slope)


def carrier(
    problem: Problem, wanted: Wanted, k: int, force_std: float, field_std: float
) -> Carrier:
    """Linearise the way from the readings to the attitude at one pose, eq. (B1)."""
    theta = problem.theta
    gains = _gains(wanted.q[k], wanted.field_world)
    truth = wanted.force[k], wanted.field[k]
    matrices = _matrices(problem, theta)
    raw = [
        np.linalg.solve(M, v) + theta[place]
        for M, v, place in zip(matrices, truth, (_BIAS, _IRON), strict=True)
    ]
    across = [_across(v) for v in truth]
    columns = [
        [v.imag / STEP for v in corrected(problem, theta + 1j * STEP * e, raw)]
        for e in np.eye(PARAMETERS)
    ]
    by_theta = np.moveaxis(np.array(columns), 0, -1)  # (2, 3, 22)
    noise = [
        std * A @ P @ M
        for std, A, P, M in zip(
            (force_std, field_std), gains, across, matrices, strict=True
        )
    ]
    return Carrier(
        jacobian=sum(
            A @ P @ each for A, P, each in zip(gains, across, by_theta, strict=True)
        ),
        force=noise[0] @ noise[0].T,
        field=noise[1] @ noise[1].T,
    )


_BIAS, _IRON = slice(6, 9), slice(18, 21)


def _across(v: Float[Array, "3"]) -> Float[Array, "3 3"]:
    # derivative of a vector's direction by the vector
    length = np.linalg.norm(v)
    return (np.eye(3) - np.outer(v, v) / length**2) / length


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
    back = conjugate(geometry.back @ geometry.q)
    rotation = -2.0 * compose(back, error)[..., :3]
    return rotation[0].T, rotation[1].T


def _matrices(
    problem: Problem, theta: Inexact[Array, "22"]
) -> tuple[Inexact[Array, "3 3"], Inexact[Array, "3 3"]]:
    # M of both sensors
    return forms.matrix(problem.form, theta[:9]), theta[9:18].reshape(3, 3)


def corrected(
    problem: Problem, theta: Inexact[Array, "22"], raw: list[Float[Array, "3"]]
) -> tuple[Inexact[Array, "3"], Inexact[Array, "3"]]:
    """Specific force and field of readings, analytic in the parameters."""
    M_a, M_m = _matrices(problem, theta)
    return M_a @ (raw[0] - theta[_BIAS]), M_m @ (raw[1] - theta[_IRON])
