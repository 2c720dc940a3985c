r"""Second-order bias of the joint calibration of both sensors: the implicit function.

The estimate solves :math:`\psi(\theta, z) = J^T W r = 0`, z the noises, all independent
and of unit variance, W the weights at the truth. Along noise m the estimate moves by
:math:`T_m = -H^{-1} J^T W\, \partial_m r`, :math:`H = J^T W J`, and to second order

.. math:: E\,\delta\theta = -H^{-1} \sum_m \big( \dot J_m^T W \dot r_m
   + \tfrac12 J^T W\, \ddot r_m \big), \tag{Y4}

the dots along the line :math:`s \mapsto (\theta + s T_m,\ s\,e_m)`. The rows are the
norms of the rests, :math:`|M_a(y_i - b_a)|^2/g^2 - 1`, the gaps
:math:`E_k^T(\hat C_k^T \hat u_k - \hat u_{k+1})`, and the bias; the turn is the product
of the segments, each with noise of its own. Noises of every other rest, and of
different moves, touch different rows, so that the second derivatives by 500 noises are
those by a few sums of them. Left out: the fourth order, and that the weights are taken
at the estimate, which halves the bias of the accelerometer's scales and does nothing to
the gyroscope that a thousand trials at ten times the noise could show; so only the
gyroscope's twelve are given.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.geometry import normalize
from simval.poses import one_set
from simval.sensor import AccelerometerModel, GyroscopeModel, forms
from simval.shapes import Float, Inexact
from simval.theory.gyroscope import PARAMETERS, MovePath

_STEP: Final = 1e-30  # of the complex step: exact to rounding
_WIDE: Final = 1e-4  # of the differences of first derivatives, relative
_Noise = tuple[
    Any, Any, Any
]  # of poses (n, 3), of segments (k, j, 3), of the bias (3,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
    form: str
    g: float
    readings: Array  # (n, 3), true
    raw: Array  # raw turn of each segment less tau B, (k, j, 3)
    seconds: Array  # (k, j)
    E: Array  # (k, 2, 3)
    bias: Array  # (3,)
    size: Array  # (21,), of each parameter


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
    """Predict the second-order bias of a joint calibration, eq. (Y4).

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
    """
    u = normalize(one_set("directions", directions))
    theta = forms.from_gram(form, accelerometer.matrix.T @ accelerometer.matrix,
                            accelerometer.B)  # fmt: skip
    M = forms.matrix(form, theta)
    p0 = np.concatenate([theta, gyroscope.M.ravel(), gyroscope.B])
    problem = _Problem(
        form=form,
        g=g,
        readings=np.linalg.solve(M, g * u.T).T + theta[6:],
        raw=path.turns @ np.linalg.inv(gyroscope.M).T,
        seconds=path.seconds,
        E=_across(u[1:]),
        bias=gyroscope.B,
        size=_sizes(p0),
    )
    noises = _Noises(problem, pose_std, bias_std, angle_random_walk)
    return _second_order(problem, p0, noises)[9:]


@dataclass(frozen=True, slots=True, eq=False)
class _Noises:
    problem: _Problem
    pose_std: float
    bias_std: float
    walk: float

    def colours(self) -> list[_Noise]:
        """Sums of noises that touch different rows: of poses, segments and the bias."""
        p = self.problem
        n, (k, j) = len(p.readings), p.seconds.shape
        none = np.zeros((n, 3)), np.zeros((k, j, 3)), np.zeros(3)
        made = []
        for parity in range(2):
            for axis in range(3):
                poses = none[0].copy()
                poses[parity::2, axis] = self.pose_std
                made.append((poses, none[1], none[2]))
        for piece in range(j):
            for axis in range(3):
                parts = none[1].copy()
                parts[:, piece, axis] = self.walk * np.sqrt(p.seconds[:, piece])
                made.append((none[0], parts, none[2]))
        for axis in range(3):
            bias = none[2].copy()
            bias[axis] = self.bias_std
            made.append((none[0], none[1], bias))
        return made

    def groups(self) -> list[tuple[int, Any]]:
        """For each single noise its colour, and the rows that it touches."""
        p = self.problem
        n, (k, j) = len(p.readings), p.seconds.shape
        made = []
        for i in range(n):
            rows = np.zeros(2 * k + n + 3, dtype=bool)
            rows[max(0, 2 * i - 2) : min(2 * k, 2 * i + 2)] = True
            rows[2 * k + i] = True
            made += [(3 * (i % 2) + axis, rows) for axis in range(3)]
        for gap in range(k):
            rows = np.zeros(2 * k + n + 3, dtype=bool)
            rows[2 * gap : 2 * gap + 2] = True
            made += [(6 + at, rows) for at in range(3 * j)]
        for axis in range(3):
            rows = np.zeros(2 * k + n + 3, dtype=bool)
            rows[2 * k + n + axis] = True
            made.append((6 + 3 * j + axis, rows))
        return made


def _rows(
    p: _Problem,
    theta: Inexact[Array, "b 21"],
    poses: Inexact[Array, "b n 3"],
    parts: Inexact[Array, "b k j 3"],
    bias: Inexact[Array, "b 3"],
) -> Inexact[Array, "b r"]:
    # analytic in everything: no norm, no abs, no conjugate
    Ma = forms.matrix(p.form, theta[:, :9])
    h = (p.readings + poses - theta[:, None, 6:9]) @ np.swapaxes(Ma, -1, -2)
    square = (h * h).sum(axis=-1)
    u = h / np.sqrt(square)[..., None]
    M = theta[:, 9:18].reshape(-1, 3, 3)
    rates = p.raw + p.seconds[..., None] * (p.bias - theta[:, None, None, 18:]) + parts
    phi = np.einsum("bij,bklj->bkli", M, rates)
    C = np.broadcast_to(np.eye(3), (*phi.shape[:2], 3, 3))
    for piece in range(phi.shape[2]):
        C = C @ _exponential(phi[:, :, piece])
    arrived = np.einsum("bkji,bkj->bki", C, u[:, :-1])
    e = np.einsum("kai,bki->bka", p.E, arrived - u[:, 1:])
    return np.concatenate(
        [
            e.reshape(len(theta), -1),
            square / p.g**2 - 1.0,
            theta[:, 18:] - p.bias - bias,
        ],
        axis=1,
    )


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


def _jacobian(
    p: _Problem, theta: Float[Array, "21"], noise: _Noise
) -> Float[Array, "r 21"]:
    steps = theta + 1j * _STEP * np.diag(p.size)
    every = [np.broadcast_to(part, (PARAMETERS, *part.shape)) for part in noise]
    return (_rows(p, steps, *every).imag / _STEP).T


def _second_order(
    p: _Problem, theta: Float[Array, "21"], noises: _Noises
) -> Float[Array, "21"]:
    none = (np.zeros(p.readings.shape), np.zeros(p.raw.shape), np.zeros(3))
    J = _jacobian(p, theta, none)  # by parameters in units of their size
    colours, groups = noises.colours(), noises.groups()
    slope = _by_noise(p, theta, colours)  # colour r
    Z = np.array([np.where(rows, slope[c], 0.0) for c, rows in groups])  # m r
    V = Z.T @ Z
    WJ = np.linalg.solve(V, J)
    H = J.T @ WJ
    T = -np.linalg.solve(H, WJ.T @ Z.T).T  # m 21
    bend = np.array(
        [_difference(p, theta, none, d * p.size * _WIDE, none) for d in np.eye(21)]
    )  # a r b: derivative of J by parameter a
    mixed = np.array([_difference(p, theta, none, 0.0 * theta, c) for c in colours])
    own = _curvature(p, theta, colours)
    total = np.zeros(PARAMETERS)
    for (colour, rows), z, t in zip(groups, Z, T, strict=True):
        touched = rows[:, None] * mixed[colour]  # r 21
        Jdot = np.einsum("a,arb->rb", t, bend) + touched
        rdot = J @ t + z
        curve = Jdot @ t + touched @ t + np.where(rows, own[colour], 0.0)
        total += Jdot.T @ np.linalg.solve(V, rdot) + 0.5 * (WJ.T @ curve)
    return -np.linalg.solve(H, total) * p.size


def _difference(
    p: _Problem, theta: Array, none: Any, step: Array, noise: Any
) -> Float[Array, "r 21"]:
    # derivative of J along a step of the parameters, or along a noise of unit size
    along = bool(np.any(step))
    scale = _WIDE if along else 1.0
    ends = [
        _jacobian(
            p, theta + sign * step,
            none if along else tuple(sign * part for part in noise),
        )
        for sign in (1.0, -1.0)
    ]  # fmt: skip
    return (ends[0] - ends[1]) / (2.0 * scale)


def _by_noise(p: _Problem, theta: Array, colours: Any) -> Float[Array, "c r"]:
    parts: list[Any] = [np.array(each) for each in zip(*colours, strict=True)]
    every = np.broadcast_to(theta, (len(colours), PARAMETERS))
    return _rows(p, every, *(1j * _STEP * part for part in parts)).imag / _STEP


def _curvature(p: _Problem, theta: Array, colours: Any) -> Float[Array, "c r"]:
    # second derivative of the rows along each noise, by differences of the first
    parts: list[Any] = [np.array(each) for each in zip(*colours, strict=True)]
    every = np.broadcast_to(theta, (len(colours), PARAMETERS))
    ends = [
        _rows(p, every, *(sign * part + 1j * _STEP * part for part in parts)).imag
        for sign in (1.0, -1.0)
    ]
    return (ends[0] - ends[1]) / (2.0 * _STEP)


def _across(u: Float[Array, "k 3"]) -> Float[Array, "k 2 3"]:
    # two unit vectors across each direction, from the axis that it is farthest from
    other = np.eye(3)[np.argmin(np.abs(u), axis=1)]
    first = normalize(np.cross(u, other))
    return np.stack([first, np.cross(u, first)], axis=1)


def _sizes(theta: Float[Array, "21"]) -> Float[Array, "21"]:
    size = np.ones(PARAMETERS)
    size[3:6] = np.abs(theta[3:6]).mean()
    size[:3] = 1.0
    size[6:9] = 9.81 / size[3:6]
    size[9:18] = np.linalg.norm(theta[9:18]) / 3.0
    size[18:] = 1.0 / size[9]
    return size
