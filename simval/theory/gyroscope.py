r"""Bound and bias of a calibration of two or three sensors, by rests and rotations.

Unknown are the sensors (the accelerometer's nine parameters, the gyroscope's M row by
row and B, the magnetometer's matrix, hard iron and the dip: 21 or 34) and the attitude
of every rest. What is left of the readings without the attitudes are the equations of
`simval.theory.estimating`: at each rest

.. math:: |u|^2 - 1, \quad |v|^2 - 1, \quad u^T v + \sin d, \qquad
   u = M_a (y_a - b_a)/g,\ v = M_m (y_m - b_m)/F,  \tag{Y1}

the last two with a magnetometer; of each move, C the turn by the gyroscope's readings,
as the product of its segments,

.. math:: E^T(C^T \hat u_k - \hat u_{k+1}), \qquad
   a^T(C^T \hat v_k - \hat v_{k+1}), \tag{Y2}

a hat for unit length, E two unit vectors across :math:`u_{k+1}`, a across both; and
:math:`B - \bar B` of what the rests say of the bias  (Y3). A rest's noise is in its own
equations and in those of the moves on either side. Nothing else is said of the sensors,
so (E3) of these equations is the Cramer-Rao bound, attitudes unknown.

White noise N of the gyroscope turns a move by an angle of the covariance

.. math:: N^2 \int C M M^T C^T dt,  \tag{Y4}

C(t) the turn so far; to first order nothing else of it counts, and the bound has it as
three noises a move. The bias, of second order, has noises of each segment. It leaves
out the fourth order, and that the weights are taken at the estimate, which halves the
bias of the accelerometer's scales and does nothing to the gyroscope that a thousand
trials at ten times the noise could show; so only the gyroscope's twelve are given.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy

from simval.arguments import choice, instance
from simval.arrays import (
    Array,
    ReadOnly,
    finite_array,
    frozen,
    noise_levels,
    nonnegative_number,
    positive_number,
)
from simval.errors import GeometryError, InputError
from simval.geometry import attitude_matrix, normalize
from simval.imu.sensor import (
    AccelerometerModel,
    GyroscopeModel,
    MagnetometerModel,
    forms,
)
from simval.moments import deviations
from simval.poses import one_set
from simval.shapes import Float, Inexact
from simval.theory.calibration import in_form
from simval.theory.estimating import Block, Estimating
from simval.theory.magnetometer import NAMES, dip_angle
from simval.vocabulary import Model

GYROSCOPE = (*(f"M_{a}{b}" for a in "xyz" for b in "xyz"), "B_x", "B_y", "B_z")
_NODES: Final = 4  # of Gauss and Legendre in a segment: exact to the eighth power of it
_TURN, _DRIFT = slice(9, 18), slice(18, 21)  # places of M and B
_IRON, _HARD, _DIP = slice(21, 30), slice(30, 33), 33


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovePath:
    """Rotations between rests, each made of turns about fixed axes.

    Attributes
    ----------
    turns : Array
        Rotation vector of each segment, body axes, rad, (k, j, 3).
    seconds : Array
        Time of each segment, s, (k, j); 0 where a move has fewer.
    """

    turns: Float[Array, "k j 3"]
    seconds: Float[Array, "k j"]

    def __post_init__(self) -> None:
        turns = finite_array("turns", self.turns, (None, None, 3))
        seconds = finite_array("seconds", self.seconds, (None, None))
        if turns.shape != (*seconds.shape, 3) or not np.all(seconds >= 0.0):
            msg = (
                f"`turns` has shape {turns.shape} and `seconds` {seconds.shape}; give "
                "(k, j, 3) and times of 0 or more, (k, j)"
            )
            raise InputError(msg)
        object.__setattr__(self, "turns", frozen(turns))
        object.__setattr__(self, "seconds", frozen(seconds))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopeMoments(ReadOnly):
    """Predicted error of a calibration of accelerometer and gyroscope.

    Attributes
    ----------
    names : tuple of str
        Names of the 21 parameters, the accelerometer's first.
    cramer_rao : Array
        Bound on their covariance, (21, 21).
    """

    names: tuple[str, ...]
    cramer_rao: Float[Array, "21 21"]

    @property
    def sd(self) -> Float[Array, "21"]:
        """Bound on each standard deviation, (21,)."""
        return deviations(self.cramer_rao)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NineAxisMoments(GyroscopeMoments):
    """Predicted error of a calibration of three sensors.

    Attributes
    ----------
    names : tuple of str
        Names of the 34 parameters: the accelerometer's, and the others', which begin
        with gyro and mag.
    cramer_rao : Array
        Bound on their covariance, (34, 34); the dip in rad.
    """


def gyroscope_moments(
    gyroscope: GyroscopeModel,
    accelerometer: AccelerometerModel,
    directions: Any,
    path: MovePath,
    *,
    pose_std: Any,
    bias_std: Any,
    g: float = 9.80665,
    angle_random_walk: float | None = None,
    form: Model = "triangular",
) -> GyroscopeMoments:
    """Bound the error of a calibration of two sensors from rests and rotations.

    Parameters
    ----------
    gyroscope : GyroscopeModel
        The true gyroscope.
    accelerometer : AccelerometerModel
        The true accelerometer.
    directions : array_like
        True directions of the specific force at the rests, sensor axes, (n, 3).
    path : MovePath
        The n - 1 moves between them.
    pose_std : float or array_like
        Noise of each axis of a pose mean, raw units, one number or (n,).
    bias_std : float or array_like
        Noise of what the rests say of the gyroscope's bias, raw units, one number or
        (3,).
    g : float, default 9.80665
        Gravity, m/s^2.
    angle_random_walk : float, optional
        White noise N, raw units per root hertz; the gyroscope's own if not given.
    form : {"triangular", "upper", "symmetric"}
        Form of the accelerometer's parameters.

    Returns
    -------
    GyroscopeMoments
        The bound.

    Raises
    ------
    InputError
        If an argument is not usable.
    GeometryError
        If the rests and moves do not tell all parameters.
    """
    instance("gyroscope", gyroscope, GyroscopeModel)
    body = instance("accelerometer", accelerometer, AccelerometerModel)
    form = choice("form", form, forms.MODELS)
    g = positive_number("g", g, "m/s^2")
    u = normalize(one_set("directions", directions))
    walk = _walk(gyroscope, angle_random_walk)
    sigma = noise_levels("pose_std", pose_std, len(u))
    rest = noise_levels("bias_std", bias_std, 3)
    _require_noise(path, len(u), walk, sigma, rest)
    theta = _parameters(form, body, gyroscope)
    found = equations(theta, form, (g,), u[:, None], path, [sigma], rest, walk)
    return GyroscopeMoments(
        names=(*forms.names(form), *GYROSCOPE), cramer_rao=_bound(found)
    )


def nine_axis_moments(
    gyroscope: GyroscopeModel,
    accelerometer: AccelerometerModel,
    magnetometer: MagnetometerModel,
    attitudes: Any,
    dip: float,
    path: MovePath,
    *,
    pose_std: Any,
    field_std: Any,
    bias_std: Any,
    g: float = 9.80665,
    field: float = 1.0,
    angle_random_walk: float | None = None,
    form: Model = "triangular",
) -> NineAxisMoments:
    """Bound the error of a calibration of three sensors from rests and rotations.

    Parameters
    ----------
    gyroscope : GyroscopeModel
        The true gyroscope, on the axes of the body, as all three.
    accelerometer : AccelerometerModel
        The true accelerometer.
    magnetometer : MagnetometerModel
        The true magnetometer.
    attitudes : array_like
        True attitudes of the rests, world to body, world axes north, west and up,
        (n, 4).
    dip : float
        Angle of the field below the horizon, rad.
    path : MovePath
        The n - 1 moves between the rests.
    pose_std, field_std : float or array_like
        Noise of each axis of a pose mean of the accelerometer and the magnetometer, raw
        units, one number or (n,).
    bias_std : float or array_like
        Noise of what the rests say of the gyroscope's bias, raw units, one number or
        (3,).
    g, field : float
        Gravity, m/s^2, and strength of the field in the unit of its M.
    angle_random_walk : float, optional
        White noise N, raw units per root hertz; the gyroscope's own if not given.
    form : {"triangular", "upper", "symmetric"}
        Form of the accelerometer's parameters, whose axes all matrices refer to.

    Returns
    -------
    NineAxisMoments
        The bound.

    Raises
    ------
    InputError
        If an argument is not usable.
    GeometryError
        If the rests and moves do not tell all parameters.
    """
    instance("gyroscope", gyroscope, GyroscopeModel)
    body = instance("accelerometer", accelerometer, AccelerometerModel)
    iron = instance("magnetometer", magnetometer, MagnetometerModel)
    form = choice("form", form, forms.MODELS)
    g, field = positive_number("g", g, "m/s^2"), positive_number("field", field, "")
    walk = _walk(gyroscope, angle_random_walk)
    q = finite_array("attitudes", attitudes, (None, 4))
    sigma = noise_levels("pose_std", pose_std, len(q))
    strength = noise_levels("field_std", field_std, len(q))
    rest, dip = noise_levels("bias_std", bias_std, 3), dip_angle(dip)
    _require_noise(path, len(q), walk, sigma, strength, rest)
    theta = np.zeros(34)
    theta[:9] = in_form(form, body)
    # all matrices, directions and turns on the axes of the form
    turned = forms.matrix(form, theta[:9]) @ np.linalg.inv(body.matrix)
    theta[_TURN], theta[_DRIFT] = (turned @ gyroscope.M).ravel(), gyroscope.B
    theta[_IRON], theta[_HARD] = (turned @ iron.M).ravel(), iron.b
    theta[_DIP] = dip
    A = turned @ attitude_matrix(q)
    along = A @ [np.cos(dip), 0.0, -np.sin(dip)]
    onto = MovePath(turns=path.turns @ turned.T, seconds=path.seconds)
    found = equations(
        theta, form, (g, field), np.stack([A[:, :, 2], along], axis=1), onto,
        [sigma, strength], rest, walk,
    )  # fmt: skip
    return NineAxisMoments(
        names=(
            *forms.names(form),
            *(f"gyro_{name}" for name in GYROSCOPE),
            *(f"mag_{name}" for name in NAMES),
        ),
        cramer_rao=_bound(found),
    )


def _parameters(
    form: str, body: AccelerometerModel, gyroscope: GyroscopeModel
) -> Float[Array, "21"]:
    return np.concatenate([in_form(form, body), gyroscope.M.ravel(), gyroscope.B])


def _walk(gyroscope: GyroscopeModel, given: float | None) -> float:
    if given is None:
        return gyroscope.angle_random_walk
    return nonnegative_number("angle_random_walk", given, "raw units")


def _require_noise(path: MovePath, count: int, walk: float, *levels: Array) -> None:
    least = min(float(each.min()) for each in levels)
    if len(path.turns) != count - 1 or not (walk > 0.0 and least > 0.0):
        msg = (
            f"`path` has {len(path.turns)} rotations for {count} rests, and the noise "
            f"is {walk:g} of the rotations and {least:g} at the least; give a rotation "
            "between any two rests, and noise above 0"
        )
        raise InputError(msg)


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
    form: Model = "triangular",
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
    theta = _parameters(form, accelerometer, gyroscope)
    found = equations(
        theta, form, (g,), u[:, None], path, [np.full(len(u), pose_std)],
        np.full(3, bias_std), walk, by_segment=True,
    )  # fmt: skip
    return found.bias[9:]


def equations(
    theta: Float[Array, " p"],
    form: str,
    strengths: tuple[float, ...],
    vectors: Float[Array, "n s 3"],
    path: MovePath,
    levels: list[Float[Array, " n"]],
    rest: Float[Array, "3"],
    walk: float,
    *,
    by_segment: bool = False,
) -> Estimating:
    """Rows (Y1) to (Y3) of sensors that read some vectors of the world at rest.

    Gravity, and the field where there are two: strengths, directions at each rest,
    noise. Each segment of a move has noise of its own, or a move that of eq. (Y4).
    """
    sensors, (k, j) = vectors.shape[1], path.seconds.shape

    def matrices(theta: Any) -> list[tuple[Any, Any]]:
        iron = theta[:, _IRON].reshape(len(theta), -1, 3)
        both = (
            (forms.matrix(form, theta[:, :9]), theta[:, 6:9]),
            (iron, theta[:, _HARD]),
        )
        return list(both[:sensors])

    def corrected(theta: Any, y: Any) -> Any:
        parts = zip(matrices(theta), strengths, np.split(y, sensors, -1), strict=True)
        return np.stack([(x - b[:, None]) @ M.mT / s for (M, b), s, x in parts], -2)

    def rests(theta: Any, y: Any) -> Any:
        w = corrected(theta, y)
        lengths = np.sum(w * w, axis=-1) - 1.0
        if sensors == 1:
            return lengths
        dot = np.sum(w[..., 0, :] * w[..., 1, :], axis=-1) + np.sin(
            theta[:, _DIP, None]
        )
        return np.concatenate([lengths, dot[..., None]], axis=-1)

    true_M, true_B = theta[_TURN].reshape(3, 3), theta[_DRIFT]
    raw = path.turns @ np.linalg.inv(true_M).T  # less tau B
    across, root = _across(vectors[1:]), _angle_root(true_M, path)

    def turned(theta: Any, y: Any) -> Any:
        start, end, noise = np.split(y, [3 * sensors, 6 * sensors], axis=-1)
        w, after = (_unit(corrected(theta, part)) for part in (start, end))
        M = theta[:, _TURN].reshape(-1, 1, 1, 3, 3)
        read = raw + path.seconds[..., None] * (true_B - theta[:, None, None, _DRIFT])
        if by_segment:
            read = read + noise.reshape(-1, k, j, 3)
        else:
            w = w - np.cross(np.matvec(root, noise)[:, :, None], w)
        turns = _exponential(np.matvec(M, read))
        for piece in range(j):
            w = w @ turns[:, :, piece]
        return np.einsum("krsi,tksi->tkr", across, w - after)

    readings = [
        s * np.linalg.solve(M[0], u.T).T + b[0]
        for s, (M, b), u in zip(
            strengths, matrices(theta[None]), np.swapaxes(vectors, 0, 1), strict=True
        )
    ]
    y = np.concatenate(readings, axis=1)
    sigma = np.repeat(np.stack(levels, axis=1), 3, axis=1)
    poses = np.arange(y.size).reshape(y.shape)
    own = walk * (np.sqrt(path.seconds) if by_segment else np.ones((k, 1)))
    own = np.repeat(own, 3, axis=1)
    moved = y.size + np.arange(own.size).reshape(own.shape)
    return Estimating(
        blocks=(
            Block(
                rows=turned,
                y=np.hstack([y[:-1], y[1:], np.zeros_like(own)]),
                sigma=np.hstack([sigma[:-1], sigma[1:], own]),
                noise=np.hstack([poses[:-1], poses[1:], moved]),
            ),
            Block(rows=rests, y=y, sigma=sigma, noise=poses),
            Block(
                rows=lambda theta, y: theta[:, None, _DRIFT] - y,
                y=true_B[None],
                sigma=rest[None],
                noise=y.size + own.size + np.arange(3)[None],
            ),
        ),
        theta=theta,
        weights="truth",
    )


def _bound(equations: Estimating) -> Float[Array, "p p"]:
    if equations.rank < len(equations.theta):
        msg = (
            "the rests and moves do not determine a combination of the "
            f"{len(equations.theta)} parameters (rank {equations.rank}), so "
            "nothing can be predicted; add poses, and moves about other axes"
        )
        raise GeometryError(msg)
    return equations.bound


def _angle_root(M: Float[Array, "3 3"], path: MovePath) -> Float[Array, "k 3 3"]:
    """Triangular root of the covariance (Y4) of each rotation, for N = 1."""
    rotation = scipy.spatial.transform.Rotation
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    covariance = np.zeros((len(path.turns), 3, 3))
    whole = rotation.identity(len(path.turns))
    for turned, tau in zip(
        np.swapaxes(path.turns, 0, 1), path.seconds.T[..., None, None], strict=True
    ):
        for node, weight in zip(0.5 + 0.5 * nodes, 0.5 * weights, strict=True):
            C = (whole * rotation.from_rotvec(node * turned)).as_matrix() @ M
            covariance += weight * tau * (C @ C.mT)
        whole = whole * rotation.from_rotvec(np.array(turned))
    return np.linalg.cholesky(covariance)


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


def _across(vectors: Float[Array, "k s 3"]) -> Float[Array, "k r s 3"]:
    """E and a of eq. (Y2) for each vector."""
    u = vectors[:, 0]
    # from the axis that it is farthest from
    first = normalize(np.cross(u, np.eye(3)[np.argmin(np.abs(u), axis=1)]))
    rows = np.zeros((len(u), 1 + vectors.shape[1], *vectors.shape[1:]))
    rows[:, 0, 0], rows[:, 1, 0] = first, np.cross(u, first)
    if vectors.shape[1] == 2:
        rows[:, 2, 1] = normalize(np.cross(u, vectors[:, 1]))
    return rows
