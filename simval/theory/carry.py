r"""The way of an error from the readings to the attitude, linearised.

The predicted error budget carries the covariance of the calibration through to the
attitude. With :math:`f = M (y - B)`, :math:`\theta` the nine parameters,
:math:`J = \partial f/\partial\theta` at the true reading and :math:`\sigma_f` the
noise of a mean reading, the direction :math:`b_1 = f/|f|` has the covariance

.. math:: P_{b_1} = \frac{1}{g^2}\left(J C_\theta J^T + \sigma_f^2 M M^T\right),
   \tag{B1}

the field's direction :math:`\sigma_m^2 I/|m|^2`, and the references none; the theory of
the two-vector estimate turns them into the covariance of the quaternion, and four times
its trace is the mean square of the angle. :math:`C_\theta` is theory's, for the number
of samples in each interval that was found.
"""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.geometry import compose, conjugate
from simval.sensor import AccelerometerModel
from simval.shapes import Float, Inexact
from simval.theory.attitude import attitude_moments

PARTS = ("calibration", "accelerometer noise", "magnetometer noise", "total")
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
        Magnetic field, sensor axes, T.
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
class Carrier:
    """Linear maps from each source of error to the attitude at one true pose.

    Attributes
    ----------
    jacobian : Array
        Of the direction b1 by the nine parameters.
    rotation : Array
        Covariance of the small rotation, rad^2, by that of b1: a linear map of
        symmetric matrices.
    noise : Array
        Covariance of the small rotation from the accelerometer's noise.
    field : Array
        The same from the magnetometer's.
    """

    jacobian: Float[Array, "3 9"]
    rotation: Float[Array, "3 3 3 3"]
    noise: Float[Array, "3 3"]
    field: Float[Array, "3 3"]

    def parts(self, covariance: Float[Array, "9 9"]) -> Float[Array, "4 3 3"]:
        """Covariance of the small rotation by source of error."""
        b1 = self.jacobian @ covariance @ self.jacobian.T
        calibration = np.einsum("abij,ij->ab", self.rotation, b1)
        total = calibration + self.noise + self.field
        return np.stack([calibration, self.noise, self.field, total])


def carrier(
    sensor: AccelerometerModel,
    wanted: Wanted,
    k: int,
    force_std: float,
    field_std: float,
) -> Carrier:
    """Linearise the way from the readings to the attitude at one pose, eq. (B1)."""
    force = wanted.force[k]
    g, strength = np.linalg.norm(force), np.linalg.norm(wanted.field[k])
    raw = np.linalg.solve(sensor.matrix, force) + sensor.B
    across = (np.eye(3) - np.outer(force, force) / g**2) / g
    columns = [
        corrected(sensor.parameters + 1j * STEP * e, raw).imag / STEP for e in np.eye(9)
    ]

    def turned(b1: Float[Array, "3 3"], b2: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
        return _rotation_covariance(wanted.q[k], wanted.field_world, b1, b2)

    none = np.zeros((3, 3))
    rotation = np.empty((3, 3, 3, 3))
    for i, j in np.ndindex(3, 3):
        pair = np.eye(3)[i] + np.eye(3)[j]
        other = np.eye(3)[i] - np.eye(3)[j]
        # polarised: only covariances, which are not negative, can be asked for
        plus = turned(np.outer(pair, pair), none)
        minus = turned(np.outer(other, other), none) if i != j else none
        rotation[:, :, i, j] = (plus - minus) / 4.0
    gain = across @ sensor.matrix
    return Carrier(
        jacobian=across @ np.stack(columns, axis=1),
        rotation=rotation,
        noise=turned(force_std**2 * gain @ gain.T, none),
        field=turned(none, (field_std / strength) ** 2 * np.eye(3)),
    )


def _rotation_covariance(
    q: Float[Array, "4"],
    field_world: Float[Array, "3"],
    b1: Float[Array, "3 3"],
    b2: Float[Array, "3 3"],
) -> Float[Array, "3 3"]:
    none = np.zeros((3, 3))
    noise = np.stack([b1, b2, none, none])
    moments = attitude_moments(q, UP, field_world, noise, normalized=True)
    # the small rotation is twice the vector part of conj(q) * qhat
    back = conjugate(moments.q_true)
    to_rotation = 2.0 * np.stack([compose(back, e)[:3] for e in np.eye(4)], axis=1)
    covariance: Array = to_rotation @ moments.covariance @ to_rotation.T
    return covariance


def corrected(
    theta: Inexact[Array, "9"], raw: Inexact[Array, "3"]
) -> Inexact[Array, "3"]:
    """Specific force M (y - B) in the triangular form, analytic in the parameters."""
    s_yx, s_zx, s_zy = theta[:3]
    x, y, z = theta[3:6] * (raw - theta[6:])
    return np.array([x, s_yx * x + y, -s_zx * x + s_zy * y + z])
