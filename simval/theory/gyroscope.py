r"""Cramer-Rao bound of an accelerometer and a gyroscope, calibrated by rests and moves.

Unknown are the sensors (the accelerometer's nine parameters, M row by row and B: 21)
and the attitude of every rest. With small rotations :math:`\delta_i` of the body at
rest i, gravity's direction is :math:`u_i + u_i \times \delta_i` and the turn from one
rest to the next :math:`\exp([-\delta_k + C_k \delta_{k+1}])\, C_k`. Measured are

.. math:: y_i = g M_a^{-1} u_i + b_a + n_i, \qquad
   -\delta_k + C_k \delta_{k+1} = G_k\,\mathrm{d}p + \epsilon_k,
   \qquad \bar B = B + n_B, \tag{Y1}

the turn by a gyroscope with wrong parameters, and what the rests say of the bias. With
C(t) the turn so far and :math:`\omega` the rate,

.. math:: G\,\mathrm{d}p = \int C\,(\mathrm{d}M\,M^{-1}\omega - M\,\mathrm{d}B)\,dt,
   \qquad \mathrm{cov}\,\epsilon = N^2 \int C M M^T C^T dt. \tag{Y2}

The bound is the inverse of the Schur complement of the attitudes. A common turn about
the vertical is seen by nobody and touches nothing; it is held.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy

from simval.arguments import choice, instance
from simval.arrays import (
    Array,
    finite_array,
    frozen,
    noise_levels,
    nonnegative_number,
    positive_number,
)
from simval.errors import GeometryError, InputError
from simval.geometry import cross_matrix, normalize
from simval.poses import one_set
from simval.sensor import AccelerometerModel, GyroscopeModel, forms
from simval.shapes import Float

PARAMETERS: Final = 21
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
class GyroscopeMoments:
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

    def __post_init__(self) -> None:
        object.__setattr__(self, "cramer_rao", frozen(self.cramer_rao))

    @property
    def sd(self) -> Float[Array, "21"]:
        """Bound on each standard deviation, (21,)."""
        return np.sqrt(np.diagonal(self.cramer_rao))


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
    instance("accelerometer", accelerometer, AccelerometerModel)
    form = choice("form", form, forms.MODELS)
    g = positive_number("g", g, "m/s^2")
    u = normalize(one_set("directions", directions))
    level = gyroscope.angle_random_walk
    if angle_random_walk is not None:
        level = nonnegative_number("angle_random_walk", angle_random_walk, "raw units")
    sigma = noise_levels("pose_std", pose_std, len(u))
    rest = noise_levels("bias_std", bias_std, 3)
    if len(path.turns) != len(u) - 1 or not (level > 0.0 and min(*sigma, *rest) > 0.0):
        msg = (
            f"`path` has {len(path.turns)} moves for {len(u)} rests, and the noise is "
            f"{level:g}, {sigma.min():g} and {rest.min():g}; there must be a move "
            "between any two rests, and noise above 0"
        )
        raise InputError(msg)
    rows = _pose_rows(accelerometer, form, u, g) / sigma[:, None, None]
    moves, C = move_rows(gyroscope.M, path, level)
    information = _information(rows.reshape(-1, rows.shape[-1]), moves, C, u)
    information[18:21, 18:21] += np.diag(1.0 / rest**2)
    return GyroscopeMoments(
        names=(*forms.names(form), *GYROSCOPE),
        cramer_rao=bound_of(information, PARAMETERS),
    )


def _pose_rows(
    sensor: AccelerometerModel, form: str, u: Float[Array, "n 3"], g: float
) -> Float[Array, "n 3 p"]:
    # of y_i by the nine parameters and by delta_i, the latter in its own columns
    theta = forms.from_gram(form, sensor.matrix.T @ sensor.matrix, sensor.B)
    M = forms.matrix(form, theta)
    x = np.linalg.solve(M, g * u.T).T
    dM = forms.matrix_derivatives(form, theta)
    n = len(u)
    rows = np.zeros((n, 3, PARAMETERS + 3 * n))
    rows[:, :, :6] = -np.einsum("ab,pbc,nc->nap", np.linalg.inv(M), dM, x)
    rows[:, :, 6:9] = np.eye(3)
    tilt = g * np.linalg.inv(M) @ cross_matrix(u)
    for i in range(n):
        rows[i, :, PARAMETERS + 3 * i : PARAMETERS + 3 * i + 3] = tilt[i]
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
    poses: Float[Array, "r p"],
    moves: Float[Array, "k 3 15"],
    C: Float[Array, "k 3 3"],
    u: Float[Array, "n 3"],
) -> Float[Array, "p p"]:
    # eq. (Y1): 0 = -G dp - delta_k + C delta_(k+1)
    total = poses.T @ poses
    for k, (row, end) in enumerate(zip(moves, C, strict=True)):
        wide = np.zeros((3, total.shape[0]))
        wide[:, 9:PARAMETERS] = -row[:, :12]
        at = PARAMETERS + 3 * k
        wide[:, at : at + 3] = -row[:, 12:]
        wide[:, at + 3 : at + 6] = row[:, 12:] @ end
        total += wide.T @ wide
    vertical = np.zeros(total.shape[0])
    vertical[PARAMETERS : PARAMETERS + 3] = u[0]
    return total + np.outer(vertical, vertical) * total[PARAMETERS:, PARAMETERS:].max()


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
