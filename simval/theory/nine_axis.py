r"""Cramer-Rao bound of three sensors, calibrated by the same rests and moves.

To the unknowns of `simval.theory.gyroscope` the magnetometer adds its matrix, hard iron
and the dip, 34 in all, and to its measurements three readings a rest: with
:math:`f_i = A_i [\cos d, 0, -\sin d]^T` and small rotations :math:`\delta_i` of the
body,

.. math:: y_{a,i} = g M_a^{-1}(u_i + u_i \times \delta_i) + b_a + n, \qquad
   y_{m,i} = F M_m^{-1}(f_i + f_i \times \delta_i) + b_m + n, \tag{Y3}

beside the turns (Y1). Every attitude is unknown, headings too, and their azimuth counts
from the field: a common turn about the vertical turns the field, so nothing is held.
The bound is the inverse of the Schur complement of the attitudes. Derivatives of (Y3)
are complex steps, exact to rounding.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import (
    Array,
    finite_array,
    frozen,
    noise_levels,
    nonnegative_number,
    positive_number,
    real_number,
)
from simval.errors import InputError
from simval.geometry import attitude_matrix
from simval.sensor import (
    AccelerometerModel,
    GyroscopeModel,
    MagnetometerModel,
    forms,
)
from simval.shapes import Float, Inexact
from simval.theory.gyroscope import GYROSCOPE, MovePath, bound_of, move_rows
from simval.theory.magnetometer import NAMES

PARAMETERS: Final = 34
_POSES: Final = 25  # accelerometer, magnetometer and the attitude of a pose
_TINY: Final = 1e-30  # complex step: exact to rounding
_STEEP: Final = np.radians(89.9)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NineAxisMoments:
    """Predicted error of a calibration of three sensors.

    Attributes
    ----------
    names : tuple of str
        Names of the 34 parameters: the accelerometer's, and the others', which begin
        with gyro and mag.
    cramer_rao : Array
        Bound on their covariance, (34, 34); the dip in rad.
    """

    names: tuple[str, ...]
    cramer_rao: Float[Array, "34 34"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "cramer_rao", frozen(self.cramer_rao))

    @property
    def sd(self) -> Float[Array, "34"]:
        """Bound on each standard deviation, (34,)."""
        return np.sqrt(np.diagonal(self.cramer_rao))


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
    walk = gyroscope.angle_random_walk
    if angle_random_walk is not None:
        walk = nonnegative_number("angle_random_walk", angle_random_walk, "raw units")
    q = finite_array("attitudes", attitudes, (None, 4))
    theta = forms.from_gram(form, body.matrix.T @ body.matrix, body.B)
    # all matrices, directions and turns on the axes of the form
    turned = forms.matrix(form, theta) @ np.linalg.inv(body.matrix)
    values = np.concatenate([theta, (turned @ iron.M).ravel(), iron.b, [_dip(dip)]])
    levels = _levels(pose_std, field_std, bias_std, len(q))
    _require_noise(path, len(q), walk, levels)
    poses = _pose_rows(form, values, turned @ attitude_matrix(q), g, field)
    poses[:, :3] /= levels[0][:, None, None]
    poses[:, 3:] /= levels[1][:, None, None]
    onto = MovePath(turns=path.turns @ turned.T, seconds=path.seconds)
    moves, C = move_rows(turned @ gyroscope.M, onto, walk)
    information = _information(poses, moves, C)
    own = slice(18, 21)
    information[own, own] += np.diag(1.0 / levels[2] ** 2)
    return NineAxisMoments(
        names=(
            *forms.names(form),
            *(f"gyro_{name}" for name in GYROSCOPE),
            *(f"mag_{name}" for name in NAMES),
        ),
        cramer_rao=bound_of(information, PARAMETERS),
    )


def _dip(value: float) -> float:
    dip = real_number("dip", value, "rad")
    if not abs(dip) < _STEEP:
        msg = f"`dip` is {dip:g} rad; between -1.569 and 1.569 a field tells a heading"
        raise InputError(msg)
    return dip


def _levels(
    pose_std: Any, field_std: Any, bias_std: Any, count: int
) -> tuple[Array, Array, Array]:
    return (
        noise_levels("pose_std", pose_std, count),
        noise_levels("field_std", field_std, count),
        noise_levels("bias_std", bias_std, 3),
    )


def _require_noise(
    path: MovePath, count: int, walk: float, levels: tuple[Array, Array, Array]
) -> None:
    least = min(float(each.min()) for each in levels)
    if len(path.turns) != count - 1 or not (walk > 0.0 and least > 0.0):
        msg = (
            f"`path` has {len(path.turns)} moves for {count} rests, and the noise is "
            f"{walk:g} of the moves and {least:g} at the least; there must be a move "
            "between any two rests, and noise above 0"
        )
        raise InputError(msg)


def _pose_rows(
    form: str,
    values: Float[Array, "22"],
    A: Float[Array, "n 3 3"],
    g: float,
    field: float,
) -> Float[Array, "n 6 25"]:
    # of both readings by the accelerometer, the magnetometer and delta_i, eq. (Y3)
    unknown = np.concatenate([values, np.zeros(3)])
    columns = [
        _readings(form, unknown + 1j * _TINY * unit, A, g, field).imag / _TINY
        for unit in np.eye(_POSES)
    ]
    return np.stack(columns, axis=-1)


def _readings(
    form: str, p: Inexact[Array, "25"], A: Float[Array, "n 3 3"], g: float, field: float
) -> Inexact[Array, "n 6"]:
    force = np.linalg.inv(forms.matrix(form, p[:9]))
    iron = np.linalg.inv(p[9:18].reshape(3, 3))
    along = np.stack([np.cos(p[21]), 0.0 * p[21], -np.sin(p[21])])
    pair = (force, g * A[:, :, 2], p[6:9]), (iron, field * A @ along, p[18:21])
    return np.concatenate(
        [(v + np.cross(v, p[22:])) @ inverse.T + b for inverse, v, b in pair], axis=1
    )


def _information(
    poses: Float[Array, "n 6 25"],
    moves: Float[Array, "k 3 15"],
    C: Float[Array, "k 3 3"],
) -> Float[Array, "p p"]:
    # of accelerometer, gyroscope, magnetometer, and then the attitudes
    n = len(poses)
    total = np.zeros((PARAMETERS + 3 * n, PARAMETERS + 3 * n))
    attitude = PARAMETERS + np.arange(3)
    for i, rows in enumerate(poses):
        at = np.r_[0:9, 21:34, attitude + 3 * i]
        total[np.ix_(at, at)] += rows.T @ rows
    for k, (row, end) in enumerate(zip(moves, C, strict=True)):
        # eq. (Y1): 0 = -G dp - delta_k + C delta_(k+1)
        at = np.r_[9:21, attitude + 3 * k, attitude + 3 * (k + 1)]
        wide = np.concatenate([-row, row[:, 12:] @ end], axis=1)
        total[np.ix_(at, at)] += wide.T @ wide
    return total
