r"""The equations of a magnetometer's poses, and the steps that solve them.

**The three equations of a pose, their derivatives and their weights.**

In units where gravity and the strength of the field are 1, with the corrected readings
:math:`u = M_a (y_a - b_a)` and :math:`v = M_m (y_m - b_m)` and with
:math:`s = \sin(\mathrm{dip})`, the attitude of a pose leaves

.. math:: c = [\,|u|^2 - 1,\ |v|^2 - 1,\ u^T v + s\,] = 0,  \tag{M1}

because the specific force points up and the field below the horizon by the dip. The
noise of the readings makes of it, with :math:`D = \partial c/\partial(y_a, y_m)`,

.. math:: \mathrm{cov}\,c = D \Sigma D^T = \begin{bmatrix}
   4 \sigma_a^2 |p|^2 & 0 & 2 \sigma_a^2\, p^T q \\
   \cdot & 4 \sigma_m^2 |r|^2 & 2 \sigma_m^2\, r^T t \\
   \cdot & \cdot & \sigma_a^2 |q|^2 + \sigma_m^2 |t|^2 \end{bmatrix},
   \quad p = M_a^T u,\ q = M_a^T v,\ r = M_m^T v,\ t = M_m^T u.  \tag{M4}

The 22 parameters stand in the order: nine of the accelerometer, the rows of
:math:`M_m`, :math:`b_m`, s.

**Reweighted Gauss-Newton for a batch of trials, damped where a step would not do.**

Each step takes the weights of eq. (M4) at the parameters at hand, so it ends where
:math:`\sum J^T W c = 0`. A step must lower the cost under the weights it was made
with, or be short beside its error bars; else it is damped. A trial ends when its next
step is less than `TOLERANCE` of its own error bars, or of the parameters themselves,
whichever allows more; it leaves the batch then, so no trial depends on its neighbours.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.solver import solve_positive
from simval.sensor import forms
from simval.shapes import Float, Inexact

PARAMETERS = 22
ACCELEROMETER, MATRIX, IRON, DIP = slice(0, 9), slice(9, 18), slice(18, 21), 21
"""Where the parameters stand."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Readings:
    """Pose means of both sensors and their noise, in the scaled units of the fit."""

    accelerometer: Float[Array, "t n 3"]
    magnetometer: Float[Array, "t n 3"]
    accelerometer_std: Float[Array, "t n"]
    magnetometer_std: Float[Array, "t n"]

    def take(self, rows: object) -> "Readings":
        """Some of the trials."""
        return Readings(**{k: getattr(self, k)[rows] for k in self.__slots__})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corrected:
    """What both sensors say of each pose, at some parameters."""

    matrix_a: Inexact[Array, "t 3 3"]
    matrix_m: Inexact[Array, "t 3 3"]
    x_a: Inexact[Array, "t n 3"]  # readings less the bias
    x_m: Inexact[Array, "t n 3"]
    up: Inexact[Array, "t n 3"]  # u of eq. (M1)
    field: Inexact[Array, "t n 3"]  # v


def corrected(
    model: str, theta: Inexact[Array, "t 22"], readings: Readings
) -> Corrected:
    """Both sensors' readings, corrected."""
    matrix_a = forms.matrix(model, theta[:, ACCELEROMETER])
    matrix_m = theta[:, MATRIX].reshape(-1, 3, 3)
    x_a = readings.accelerometer - theta[:, None, 6:9]
    x_m = readings.magnetometer - theta[:, None, IRON]
    return Corrected(
        matrix_a=matrix_a,
        matrix_m=matrix_m,
        x_a=x_a,
        x_m=x_m,
        up=x_a @ np.swapaxes(matrix_a, -1, -2),
        field=x_m @ np.swapaxes(matrix_m, -1, -2),
    )


def residual(at: Corrected, sine: Inexact[Array, " t"]) -> Inexact[Array, "t n 3"]:
    """The three equations of each pose, eq. (M1)."""
    u, v = at.up, at.field
    products = [np.sum(a * b, axis=-1) for a, b in ((u, u), (v, v), (u, v))]
    return np.stack(
        [products[0] - 1.0, products[1] - 1.0, products[2] + sine[:, None]], axis=-1
    )


