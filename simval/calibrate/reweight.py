r"""Residuals whose weights depend on the parameters but are held fixed in a step.

The weighted residual takes :math:`w = 1/4q` at the measured reading, a robust loss a
weight that falls with the standardised distance. Each round computes the weights,
one weighted moment matrix and one solution; the rounds end by the same stop rule.
"""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate import quadric
from simval.calibrate.leverage import Leverage, minimize_leverage
from simval.calibrate.moments import moment_matrix
from simval.calibrate.residuals import LOSSES
from simval.calibrate.solver import Code, Rules, Solution
from simval.shapes import Float

_ROUNDS = 200  # then `max iterations`; like the default of `max_iterations`
_SCALE_ROUNDS = 10  # then the scale is held, so that the rounds have a fixed point
_ROUNDING_FLOOR = 1e-9  # below it a round that moves no less than the last is rounding
_GAUSS_MAD = 1.4826  # standard deviation over median absolute one, Gaussian


def minimize_reweighted(
    model: str,
    residual: str,
    loss: str,
    z: Float[Array, "t n 3"],
    theta: Float[Array, "t 9"],
    noise: Float[Array, "t n"] | None,
    rules: Rules,
    slack: float,
    shares: Float[Array, " n"] | None = None,
) -> tuple[Solution, Float[Array, "t n"] | None]:
    """Solve with weights renewed between rounds."""
    count = len(theta)
    result, gradient = theta.copy(), np.full(count, np.nan)
    code = np.full(count, int(Code.MAX_ITERATIONS))
    iterations = np.zeros(count, dtype=int)
    ratios = np.zeros(z.shape[:2])
    scale, last = np.full(count, np.nan), np.full(count, np.inf)
    rows = np.arange(count)
    for turn in range(_ROUNDS):
        x = z[rows]
        weights, distance = _distances(model, residual, result[rows], x)
        if shares is not None:
            weights, distance = weights * shares, distance * np.sqrt(shares)
        if loss != "linear":
            if turn < _SCALE_ROUNDS:
                scale[rows] = _scale(distance, noise, rows)
            ratios[rows] = distance / (LOSSES[loss].tuning * scale[rows])[:, None]
            weights = weights * LOSSES[loss].weight(ratios[rows])
        leverage = Leverage.of(moment_matrix(x, weights))
        inner = minimize_leverage(model, leverage, result[rows], rules, slack)
        middle = np.maximum(np.abs(inner.theta + result[rows]) / 2.0, 1.0)
        size = np.max(np.abs(inner.theta - result[rows]) / middle, axis=-1)
        result[rows], gradient[rows] = inner.theta, inner.gradient_norm
        iterations[rows] += inner.iterations
        failed = inner.code != Code.CONVERGED
        code[rows[failed]] = inner.code[failed]
        settled = size <= max(rules.tolerance, 1e-13)  # below is rounding
        settled |= (size <= _ROUNDING_FLOOR) & (size >= last[rows])
        last[rows] = size
        if loss != "linear":
            settled &= turn >= _SCALE_ROUNDS
        code[rows[settled & ~failed]] = int(Code.CONVERGED)
        rows = rows[~(settled | failed)]
        if rows.size == 0:
            break
    solution = Solution(
        theta=result, code=code, iterations=iterations, gradient_norm=gradient
    )
    return solution, None if loss == "linear" else ratios


def _distances(
    model: str, residual: str, theta: Float[Array, "t 9"], x: Float[Array, "t n 3"]
) -> tuple[Float[Array, "t n"], Float[Array, "t n"]]:
    # Weight of the residual and distance to the ellipsoid of each pose.
    c, q = quadric.residual_values(model, theta, x)
    distance = np.abs(c) / (2.0 * np.sqrt(q))
    weights = 0.25 / q if residual == "weighted" else np.ones_like(q)
    return weights, distance


def _scale(
    distance: Float[Array, "t n"], noise: Float[Array, "batch n"] | None, rows: Any
) -> Float[Array, " t"]:
    # Scale of the distances: the known noise, else their median.
    if noise is not None:
        return noise[rows].max(axis=-1)
    poses = distance.shape[-1]
    shrunk = np.sqrt(poses / max(poses - 9, 1))  # nine of the distances are fitted
    scale = _GAUSS_MAD * shrunk * np.median(distance, axis=-1)
    return np.maximum(scale, np.finfo(float).eps)
