"""The costs to minimise, with their derivatives, for a batch of trials.

A `Local` is put together from weighted moment matrices and the derivatives of the
quadrics' ten coefficients, so no Jacobian of poses by parameters is ever formed.
"""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate import quadric
from simval.calibrate.moments import moment_matrix, weighted_sum
from simval.calibrate.residuals import SLOPES
from simval.calibrate.solver import Local, Objective
from simval.shapes import Float


def pose_objective(
    model: str,
    residual: str,
    z: Float[Array, "t n 3"],
    shares: Float[Array, " n"] | None = None,
    *,
    newton: bool,
) -> Objective:
    """Cost of a residual that needs a pass over the poses for each step."""

    def objective(theta: Array, rows: Any) -> Local:
        x = z if rows.size == z.shape[0] else z[rows]
        c = quadric.residual_quadric(model, theta)
        q = quadric.distance_quadric(c)
        dc, dq = quadric.value_derivatives(c), quadric.value_derivatives(q)
        values_c, values_q = quadric.evaluate([c, q], x)
        slopes = SLOPES[residual](values_c, values_q, newton=False).weighted(shares)
        pull_c = weighted_sum(x, slopes.c)
        pull_q = weighted_sum(x, slopes.q)
        normal = _curve(x, slopes, dc, dq)
        hessian = normal
        if newton:
            bent = SLOPES[residual](values_c, values_q, newton=True).weighted(shares)
            seconds = quadric.residual_seconds(model, theta)
            hessian = _curve(x, bent, dc, dq)
            hessian += quadric.curvature(c, seconds, pull_c)
            seconds = quadric.distance_seconds(c, seconds)
            hessian += quadric.curvature(q, seconds, pull_q)
        return Local(
            cost=slopes.cost.sum(axis=-1),
            gradient=np.vecmat(pull_c, dc) + np.vecmat(pull_q, dq),
            normal=normal,
            hessian=hessian,
        )

    return objective


def _curve(
    x: Float[Array, "t n 3"],
    slopes: Any,
    dc: Float[Array, "t 10 9"],
    dq: Float[Array, "t 10 9"],
) -> Float[Array, "t 9 9"]:
    # Curvature by the parameters from the curvature by (c, q).
    left, other = np.swapaxes(dc, -1, -2), np.swapaxes(dq, -1, -2)
    total = left @ moment_matrix(x, slopes.cc) @ dc
    if np.any(slopes.qq):
        cross = left @ moment_matrix(x, slopes.cq) @ dq
        total += cross + np.swapaxes(cross, -1, -2)
        total += other @ moment_matrix(x, slopes.qq) @ dq
    return total