def jacobian(
    model: str, theta: Float[Array, "t 22"], at: Corrected
) -> Float[Array, "t n 3 22"]:
    """Derivatives of the three equations by the 22 parameters."""
    u, v, x_m = at.up, at.field, at.x_m
    result = np.zeros((*u.shape[:-1], 3, PARAMETERS))
    slopes = forms.matrix_derivatives(model, theta[:, ACCELEROMETER])
    turned = np.swapaxes(slopes.reshape(len(u), 18, 3), -1, -2)
    moved = (at.x_a @ turned).reshape(*u.shape[:-1], 6, 3)  # du by six parameters
    result[..., 0, :6] = 2.0 * np.matvec(moved, u)
    result[..., 2, :6] = np.matvec(moved, v)
    result[..., 0, 6:9] = -2.0 * (u @ at.matrix_a)
    result[..., 2, 6:9] = -(v @ at.matrix_a)
    shape = (*u.shape[:-1], 9)
    result[..., 1, MATRIX] = 2.0 * (v[..., :, None] * x_m[..., None, :]).reshape(shape)
    result[..., 2, MATRIX] = (u[..., :, None] * x_m[..., None, :]).reshape(shape)
    result[..., 1, IRON] = -2.0 * (v @ at.matrix_m)
    result[..., 2, IRON] = -(u @ at.matrix_m)
    result[..., 2, DIP] = 1.0
    return result


def reach(at: Corrected, readings: Any) -> Float[Array, "t n 3 2 3"]:
    """What unit noises of the axes of both sensors do to the equations, eq. (M4)."""
    u, v = at.up, at.field
    L = np.zeros((*u.shape[:2], 3, 2, 3))
    L[:, :, 0, 0] = 2.0 * (u @ at.matrix_a)
    L[:, :, 1, 1] = 2.0 * (v @ at.matrix_m)
    L[:, :, 2, 0] = v @ at.matrix_a
    L[:, :, 2, 1] = u @ at.matrix_m
    stds = readings.accelerometer_std, readings.magnetometer_std
    for sensor, std in enumerate(stds):  # of each pose, or of each of its axes
        L[:, :, :, sensor] *= std.reshape(*u.shape[:2], 1, -1)
    return L


def whitener(at: Corrected, readings: Readings) -> Float[Array, "t n 3 3"]:
    """Lower triangular matrix that makes the noise of eq. (M4) one."""
    a2, m2 = readings.accelerometer_std**2, readings.magnetometer_std**2
    p, q = at.up @ at.matrix_a, at.field @ at.matrix_a
    r, t = at.field @ at.matrix_m, at.up @ at.matrix_m
    # Cholesky factor of eq. (M4), then its inverse
    first = 2.0 * np.sqrt(a2 * np.vecdot(p, p))
    second = 2.0 * np.sqrt(m2 * np.vecdot(r, r))
    along_a = 2.0 * a2 * np.vecdot(p, q) / first
    along_m = 2.0 * m2 * np.vecdot(r, t) / second
    rest = a2 * np.vecdot(q, q) - along_a**2 + m2 * np.vecdot(t, t) - along_m**2
    third = np.sqrt(np.maximum(rest, 0.0))
    result = np.zeros((*first.shape, 3, 3))
    result[..., 0, 0] = 1.0 / first
    result[..., 1, 1] = 1.0 / second
    result[..., 2, 0] = -along_a / (first * third)
    result[..., 2, 1] = -along_m / (second * third)
    result[..., 2, 2] = 1.0 / third
    return result


