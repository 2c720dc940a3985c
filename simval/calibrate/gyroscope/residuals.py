r"""Inter-rest residuals of gravity, and their derivatives.

**Directions of gravity at the rests, and how they depend on readings and parameters.**

With :math:`h_i = M_a (\bar y_i - b_a)`, :math:`u_i = h_i/|h_i|` and
:math:`c_i = |h_i|^2/g^2 - 1`, all derivatives are those of h and of the norm:
:math:`\mathrm{d}u = (I - uu^T)\,\mathrm{d}h/|h|`, :math:`\mathrm{d}c = 2h^T
\mathrm{d}h/g^2`. The accelerometer's fit solves :math:`\sum_i a_i c_i d_i = 0`,
:math:`d = \partial c/\partial\theta_a`, so the noise n_i of a pose mean moves it by

.. math:: \mathrm{d}\theta_a = \sum_i \Gamma_i n_i,\qquad
   \Gamma_i = -\Big(\sum_k a_k d_k d_k^T\Big)^{-1} a_i\, d_i\,
   \partial c_i/\partial y_i,

with the weights a of eq. (U1) of `evidence`.

**The rows of the fit: gaps, norms and the bias, with their noise.**

Gap k turns the direction :math:`u_k` into :math:`u_{k+1}`; along it nothing is seen,
so with :math:`E_k` two unit vectors across :math:`u_{k+1}`

.. math:: e_k = E_k^T (C_k^T u_k - u_{k+1}) \tag{N5}

and, :math:`\epsilon_k` the angle random walk of the move,

.. math:: \mathrm{d}e_k = E_k^T C_k^T [u_k\times](\theta_k + \epsilon_k)
   + E_k^T (C_k^T \mathrm{d}u_k - \mathrm{d}u_{k+1}),\quad
   \mathrm{cov}\,\epsilon_k = N^2 \sum_j \tau_j (D_j M)(D_j M)^T. \tag{N6}

Neighbouring gaps share a direction. Where the accelerometer has been calibrated before,
its error is a sum over the same poses (`gravity.influence`), common to all gaps; where
it is fitted together with the gyroscope, the norms :math:`c_i` are rows as well, and
the poses are noise of both. The rows' covariance is :math:`V = LL^T` plus the walk's
blocks, L the map from unit noises to rows.
"""

from dataclasses import dataclass, replace

import numpy as np

from simval.arrays import Array
from simval.calibrate.gyroscope.turn import Turn
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Linearised rows of the gaps at some parameters."""

    e: Float[Array, "t r"]
    by_turn: Float[Array, "t k a 3"]  # of each gap, by theta
    by_gyroscope: Float[Array, "t r 12"]
    by_accelerometer: Float[Array, "t r q"]
    by_pose: Float[Array, "t r m"]  # unit noise of each pose and axis, direct
    E: Float[Array, "t k a 3"]


def gap_values(
    C: Float[Array, "t k 3 3"],
    u: Float[Array, "t n 3"],
    E: Float[Array, "t k 2 3"],
) -> Float[Array, "t r"]:
    """Rows of the gaps, eq. (N5)."""
    arrived = (u[:, :-1, None, :] @ C)[..., 0, :]  # C'u
    e = (E @ (arrived - u[:, 1:])[..., None])[..., 0]
    return e.reshape(len(u), -1)


def gap_rows(found: Gravity, moved: Turn, pose_std: Float[Array, "n 3"]) -> Rows:
    """Rows of the gaps and their derivatives, eq. (N6)."""
    u = found.u
    t, n = u.shape[:2]
    k = n - 1
    E = across(u[:, 1:])
    EC = E @ np.swapaxes(moved.C, -1, -2)  # by u_k
    by_turn = np.cross(EC, u[:, :-1, None, :])  # E C'[u x], row by row
    by_a = EC @ found.u_by_theta[:, :-1] - E @ found.u_by_theta[:, 1:]
    noise = found.u_by_reading * pose_std[:, None, :]
    by_pose = np.zeros((t, k, 2, n, 3))
    gap = np.arange(k)
    by_pose[:, gap, :, gap] = np.moveaxis(EC @ noise[:, :-1], 1, 0)
    by_pose[:, gap, :, gap + 1] = -np.moveaxis(E @ noise[:, 1:], 1, 0)
    return Rows(
        e=gap_values(moved.C, u, E),
        by_turn=by_turn,
        by_gyroscope=(by_turn @ moved.slopes).reshape(t, 2 * k, 12),
        by_accelerometer=by_a.reshape(t, 2 * k, 9),
        by_pose=by_pose.reshape(t, 2 * k, 3 * n),
        E=E,
    )


def walk_blocks(
    rows: Rows, theta_covariance: Float[Array, "t k 3 3"]
) -> Float[Array, "t k a a"]:
    """Covariance that the angle's own noise leaves in each gap."""
    back = np.swapaxes(rows.by_turn, -1, -2)
    return rows.by_turn @ theta_covariance @ back


def covariance_of(
    L: Float[Array, "t r m"], blocks: Float[Array, "t k a a"]
) -> Float[Array, "t r r"]:
    """Covariance V of rows of which the first are those of the gaps."""
    V = L @ np.swapaxes(L, -1, -2)
    k, size = blocks.shape[1:3]
    first = size * np.arange(k)
    for i in range(size):
        for j in range(size):
            V[:, first + i, first + j] += blocks[:, :, i, j]
    return V


def carried(rows: Rows, influence: Float[Array, "t 9 m"]) -> Rows:
    """Rows with the way of the pose noise through the accelerometer's calibration."""
    return replace(rows, by_pose=rows.by_pose + rows.by_accelerometer @ influence)
