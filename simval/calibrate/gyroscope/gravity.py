r"""Directions of gravity at the rests, and how they depend on readings and parameters.

With :math:`h_i = M_a (\bar y_i - b_a)`, :math:`u_i = h_i/|h_i|` and
:math:`c_i = |h_i|^2/g^2 - 1`, all derivatives are those of h and of the norm:
:math:`\mathrm{d}u = (I - uu^T)\,\mathrm{d}h/|h|`, :math:`\mathrm{d}c = 2h^T
\mathrm{d}h/g^2`. The accelerometer's fit solves :math:`\sum_i a_i c_i d_i = 0`,
:math:`d = \partial c/\partial\theta_a`, so the noise n_i of a pose mean moves it by

.. math:: \mathrm{d}\theta_a = \sum_i \Gamma_i n_i,\qquad
   \Gamma_i = -\Big(\sum_k a_k d_k d_k^T\Big)^{-1} a_i\, d_i\,
   \partial c_i/\partial y_i,

with the weights a of eq. (U1) of `uncertainty`.
"""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.calibrate.residuals import WEIGHTED, noise_shares
from simval.sensor import forms
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gravity:
    """Directions and norms of the rests, with derivatives."""

    u: Float[Array, "t n 3"]
    c: Float[Array, "t n"]
    u_by_reading: Float[Array, "t n 3 3"]
    c_by_reading: Float[Array, "t n 3"]
    u_by_theta: Float[Array, "t n 3 9"]
    c_by_theta: Float[Array, "t n 9"]


def gravity(
    model: str, theta: Float[Array, "t 9"], poses: Float[Array, "t n 3"], g: float
) -> Gravity:
    """Directions, norms and derivatives for some parameters of the accelerometer."""
    M = forms.matrix(model, theta)
    offset = poses - theta[:, None, 6:]
    h = offset @ np.swapaxes(M, -1, -2)
    dM = forms.matrix_derivatives(model, theta)
    t, n = h.shape[:2]
    dh = np.empty((t, n, 3, 9))
    dh[..., :6] = np.einsum("tpij,tnj->tnip", dM, offset)
    dh[..., 6:] = -M[:, None]
    length = np.sqrt((h * h).sum(axis=-1))[..., None]
    u = h / length
    across = (np.eye(3) - u[..., :, None] * u[..., None, :]) / length[..., None]
    twice = 2.0 / g**2 * h[..., None, :]
    return Gravity(
        u=u,
        c=(h * h).sum(axis=-1) / g**2 - 1.0,
        u_by_reading=across @ M[:, None],
        c_by_reading=(twice @ M[:, None])[..., 0, :],
        u_by_theta=across @ dh,
        c_by_theta=(twice @ dh)[..., 0, :],
    )


def directions(
    model: str, theta: Float[Array, "t 9"], poses: Float[Array, "t n 3"], g: float
) -> tuple[Float[Array, "t n 3"], Float[Array, "t n"]]:
    """Directions and norms alone."""
    M = forms.matrix(model, theta)
    h = (poses - theta[:, None, 6:]) @ np.swapaxes(M, -1, -2)
    square = (h * h).sum(axis=-1)
    return h / np.sqrt(square)[..., None], square / g**2 - 1.0


def influence(
    found: Gravity, residual: str, pose_std: Float[Array, "n 3"]
) -> Float[Array, "t 9 m"]:
    """Error of the accelerometer's parameters by unit noise of each pose and axis."""
    root = np.ones(found.c.shape)
    if residual in WEIGHTED:
        shares = noise_shares(residual, np.sqrt((pose_std**2).mean(axis=1)))
        weight = 1.0 if shares is None else shares
        root = np.sqrt(weight / (found.c_by_reading**2).sum(axis=-1))
    rows = found.c_by_theta * root[..., None]
    size = np.sqrt((rows * rows).sum(axis=1, keepdims=True))
    Q, R = np.linalg.qr(rows / size)
    pull = (Q * root[..., None])[..., None, :] * found.c_by_reading[..., :, None]
    noise = pull * pose_std[..., None]  # t n 3 9
    flat = np.swapaxes(noise.reshape(len(root), -1, 9), -1, -2)
    return -np.linalg.solve(R, flat) / np.swapaxes(size, -1, -2)


def across(u: Float[Array, "t k 3"]) -> Float[Array, "t k 2 3"]:
    """Two unit vectors across each direction, as rows (Duff and others, 2017)."""
    x, y, z = np.moveaxis(u, -1, 0)
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = np.stack([b, sign + y * y * a, -y], axis=-1)
    return np.stack([first, second], axis=-2)
