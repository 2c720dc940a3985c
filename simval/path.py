r"""A smooth path through poses, with velocities and accelerations at any time.

Position and quaternion are splines through the poses, of the seventh degree where there
are eight. The quaternion's spline S is no unit one; its direction is the attitude, and
with :math:`u = S/|S|`, a dash for the time's derivative and the product of Hamilton,

.. math:: \omega &= 2\,\mathrm{vec}(\bar u\, S'/|S|), \tag{W1}\\
   \alpha &= 2\,\mathrm{vec}(\bar u\, S''/|S|) - 2\,(u \cdot S'/|S|)\,\omega \tag{W2}

are the body's rate and its derivative, in body axes. An ideal accelerometer at the
place r of the body reads

.. math:: f = R^T(p'' - g) + \alpha \times r + \omega \times (\omega \times r),
   \tag{W3}

R from the body to the world, g the acceleration of gravity. Of a motion that turns by x
rad from one pose to the next the second derivative of a spline of degree k is off by
the order of :math:`(x/2\pi)^{k-1}`: what the degree changes bounds the error of the
higher one.
"""

from typing import Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array, physical_array, shaped_array
from simval.errors import InputError
from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    cross,
    unit_quaternions,
)
from simval.shapes import Float

DEGREE: Final = 7
LEAST: Final = 8  # poses


class Kinematics(NamedTuple):
    """Motion of a body at some instants.

    Attributes
    ----------
    position, velocity, acceleration : Array
        Of its origin, world axes, m, m/s, m/s^2, (n, 3).
    attitude : Array
        Matrices from body to world, (n, 3, 3).
    rate, angular_acceleration : Array
        Relative to the world, body axes, rad/s, rad/s^2, (n, 3).
    quaternion : Array
        World to body, vector first, (n, 4).
    """

    position: Float[Array, "n 3"]
    velocity: Float[Array, "n 3"]
    acceleration: Float[Array, "n 3"]
    attitude: Float[Array, "n 3 3"]
    rate: Float[Array, "n 3"]
    angular_acceleration: Float[Array, "n 3"]
    quaternion: Float[Array, "n 4"]

    def specific_force(
        self, lever: Float[Array, "3"], gravity: Float[Array, "3"]
    ) -> Float[Array, "n 3"]:
        """Specific force at a point of the body, eq. (W3).

        Parameters
        ----------
        lever : Array
            The place, body axes, m, (3,).
        gravity : Array
            Acceleration of gravity, world axes, m/s^2, (3,).

        Returns
        -------
        Array
            Body axes, m/s^2, (n, 3).
        """
        own = np.vecmat(self.acceleration - gravity, self.attitude)
        turning = cross(self.rate, cross(self.rate, lever))
        return own + cross(self.angular_acceleration, lever) + turning


class PosePath:
    """A smooth path through poses.

    Parameters
    ----------
    time : Array
        s, (n,), increasing.
    position : Array
        Of the body's origin, world axes, m, (n, 3).
    attitude : Array
        Unit quaternions world to body, vector first, (n, 4), either sign.
    degree : int, default 7
        Of the splines; less where there are fewer poses.

    Raises
    ------
    InputError
        If there are too few poses, or time does not increase.
    """

    def __init__(
        self,
        time: Float[Array, " n"],
        position: Float[Array, "n 3"],
        attitude: Float[Array, "n 4"],
        degree: int = DEGREE,
    ) -> None:
        time = shaped_array("time", time, (None,))
        position = physical_array("position", position, (len(time), 3))
        attitude = unit_quaternions("attitude", attitude)
        if len(time) < LEAST or not np.all(np.diff(time) > 0.0):
            msg = (
                f"{len(time)} poses, or not in order of time, are no path; give "
                f"{LEAST} or more, in order"
            )
            raise InputError(msg)
        self.start, self.stop = float(time[0]), float(time[-1])
        self.step = float(np.median(np.diff(time)))
        signs = np.sign(np.vecdot(attitude[1:], attitude[:-1]))
        turned = attitude * np.cumprod(np.append(1.0, signs))[:, None]
        self.poses = np.hstack([position, turned])
        # in steps from the start: powers of a step stay near 1
        self._spline = scipy.interpolate.make_interp_spline(
            (time - self.start) / self.step, self.poses, degree
        )

    def at(self, time: Float[Array, " n"]) -> Kinematics:
        """Position, attitude and their derivatives at some times.

        Parameters
        ----------
        time : Array
            s, (n,).

        Returns
        -------
        Kinematics
            By (W1) and (W2).
        """
        x = (time - self.start) / self.step
        zero, one, two = (self._spline(x, k) / self.step**k for k in range(3))
        size = np.linalg.norm(zero[:, 3:], axis=1, keepdims=True)
        u, by, by2 = (each[:, 3:] / size for each in (zero, one, two))
        back = conjugate(u)
        rate = 2.0 * compose(back, by)[:, :3]
        turning = 2.0 * compose(back, by2)[:, :3]
        turning -= 2.0 * np.vecdot(u, by)[:, None] * rate
        R = attitude_matrix(back)
        return Kinematics(zero[:, :3], one[:, :3], two[:, :3], R, rate, turning, u)
