r"""The calibration's residual and Jacobian as the IMU-TK derivation writes them.

.. math:: e = g^2 - h^T h,\quad h = T K (a - B),\quad
   J = -2 h^T [\partial h/\partial S,\ T\,\mathrm{diag}(a - B),\ -TK].  \tag{R1}

This is what a user of SciPy would minimise: the race's opponent, and an independent
second form that the tests hold the solver to. Misprints put right: ``docs/errata.md``.
"""

import numpy as np

from simval.arrays import Array
from simval.shapes import Float, Inexact


def imu_tk_residual(
    parameters: Inexact[Array, "9"], reading: Float[Array, "n 3"], g: float
) -> Inexact[Array, " n"]:
    """Residual of the IMU-TK derivation."""
    h, _, _ = _imu_tk(parameters, reading)
    return g**2 - (h * h).sum(axis=-1)


def imu_tk_jacobian(
    parameters: Float[Array, "9"], reading: Float[Array, "n 3"]
) -> Float[Array, "n 9"]:
    """Jacobian of the IMU-TK derivation in matrix form, eq. (R1)."""
    h, T, K = _imu_tk(parameters, reading)
    offset = reading - parameters[6:]
    scaled = offset * K
    by_shape = np.zeros((len(reading), 3, 3), h.dtype)
    by_shape[:, 1, 0] = scaled[:, 0]
    by_shape[:, 2, 1] = -scaled[:, 0]
    by_shape[:, 2, 2] = scaled[:, 1]
    by_scale = T * offset[:, None, :]
    by_bias = np.broadcast_to(-T * K, by_scale.shape)
    inner = np.concatenate([by_shape, by_scale, by_bias], axis=-1)
    return np.asarray(-2.0 * np.einsum("nr,nrj->nj", h, inner))


def _imu_tk(
    parameters: Inexact[Array, "9"], reading: Float[Array, "n 3"]
) -> tuple[Inexact[Array, "n 3"], Inexact[Array, "3 3"], Inexact[Array, "3"]]:
    """Undistorted readings, and the matrices of the derivation."""
    s_yx, s_zx, s_zy = parameters[:3]
    T = np.array([[1.0, 0.0, 0.0], [s_yx, 1.0, 0.0], [-s_zx, s_zy, 1.0]])
    K = parameters[3:6]
    return ((reading - parameters[6:]) * K) @ T.T, T, K
