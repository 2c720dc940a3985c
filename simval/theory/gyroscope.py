r"""Cramer-Rao bound of two or three sensors, calibrated by rests and moves.

Unknown are the sensors (the accelerometer's nine parameters, the gyroscope's M row by
row and B, the magnetometer's matrix, hard iron and the dip: 21 or 34) and the attitude
of every rest. With small rotations :math:`\delta_i` of the body at rest i, gravity's
direction is :math:`u_i + u_i \times \delta_i` and the turn from one rest to the next
:math:`\exp([-\delta_k + C_k \delta_{k+1}])\, C_k`. Measured are

.. math:: y_i = g M_a^{-1} (u_i + u_i \times \delta_i) + b_a + n_i, \qquad
   -\delta_k + C_k \delta_{k+1} = G_k\,\mathrm{d}p + \epsilon_k,
   \qquad \bar B = B + n_B, \tag{Y1}

the turn by a gyroscope with wrong parameters, and what the rests say of the bias. With
C(t) the turn so far and :math:`\omega` the rate,

.. math:: G\,\mathrm{d}p = \int C\,(\mathrm{d}M\,M^{-1}\omega - M\,\mathrm{d}B)\,dt,
   \qquad \mathrm{cov}\,\epsilon = N^2 \int C M M^T C^T dt. \tag{Y2}

A magnetometer reads the field :math:`f_i = A_i [\cos d, 0, -\sin d]^T` at each rest,

.. math:: y_{m,i} = F M_m^{-1}(f_i + f_i \times \delta_i) + b_m + n. \tag{Y3}

The bound is the inverse of the Schur complement of the attitudes, headings too. Two
sensors do not see a common turn about the vertical, which touches nothing and is held;
with a magnetometer the azimuth counts from the field, that turns with it.
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
from simval.geometry import attitude_matrix, cross_matrix, normalize
from simval.imu.sensor import (
    AccelerometerModel,
    GyroscopeModel,
    MagnetometerModel,
    forms,
)
from simval.poses import one_set
from simval.shapes import Float
from simval.theory.magnetometer import NAMES, dip_angle

PARAMETERS: Final = 21
NINE_AXES: Final = 34
GYROSCOPE = (*(f"M_{a}{b}" for a in "xyz" for b in "xyz"), "B_x", "B_y", "B_z")

_NODES: Final = 4  # of Gauss and Legendre in a segment: exact to the eighth power of it
_SINGULAR: Final = 1e-12  # least over greatest eigenvalue of the scaled information


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovePath:
    """Moves between rests, each in segments of a fixed axis.

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
    """Predicted error of a calibration of both sensors.

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
        return np.sqrt(np.diagonal(self.cramer_rao))


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
    form: str = "triangular",
) -> GyroscopeMoments:
    """Bound the error of a calibration from the sensors, the rests and the moves.

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
    theta = forms.from_gram(form, body.matrix.T @ body.matrix, body.B)
    M, slopes = forms.matrix(form, theta), forms.matrix_derivatives(form, theta)
    rows = _pose_rows(M, slopes, g, u) / sigma[:, None, None]
    moves = move_rows(gyroscope.M, path, walk)
    total = _information(PARAMETERS, [(rows, range(9))], *moves, rest)
    vertical = np.zeros(len(total))
    vertical[PARAMETERS : PARAMETERS + 3] = u[0]
    total += np.outer(vertical, vertical) * total[PARAMETERS:, PARAMETERS:].max()
    return GyroscopeMoments(
        names=(*forms.names(form), *GYROSCOPE),
        cramer_rao=bound_of(total, PARAMETERS),
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
    form: str = "triangular",
) -> NineAxisMoments:
    """Bound the error of a calibration from the sensors, the rests and the moves.

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
    theta = forms.from_gram(form, body.matrix.T @ body.matrix, body.B)
    # all matrices, directions and turns on the axes of the form
    M, slopes = forms.matrix(form, theta), forms.matrix_derivatives(form, theta)
    turned = M @ np.linalg.inv(body.matrix)
    A, dip = turned @ attitude_matrix(q), dip_angle(dip)
    sigma = noise_levels("pose_std", pose_std, len(q))
    strength = noise_levels("field_std", field_std, len(q))
    rest = noise_levels("bias_std", bias_std, 3)
    _require_noise(path, len(q), walk, sigma, strength, rest)
    force = _pose_rows(M, slopes, g, A[:, :, 2]) / sigma[:, None, None]
    M, cosine, sine = turned @ iron.M, np.cos(dip), np.sin(dip)
    along, lean = A @ [cosine, 0.0, -sine], A @ [-sine, 0.0, -cosine]
    compass = _pose_rows(M, np.eye(9).reshape(9, 3, 3), field, along)
    by_dip = field * np.linalg.solve(M, lean.T).T[:, :, None]
    compass = np.concatenate([compass[..., :12], by_dip, compass[..., 12:]], axis=2)
    compass /= strength[:, None, None]
    onto = MovePath(turns=path.turns @ turned.T, seconds=path.seconds)
    moves = move_rows(turned @ gyroscope.M, onto, walk)
    sensors = [(force, range(9)), (compass, range(21, NINE_AXES))]
    total = _information(NINE_AXES, sensors, *moves, rest)
    return NineAxisMoments(
        names=(
            *forms.names(form),
            *(f"gyro_{name}" for name in GYROSCOPE),
            *(f"mag_{name}" for name in NAMES),
        ),
        cramer_rao=bound_of(total, NINE_AXES),
    )


def _walk(gyroscope: GyroscopeModel, given: float | None) -> float:
    if given is None:
        return gyroscope.angle_random_walk
    return nonnegative_number("angle_random_walk", given, "raw units")


def _require_noise(path: MovePath, count: int, walk: float, *levels: Array) -> None:
    least = min(float(each.min()) for each in levels)
    if len(path.turns) != count - 1 or not (walk > 0.0 and least > 0.0):
        msg = (
            f"`path` has {len(path.turns)} moves for {count} rests, and the noise is "
            f"{walk:g} of the moves and {least:g} at the least; there must be a move "
            "between any two rests, and noise above 0"
        )
        raise InputError(msg)


def _pose_rows(
    M: Float[Array, "3 3"],
    slopes: Float[Array, "p 3 3"],
    strength: float,
    along: Float[Array, "n 3"],
) -> Float[Array, "n 3 c"]:
    """Derivatives of a sensor's readings of a vector that is fixed in the world.

    By the parameters of its matrix, of `slopes`, by its bias and by delta_i.
    """
    count, inverse = len(slopes), np.linalg.inv(M)
    x = np.linalg.solve(M, strength * along.T).T
    rows = np.zeros((len(along), 3, count + 6))
    rows[:, :, :count] = -np.einsum("ab,pbc,nc->nap", inverse, slopes, x)
    rows[:, :, count : count + 3] = np.eye(3)
    rows[:, :, count + 3 :] = strength * inverse @ cross_matrix(along)
    return rows


def move_rows(
    M: Float[Array, "3 3"], path: MovePath, walk: float
) -> tuple[Float[Array, "k 3 15"], Float[Array, "k 3 3"]]:
    """White rows of each move, eq. (Y2): by dp, and by its angle; and its turn."""
    rotation = scipy.spatial.transform.Rotation
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    inverse = np.linalg.inv(M)
    count = len(path.turns)
    whole = rotation.from_rotvec(np.zeros((count, 3)))
    G, cov = np.zeros((count, 3, 12)), np.zeros((count, 3, 3))
    for j in range(path.turns.shape[1]):
        turned, tau = np.array(path.turns[:, j]), path.seconds[:, j, None, None]
        for node, weight in zip(0.5 + 0.5 * nodes, 0.5 * weights, strict=True):
            C = (whole * rotation.from_rotvec(node * turned)).as_matrix()
            rate = turned @ inverse.T
            by_matrix = C[..., None] * rate[:, None, None, :]
            G[:, :, :9] += weight * by_matrix.reshape(count, 3, 9)
            G[:, :, 9:] -= weight * tau * (C @ M)
            cov += weight * walk**2 * tau * (C @ M @ M.T @ np.swapaxes(C, 1, 2))
        whole = whole * rotation.from_rotvec(turned)
    white = np.linalg.inv(np.linalg.cholesky(cov))
    angle = np.broadcast_to(np.eye(3), (count, 3, 3))
    return white @ np.concatenate([G, angle], axis=2), whole.as_matrix()


def _information(
    count: int,
    sensors: list[tuple[Any, range]],
    moves: Float[Array, "k 3 15"],
    C: Float[Array, "k 3 3"],
    rest: Float[Array, "3"],
) -> Float[Array, "p p"]:
    """Information on so many parameters, and then on the attitudes of the rests.

    From white rows of each sensor at rest, (n, 3, c), with the places of its
    parameters, of the moves, and from what the rests say of the gyroscope's bias.
    """
    n = len(moves) + 1
    size, angles = count + 3 * n, count + np.arange(3 * n).reshape(n, 3)
    total = np.zeros((size, size))
    for rows, places in sensors:
        wide = np.zeros((n, 3, size))
        wide[:, :, places] = rows[..., :-3]
        for each, own, at in zip(wide, rows, angles, strict=True):
            each[:, at] = own[:, -3:]
        flat = wide.reshape(-1, size)
        total += flat.T @ flat
    for k, (row, end) in enumerate(zip(moves, C, strict=True)):
        # eq. (Y1): 0 = -G dp - delta_k + C delta_(k+1)
        at = np.r_[9:21, angles[k], angles[k + 1]]
        wide = np.zeros((3, size))
        wide[:, at] = np.concatenate([-row, row[:, 12:] @ end], axis=1)
        total += wide.T @ wide
    total[18:21, 18:21] += np.diag(1.0 / rest**2)
    return total


def bound_of(information: Float[Array, "p p"], count: int) -> Float[Array, "q q"]:
    """Inverse of the Schur complement of all but the first so many unknowns.

    Raises
    ------
    GeometryError
        If it is singular in units in which its diagonal is 1.
    """
    first, others = slice(0, count), slice(count, None)
    back = np.linalg.solve(information[others, others], information[others, first])
    schur = information[first, first] - information[first, others] @ back
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(schur), 1e-300))
    scaled = schur * np.outer(unit, unit)
    values = np.linalg.eigvalsh(0.5 * (scaled + scaled.T))
    if not values[0] > _SINGULAR * values[-1]:
        msg = (
            f"the rests and moves leave a combination of the {count} parameters open "
            f"(information {values[0] / values[-1]:.1e} of the best): nothing can be "
            "predicted; add poses and moves about other axes"
        )
        raise GeometryError(msg)
    return np.linalg.inv(scaled) * np.outer(unit, unit)
