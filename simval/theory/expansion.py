r"""Gaussian moments of the scaled error x of the two-vector quaternion.

With :math:`z_1 = (\Delta d_1, \Delta s_1)` and :math:`z_2 = \Delta d_2`, independent
and Gaussian, eq. (39) of Peng and Choukroun divided by :math:`|\bar q^t|` is

.. math:: x = x_1 + x_2,\quad x_1 = J_1 z_1 + J_2 z_2,\quad
   (x_2)_a = z_1^T B_a z_2.  \tag{X1}

All that the expansions to fourth order need of x are

.. math:: P = E[x_1 x_1^T],\quad V = E[x_2 x_2^T],\quad
   G_{abc} = E[(x_2)_a (x_1)_b (x_1)_c];  \tag{X2}

the mean of x and every odd moment vanish.
"""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.geometry import cross_matrix
from simval.shapes import Float
from simval.theory.two_vector import TwoVectorGeometry

# eps[j, a, k] with (v x w)_a = sum eps[j, a, k] v_j w_k
_LEVI_CIVITA = np.stack([cross_matrix(row) for row in np.eye(3)])
# B but for |qbar|
_BILINEAR = np.zeros((4, 6, 3))
_BILINEAR[:3, :3] = -_LEVI_CIVITA.swapaxes(0, 1)
_BILINEAR[3, 3:] = -np.eye(3)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaledErrorMoments:
    """Second moments of x and its cross moment of fourth order, eq. (X2).

    Attributes
    ----------
    q : Array
        True quaternion in the frame of x.
    P : Array
        Covariance of the linear part.
    V : Array
        Covariance of the bilinear part.
    G : Array
        Mean of the bilinear part times the linear part twice.
    """

    q: Float[Array, "... 4"]
    P: Float[Array, "... 4 4"]
    V: Float[Array, "... 4 4"]
    G: Float[Array, "... 4 4 4"]


def linear_maps(
    geometry: TwoVectorGeometry,
) -> tuple[Float[Array, "... 4 6"], Float[Array, "... 4 3"]]:
    """Matrices J1 and J2 of eq. (X1), source eqs. (54) to (58)."""
    batch = geometry.q.shape[:-1]
    J1, J2 = np.zeros((*batch, 4, 6)), np.zeros((*batch, 4, 3))
    J1[..., :3, :3] = cross_matrix(geometry.d2)
    J1[..., 3, 3:] = -geometry.d2
    J2[..., :3, :] = -cross_matrix(geometry.d1)
    J2[..., 3, :] = -geometry.s1
    norm = geometry.norm[..., None, None]
    return J1 / norm, J2 / norm


def bilinear_map(geometry: TwoVectorGeometry) -> Float[Array, "... 4 6 3"]:
    """Tensor B of eq. (X1), the last terms of source eq. (39)."""
    return _BILINEAR / geometry.norm[..., None, None, None]


def half_noise(
    geometry: TwoVectorGeometry, noise: Float[Array, "... 4 3 3"]
) -> tuple[Float[Array, "... 6 6"], Float[Array, "... 3 3"]]:
    """Covariances of (dd1, ds1) and of dd2 in the turned frame."""
    turn = geometry.turn[..., :, None] * geometry.turn[..., None, :]
    b1, b2 = noise[..., 0, :, :], noise[..., 1, :, :]
    r1, r2 = turn * noise[..., 2, :, :], turn * noise[..., 3, :, :]
    own, cross = (b1 + r1) / 4.0, (b1 - r1) / 4.0
    return np.block([[own, cross], [cross, own]]), (b2 + r2) / 4.0


def mean_linear_error(
    geometry: TwoVectorGeometry, means: Float[Array, "... 4 3"]
) -> Float[Array, "... 4"]:
    """Mean of the linear part of x when the noise has a mean."""
    J1, J2 = linear_maps(geometry)
    b1, b2 = means[..., 0, :], means[..., 1, :]
    r1, r2 = geometry.turn * means[..., 2, :], geometry.turn * means[..., 3, :]
    first = np.concatenate([(b1 - r1) / 2, (b1 + r1) / 2], axis=-1)
    return np.matvec(J1, first) + np.matvec(J2, (b2 - r2) / 2)


def scaled_error_moments(
    geometry: TwoVectorGeometry, noise: Float[Array, "... 4 3 3"]
) -> ScaledErrorMoments:
    """Moments P, V and G of eq. (X2)."""
    J1, J2 = linear_maps(geometry)
    B = bilinear_map(geometry)
    C1, C2 = half_noise(geometry, noise)
    batch = geometry.q.shape[:-1]
    P = J1 @ C1 @ J1.swapaxes(-1, -2) + J2 @ C2 @ J2.swapaxes(-1, -2)
    spread = C1[..., None, :, :] @ B @ C2[..., None, :, :]  # (4, 6, 3)
    flat = (*batch, 4, 18)
    V = spread.reshape(flat) @ B.reshape(flat).swapaxes(-1, -2)
    half = J1[..., None, :, :] @ spread @ J2[..., None, :, :].swapaxes(-1, -2)
    return ScaledErrorMoments(q=geometry.q, P=P, V=V, G=half + half.swapaxes(-1, -2))