TOLERANCE = 1e-8
"""Of a standard deviation: a step's effect on any result is 1e-8 of its error bar."""
_FLOOR = 1e-14  # of the parameters, in scaled units: rounding
# Of a standard deviation: a shorter step is taken whatever the cost says, as it gains
# less than the cost's rounding, which noise of 1e-5 of a reading makes 1e-10.
_NEAR = 1e-4
_FIRST_DAMPING, _LAST_DAMPING = 1e-4, 1e12  # of the diagonal


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """What is known beside the poses: R (theta - theta_0) is standard normal."""

    theta: Float[Array, "t 22"]  # theta_0
    root: Float[Array, "t k 22"]  # R

    def take(self, rows: Any) -> "Prior":
        """Some of the trials."""
        return Prior(theta=self.theta[rows], root=self.root[rows])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Local:
    """The whitened equations at some parameters."""

    rows: Float[Array, "t r"]  # three for each pose, and those of the prior
    slopes: Float[Array, "t r 22"]
    whiten: Float[Array, "t n 3 3"]

    @property
    def normal(self) -> Float[Array, "t 22 22"]:
        """The Fisher information, J'J."""
        return np.swapaxes(self.slopes, -1, -2) @ self.slopes

    @property
    def gradient(self) -> Float[Array, "t 22"]:
        """Half the gradient of the cost, J'e."""
        return np.vecmat(self.rows, self.slopes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """Where the iteration of each trial ended."""

    theta: Float[Array, "t 22"]
    iterations: Any  # steps tried, (t,)
    converged: Any  # bool, (t,)


def local(
    model: str, theta: Float[Array, "t 22"], readings: Readings, prior: Prior | None
) -> Local:
    """The whitened equations and their derivatives."""
    at = corrected(model, theta, readings)
    whiten = whitener(at, readings)
    slopes = whiten @ jacobian(model, theta, at)
    return Local(
        rows=_whitened(theta, residual(at, theta[:, DIP]), whiten, prior),
        slopes=_with_prior(slopes.reshape(len(theta), -1, PARAMETERS), prior),
        whiten=whiten,
    )


def _whitened(
    theta: Array, c: Array, whiten: Array, prior: Prior | None
) -> Float[Array, "t r"]:
    rows = np.matvec(whiten, c).reshape(len(theta), -1)
    if prior is None:
        return rows
    off = np.matvec(prior.root, theta - prior.theta)
    return np.concatenate([rows, off], axis=1)


def _with_prior(slopes: Array, prior: Prior | None) -> Float[Array, "t r 22"]:
    if prior is None:
        return slopes
    return np.concatenate([slopes, prior.root], axis=1)


def minimize(
    model: str,
    theta: Float[Array, "t 22"],
    readings: Readings,
    prior: Prior | None,
    most: int,
) -> Solution:
    """Solve the equations of each trial from its own start."""
    count = len(theta)
    theta, damping = theta.copy(), np.zeros(count)
    iterations, converged = np.zeros(count, dtype=int), np.zeros(count, dtype=bool)
    active = np.flatnonzero(np.isfinite(theta).all(axis=1))
    with np.errstate(all="ignore"):  # a hopeless trial overflows and ends unconverged
        for _ in range(most):
            if active.size == 0:
                break
            data = readings.take(active)
            own = None if prior is None else prior.take(active)
            here = local(model, theta[active], data, own)
            step = _step(here, damping[active])
            iterations[active] += 1
            tried = theta[active] + step
            at = corrected(model, tried, data)
            after = _whitened(tried, residual(at, tried[:, DIP]), here.whiten, own)
            cost = np.vecdot(here.rows, here.rows)
            moved = _moved(here, step)
            small = (moved <= TOLERANCE) | _rounding(step, theta[active])
            better = small | (moved <= _NEAR) | (np.vecdot(after, after) < cost)
            theta[active[better]] = tried[better]
            damping[active] = _next_damping(damping[active], better)
            done = small & (damping[active] == 0.0)
            converged[active[done]] = True
            active = active[~done & (damping[active] < _LAST_DAMPING)]
    return Solution(theta=theta, iterations=iterations, converged=converged)


def _step(here: Local, damping: Float[Array, " t"]) -> Float[Array, "t 22"]:
    normal = here.normal
    diagonal = np.einsum("tii->ti", normal)
    diagonal *= 1.0 + damping[:, None]
    return -solve_positive(normal, here.gradient[..., None])[0][..., 0]


def _moved(here: Local, step: Array) -> Float[Array, " t"]:
    # length of the step in standard deviations
    return np.linalg.norm(np.matvec(here.slopes, step), axis=1)


def _rounding(step: Array, theta: Array) -> Any:
    # whether the step is no more than rounding of the parameters
    return np.abs(step).max(axis=1) <= _FLOOR * np.abs(theta).max(axis=1)


def _next_damping(damping: Array, better: Any) -> Float[Array, " t"]:
    less = np.where(damping > _FIRST_DAMPING, damping / 10.0, 0.0)
    more = np.maximum(damping * 10.0, _FIRST_DAMPING)
    return np.where(better, less, more)
