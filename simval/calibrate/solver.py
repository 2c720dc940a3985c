r"""Levenberg-Marquardt, damped Gauss-Newton and Newton for a batch of trials.

The three methods of the sources share one loop; they differ in the matrix of the
step (:math:`J^TJ + \mu I`, :math:`J^TJ`, the full Hessian) and in what is done when
a step would raise the cost (more :math:`\mu`, a shorter step).

The stop rule is the symmetric Gauss-Newton derivation's, largest
:math:`|2 (X_k - X_{k-1}) / (X_k + X_{k-1})|` below a tolerance, made safe where a
parameter crosses zero: the mean of the two magnitudes counts as at least 1, the
size of a typical parameter in the scaled units of the fit  (L1). Each trial has its
own rule and damping, and leaves the batch when it stops, so no trial depends on its
neighbours.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.positive import solve_positive

METHODS = ("lm", "gauss-newton", "newton")

_FIRST_DAMPING = 1e-6  # of the mean diagonal: the start is within the noise
_LAST_DAMPING = 1e12
_SHORTEST = 2.0**-40
_ROUNDING_FLOOR = 1e-7  # below it a step that no longer shrinks is rounding


class Code(IntEnum):
    """How a trial ended."""

    CONVERGED = 0
    MAX_ITERATIONS = 1
    STALLED = 2
    NON_FINITE = 3
    DUPLICATES = 4
    RANK = 5
    CONDITION = 6
    NOT_ELLIPSOID = 7
    SATURATED = 8
    NOISE_RANK = 9


STATUS_NAMES = np.array(
    [
        "converged",
        "max iterations",
        "stalled",
        "refused: non-finite poses",
        "refused: duplicate poses",
        "refused: rank below nine",
        "refused: ill-conditioned",
        "refused: not an ellipsoid",
        "refused: saturated poses",
        "refused: rank below nine within the noise",
    ]
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Local:
    """Half the cost and its derivatives at a point.

    Attributes
    ----------
    cost : Array
        Half the sum of squared residuals, (t,).
    gradient : Array
        Its gradient, (t, 9).
    normal : Array
        J'J, (t, 9, 9).
    hessian : Array
        The full Hessian for Newton's method; `normal` for the others, (t, 9, 9).
    """

    cost: Array
    gradient: Array
    normal: Array
    hessian: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rules:
    """What governs the iteration.

    Attributes
    ----------
    method : str
        One of `METHODS`.
    step : float
        Fraction of each step that is taken.
    tolerance : float
        Limit of the stop rule (L1).
    max_iterations : int
        Most steps that are tried.
    """

    method: str
    step: float
    tolerance: float
    max_iterations: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """Where the iteration of each trial ended.

    Attributes
    ----------
    theta : Array
        Parameters, (t, 9).
    code : Array
        A `Code` for each trial, (t,).
    iterations : Array
        Steps tried, (t,).
    gradient_norm : Array
        Norm of the last gradient, (t,).
    """

    theta: Array
    code: Any
    iterations: Any
    gradient_norm: Array


Objective = Callable[[Array, Any], Local]  # (parameters, rows of the batch)


def minimize(objective: Objective, theta: Array, rules: Rules, slack: Any) -> Solution:
    """Minimise each trial's cost from its own start.

    Parameters
    ----------
    objective : callable
        Maps parameters, (a, 9), and their rows in the batch, (a,), to a `Local`.
    theta : Array
        Starts, (t, 9).
    rules : Rules
        Method, step and stop rule.
    slack : float or Array
        Rise of the cost that rounding alone can cause, one or for each trial (t,).

    Returns
    -------
    Solution
        Parameters and status of each trial.
    """
    count = theta.shape[0]
    result = theta.copy()
    code = np.full(count, int(Code.MAX_ITERATIONS))
    iterations = np.zeros(count, dtype=int)
    gradient_norm = np.full(count, np.nan)
    rows = np.arange(count)
    here = objective(theta, rows)
    mean = np.trace(here.normal, axis1=-2, axis2=-1) / 9.0
    damping, length = _FIRST_DAMPING * mean, np.ones(count)
    last, slack = np.full(count, np.inf), np.broadcast_to(slack, (count,))
    for iteration in range(1, rules.max_iterations + 1):
        step = length[:, None] * rules.step * _step(here, rules.method, damping)
        trial = theta + step
        there = objective(trial, rows)
        better = there.cost <= here.cost + slack  # NaN is not better
        middle = np.maximum(np.abs(trial + theta) / 2.0, 1.0)
        size = np.max(np.abs(step) / middle, axis=-1)
        theta = np.where(better[:, None], trial, theta)
        here = _choose(better, there, here)
        damping = np.where(better, damping / 10.0, damping * 10.0)
        length = np.where(better, np.minimum(2.0 * length, 1.0), length / 2.0)
        at_floor = (size <= _ROUNDING_FLOOR) & (size >= last)
        done = better & ((size <= rules.tolerance) | at_floor)
        dead = (damping > _LAST_DAMPING * mean) | (length < _SHORTEST)
        dead &= ~better
        last = np.where(better, size, last)
        leave = done | dead
        if iteration == rules.max_iterations:
            leave = np.ones_like(done)
        if leave.any():
            gone = rows[leave]
            result[gone] = theta[leave]
            code[rows[done]] = int(Code.CONVERGED)
            code[rows[dead]] = int(Code.STALLED)
            iterations[gone] = iteration
            gradient_norm[gone] = np.linalg.norm(here.gradient[leave], axis=-1)
            stay = ~leave
            rows, theta, last, mean = rows[stay], theta[stay], last[stay], mean[stay]
            damping, length, slack = damping[stay], length[stay], slack[stay]
            here = _take(here, stay)
        if rows.size == 0:
            break
    return Solution(
        theta=result, code=code, iterations=iterations, gradient_norm=gradient_norm
    )


def _step(here: Local, method: str, damping: Array) -> Array:
    # The full step of each trial, (t, 9).
    right = -here.gradient[..., None]
    if method == "lm":
        matrices = here.normal + damping[:, None, None] * np.eye(9)
        return solve_positive(matrices, right)[0][..., 0]
    step, pivot = solve_positive(here.hessian, right)
    if method == "newton" and not np.all(pivot > 0.0):  # not convex here: Gauss-Newton
        bad = ~(pivot > 0.0)
        step[bad] = solve_positive(here.normal[bad], right[bad])[0]
    return step[..., 0]


def _choose(better: Any, there: Local, here: Local) -> Local:
    if better.all():
        return there
    pick = better[:, None, None]
    normal = np.where(pick, there.normal, here.normal)
    same = here.hessian is here.normal
    return Local(
        cost=np.where(better, there.cost, here.cost),
        gradient=np.where(better[:, None], there.gradient, here.gradient),
        normal=normal,
        hessian=normal if same else np.where(pick, there.hessian, here.hessian),
    )


def _take(here: Local, stay: Any) -> Local:
    normal = here.normal[stay]
    same = here.hessian is here.normal
    return Local(
        cost=here.cost[stay],
        gradient=here.gradient[stay],
        normal=normal,
        hessian=normal if same else here.hessian[stay],
    )
