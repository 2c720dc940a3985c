r"""Reweighted Gauss-Newton for a batch of trials, damped where a step would not do.

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
from simval.calibrate.magnetometer.equations import (
    DIP,
    PARAMETERS,
    Readings,
    corrected,
    jacobian,
    residual,
    whitener,
)
from simval.calibrate.positive import solve_positive
from simval.shapes import Float

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
