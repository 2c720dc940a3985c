r"""Second-order bias of the joint calibration of accelerometer and gyroscope.

The rows of `simval.theory.estimating` are the norms of the rests, the inter-rest
residuals, and what the rests say of the gyroscope's bias,

.. math:: |M_a(y_i - b_a)|^2/g^2 - 1, \qquad
   E_k^T(\hat C_k^T \hat u_k - \hat u_{k+1}), \qquad B - \bar B, \tag{Y4}

:math:`\hat u = M_a(y - b_a)` of unit length, :math:`E_k` two unit vectors across it,
:math:`\hat C_k` the product of the segments, each with noise of its own; a rest's noise
is in its norm and in the residuals on both sides. Left out are the fourth order, and
that the weights are taken at the estimate, which halves the bias of the accelerometer's
scales and does nothing to the gyroscope that a thousand trials at ten times the noise
could show; so only the gyroscope's twelve are given.
"""

from typing import Any

import numpy as np

from simval.arguments import choice
from simval.arrays import Array, nonnegative_number, positive_number
from simval.errors import InputError
from simval.geometry import normalize
from simval.imu.sensor import AccelerometerModel, GyroscopeModel, forms
from simval.poses import one_set
from simval.shapes import Float, Inexact
from simval.theory.estimating import Block, Estimating
from simval.theory.gyroscope import MovePath


def gyroscope_bias(
    gyroscope: GyroscopeModel,
    accelerometer: AccelerometerModel,
    directions: Any,
    path: MovePath,
    *,
    pose_std: float,
    bias_std: float,
    angle_random_walk: float,
    g: float = 9.80665,
    form: str = "triangular",
) -> Float[Array, "12"]:
    """Predict the second-order bias of a joint calibration.

    Parameters
    ----------
    gyroscope : GyroscopeModel
        The true gyroscope.
    accelerometer : AccelerometerModel
        The true accelerometer.
    directions : array_like
        True directions of the specific force at the rests, sensor axes, (n, 3).
    path : MovePath
        The moves between them; segments of a tenth of a radian are short enough.
    pose_std : float
        Noise of each axis of a pose mean, raw units.
    bias_std : float
        Noise of what the rests say of the gyroscope's bias, raw units.
    angle_random_walk : float
        White noise N, raw units per root hertz.
    g : float, default 9.80665
        Gravity, m/s^2.
    form : {"triangular", "upper", "symmetric"}
        Form of the accelerometer's parameters.

    Returns
    -------
    Array
        Bias of M row by row and of B, (12,).

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    u = normalize(one_set("directions", directions))
    if len(u) != len(path.seconds) + 1:
        msg = (
            f"{len(u)} rests and {len(path.seconds)} moves; give the moves between them"
        )
        raise InputError(msg)
    pose_std = positive_number("pose_std", pose_std, "raw units")
    bias_std = positive_number("bias_std", bias_std, "raw units")
    walk = nonnegative_number("angle_random_walk", angle_random_walk, "raw units")
    g, form = positive_number("g", g, "m/s^2"), choice("form", form, forms.MODELS)
    theta = forms.from_gram(
        form, accelerometer.matrix.T @ accelerometer.matrix, accelerometer.B
    )
    readings = np.linalg.solve(forms.matrix(form, theta), g * u.T).T + theta[6:]
    raw = path.turns @ np.linalg.inv(gyroscope.M).T  # less tau B
    (k, j), n, B = path.seconds.shape, len(u), gyroscope.B
    across = _across(u[1:])

    def heights(parameters: Any, y: Any) -> Any:
        M = forms.matrix(form, parameters[:, :9])
        return (y - parameters[:, None, 6:9]) @ np.swapaxes(M, -1, -2)

    def norms(parameters: Any, y: Any) -> Any:
        return np.sum(heights(parameters, y) ** 2, axis=-1, keepdims=True) / g**2 - 1.0

    def turned(parameters: Any, y: Any) -> Any:
        start, end = (_unit(heights(parameters, y[..., at : at + 3])) for at in (0, 3))
        M = parameters[:, 9:18].reshape(-1, 3, 3)
        off = path.seconds[..., None] * (B - parameters[:, None, None, 18:])
        phi = np.einsum(
            "bij,bklj->bkli", M, raw + off + y[..., 6:].reshape(-1, k, j, 3)
        )
        for piece in range(j):
            start = np.einsum("bkji,bkj->bki", _exponential(phi[:, :, piece]), start)
        return np.einsum("kai,bki->bka", across, start - end)

    poses = np.arange(3 * n).reshape(n, 3)
    segments = 3 * n + np.arange(3 * k * j).reshape(k, 3 * j)
    noise = np.repeat(walk * np.sqrt(path.seconds), 3, axis=1)
    equations = Estimating(
        blocks=(
            Block(
                rows=turned,
                y=np.hstack([readings[:-1], readings[1:], np.zeros_like(noise)]),
                sigma=np.hstack([np.full((k, 6), pose_std), noise]),
                noise=np.hstack([poses[:-1], poses[1:], segments]),
            ),
            Block(rows=norms, y=readings, sigma=np.full((n, 3), pose_std), noise=poses),
            Block(
                rows=lambda parameters, y: parameters[:, None, 18:] - y,
                y=B[None],
                sigma=np.full((1, 3), bias_std),
                noise=segments.max() + 1 + np.arange(3)[None],
            ),
        ),
        theta=np.concatenate([theta, gyroscope.M.ravel(), B]),
        weights="truth",
    )
    return equations.bias[9:]


def _unit(v: Any) -> Any:
    # analytic, as all that theory differentiates
    return v / np.sqrt(np.sum(v * v, axis=-1, keepdims=True))


def _exponential(v: Inexact[Array, "... 3"]) -> Inexact[Array, "... 3 3"]:
    # Rodrigues, of a complex vector too; segments turn
    square = (v * v).sum(axis=-1) + 1e-40
    angle = np.sqrt(square)
    a = (np.sin(angle) / angle)[..., None, None]
    b = (2.0 * np.sin(0.5 * angle) ** 2 / square)[..., None, None]
    x, y, z = np.moveaxis(v, -1, 0)
    o = np.zeros_like(x)
    K = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*v.shape, 3)
    return np.eye(3) + a * K + b * (K @ K)


def _across(u: Float[Array, "k 3"]) -> Float[Array, "k 2 3"]:
    # two unit vectors across each direction, from the axis that it is farthest from
    other = np.eye(3)[np.argmin(np.abs(u), axis=1)]
    first = normalize(np.cross(u, other))
    return np.stack([first, np.cross(u, first)], axis=1)
