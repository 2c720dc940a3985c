r"""The equations of a magnetometer's poses at the truth, for their theory.

Derivatives are taken by complex steps, exact to rounding, of eq. (M1) of
`simval.theory.magnetometer`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import (
    Array,
    finite_array,
    noise_levels,
    positive_number,
    real_number,
)
from simval.errors import InputError
from simval.geometry import attitude_matrix
from simval.sensor import AccelerometerModel, MagnetometerModel, forms
from simval.shapes import Float, Inexact

PARAMETERS = 22
_TINY = 1e-30  # complex step: exact to rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """Sensors and readings at the truth, and the noise; readings y_a, then y_m."""

    form: str
    g: float
    field: float
    theta: Float[Array, "22"]
    y: Float[Array, "n 6"]
    sigma: Float[Array, "n 6"]
    size: Float[Array, "6"]  # of a reading of gravity or of the field, raw units


def problem_of(
    accelerometer: Any,
    magnetometer: Any,
    attitudes: Any,
    dip: Any,
    accelerometer_std: Any,
    magnetometer_std: Any,
    *,
    g: Any,
    field: Any,
    form: Any,
) -> Problem:
    """Check the arguments and lay out the poses.

    Raises
    ------
    InputError
        If an argument is not usable.
    """
    body = instance("accelerometer", accelerometer, AccelerometerModel)
    iron = instance("magnetometer", magnetometer, MagnetometerModel)
    g, field = positive_number("g", g, "m/s^2"), positive_number("field", field, "")
    form = choice("form", form, forms.MODELS)
    dip = dip_angle(dip)
    q = finite_array("attitudes", attitudes, (None, 4))
    if q.ndim != 2 or len(q) == 0:
        msg = f"`attitudes` has shape {q.shape}; give those of one set, (n, 4)"
        raise InputError(msg)
    count, turn = len(q), attitude_matrix(q)
    noise = [
        noise_levels(name, value, count)
        for name, value in (
            ("accelerometer_std", accelerometer_std),
            ("magnetometer_std", magnetometer_std),
        )
    ]
    if not all(np.all(each > 0.0) for each in noise):
        msg = "a noise is 0, and the bound is then 0; give both sensors some noise"
        raise InputError(msg)
    up = turn[:, :, 2]
    along = turn @ np.array([np.cos(dip), 0.0, -np.sin(dip)])
    quiet = np.random.default_rng(0)  # draws nothing: the noise is left out
    clean = MagnetometerModel(M=iron.M, b=iron.b)
    own = AccelerometerModel(T=body.T, K=body.K, B=body.B)
    y = [own.distort(g * up, quiet), clean.distort(field * along, quiet)]
    matrix = body.matrix
    theta = np.empty(PARAMETERS)
    theta[:9] = forms.from_gram(form, matrix.T @ matrix, body.B)
    # M_m refers to the axes of the accelerometer's form
    turned = forms.matrix(form, theta[:9]) @ np.linalg.inv(matrix)
    theta[9:18] = (turned @ iron.M).ravel()
    theta[18:21], theta[21] = iron.b, np.sin(dip)
    return Problem(
        form=form, g=g, field=field, theta=theta, y=np.concatenate(y, axis=1),
        sigma=np.repeat(np.stack(noise, axis=1), 3, axis=1),
        size=np.repeat(
            [g / np.linalg.norm(matrix, 2), field / np.linalg.norm(iron.M, 2)], 3
        ),
    )  # fmt: skip


def dip_angle(value: Any) -> float:
    """Require the angle of a field that tells a heading.

    Raises
    ------
    InputError
        If it is vertical, or no number.
    """
    dip = real_number("dip", value, "rad")
    if not abs(dip) < np.radians(89.9):
        msg = f"`dip` is {dip:g} rad; between -1.569 and 1.569 a field tells a heading"
        raise InputError(msg)
    return dip


def equations(
    p: Problem, theta: Inexact[Array, "... 22"], y: Inexact[Array, "... n 6"]
) -> Inexact[Array, "... n 3"]:
    """The three equations of each pose, eq. (M1)."""
    matrix_a = forms.matrix(p.form, theta[..., :9]) / p.g
    matrix_m = theta[..., 9:18].reshape(*theta.shape[:-1], 3, 3) / p.field
    u = (y[..., :3] - theta[..., None, 6:9]) @ np.swapaxes(matrix_a, -1, -2)
    v = (y[..., 3:] - theta[..., None, 18:21]) @ np.swapaxes(matrix_m, -1, -2)
    dot = np.sum(u * v, axis=-1) + theta[..., None, 21]
    return np.stack(
        [np.sum(u * u, axis=-1) - 1.0, np.sum(v * v, axis=-1) - 1.0, dot], axis=-1
    )


def slopes_of(p: Problem, theta: Array, y: Array) -> Array:
    """Derivatives dc/dtheta, (..., n, 3, 22)."""
    columns = [
        equations(p, theta + 1j * _TINY * e, y).imag / _TINY for e in np.eye(PARAMETERS)
    ]
    return np.stack(columns, axis=-1)


def reach_of(p: Problem, theta: Any, y: Array) -> Array:
    """Derivatives dc/dy by a pose's own readings, (..., n, 3, 6)."""
    columns = [equations(p, theta, y + 1j * _TINY * e).imag / _TINY for e in np.eye(6)]
    return np.stack(columns, axis=-1)


def along_of(p: Problem, at: tuple[Array, Array], way: tuple[Array, Array]) -> Array:
    """Derivative of c along a way of the parameters and readings, (..., n, 3)."""
    theta, y = (here + 1j * _TINY * step for here, step in zip(at, way, strict=True))
    return equations(p, theta, y).imag / _TINY


def jacobian(p: Problem) -> Float[Array, "n 3 22"]:
    """Derivatives dc/dtheta at the truth."""
    return slopes_of(p, p.theta, p.y)


def noise_of(p: Problem) -> Float[Array, "n 3 3"]:
    """Covariance of the three equations of each pose at the truth."""
    reach = reach_of(p, p.theta, p.y) * p.sigma[:, None, :]
    return reach @ np.swapaxes(reach, -1, -2)


def weights_of(p: Problem) -> Float[Array, "n 3 3"]:
    """Inverse of that covariance."""
    return np.linalg.inv(noise_of(p))
