r"""Covariance and fit statistics at a solution, in the scaled units of the fit.

The estimate solves :math:`\sum_k a_k c_k\, d_k = 0`, :math:`d = \partial c /
\partial\theta`, up to terms of second order in the noise, with :math:`a = 1`
(squared, norm, adjusted) or :math:`1/4q`, times the share of the pose by its noise
where that is known (weighted, sampson), and
:math:`\partial c/\partial y` has squared length :math:`4q`. So to first order

.. math:: \mathrm{Cov} = N^{-1} \Big(\sum_k 4 q_k a_k^2 \sigma_k^2 d_k d_k^T\Big)
   N^{-1}, \quad N = \sum_k a_k d_k d_k^T  \tag{U1}

when sigma is known. Type A takes for it the least scatter of the distances to an
ellipsoid nearby,

.. math:: s^2 = \min_\delta \sum_k \frac{(c_k + d_k^T \delta)^2}{4 q_k} \Big/ (n-9)
   \tag{U2}

which is :math:`\sigma^2 \chi^2_{n-9}/(n-9)` to first order; at the minimum of the
weighted and Sampson residuals :math:`\delta = 0`. The scatter about the squared or norm
residual's own ellipsoid is greater where the axes differ in scale, by a third at 12
poses and scales 1 to 3. The textbook :math:`s^2 (J^T J)^{-1}` would hold the
residuals c for equally noisy, which they then are not (5 % of spread costs 3 % of a
sd). For a robust loss with influence function :math:`\psi`, both cases take Huber's
:math:`s^2 = \kappa^2 \sum\psi_k^2 / (n-9) / \overline{\psi'}^2`  (U3),
:math:`\kappa = 1 + (9/n) \mathrm{var}(\psi')/\overline{\psi'}^2`, which a few
outliers do not move.
"""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.calibrate import quadric
from simval.calibrate.moments import moment_matrix, weighted_sum
from simval.calibrate.positive import solve_positive
from simval.calibrate.residuals import LOSSES, WEIGHTED
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Summary:
    """Statistics of a solution, scaled units."""

    covariance: Float[Array, "t 9 9"]  # covariance of theta; NaN where there is none
    cost: Float[Array, " t"]  # sum of squared residuals
    rms: Float[Array, " t"]  # root mean square of the norm less one
    # chi-square per degree of freedom; NaN without sigma
    chi2_per_dof: Float[Array, " t"]
    # standard deviation of the distances, by degree of freedom
    distance_std: Float[Array, " t"]
    steepness: Float[Array, " t"]  # root mean square of the gradient of c


def summarize(
    model: str,
    residual: str,
    theta: Float[Array, "t 9"],
    z: Float[Array, "t n 3"],
    *,
    sigma: Float[Array, "t n"] | None,
    loss: str = "linear",
    ratio: Float[Array, "t n"] | None = None,
    shares: Float[Array, " n"] | None = None,
    covariance: bool = True,
) -> Summary:
    """Covariance and statistics of each trial at its solution."""
    c, q = quadric.residual_values(model, theta, z)
    dof = z.shape[1] - 9
    a = _weights(residual, q, shares)
    squares = c * c if a is None else a * c * c
    total = squares.sum(axis=-1)
    distance2 = 0.25 * c * c / q
    chi2 = spread = np.full(len(z), np.nan)
    if dof > 0:
        spread = np.sqrt(distance2.sum(axis=-1) / dof)
    if sigma is not None and dof > 0 and np.all(sigma > 0.0):
        chi2 = (distance2 / sigma**2).sum(axis=-1) / dof
    matrix = np.full((len(z), 9, 9), np.nan)
    if covariance and (dof > 0 or (sigma is not None and ratio is None)):
        dv = quadric.value_derivatives(quadric.residual_quadric(model, theta))
        if ratio is not None:
            weight = np.ones(z.shape[1]) if shares is None else shares
            variance = _huber_variance(np.sqrt(distance2 * weight), ratio, loss)
            variance = variance[:, None] / weight
        elif sigma is not None:
            variance = sigma**2
        else:
            own = spread * spread if a is not None else _least_scatter(dv, z, c, q)
            variance = own[:, None]
        middle = 4.0 * q * variance
        matrix = _sandwich(dv, z, a, middle)
    norm = np.sqrt(np.maximum(1.0 + c, 0.0)) - 1.0
    if residual == "norm":
        total = (norm * norm).sum(axis=-1)
    return Summary(
        covariance=matrix,
        cost=total,
        rms=np.sqrt((norm * norm).mean(axis=-1)),
        chi2_per_dof=chi2,
        distance_std=spread,
        steepness=2.0 * np.sqrt(q.mean(axis=-1)),
    )


def _weights(
    residual: str, q: Float[Array, "t n"], shares: Float[Array, " n"] | None
) -> Float[Array, "t n"] | None:
    # a of eq. (U1); None for 1
    if residual not in WEIGHTED:
        return None
    return 0.25 / q if shares is None else 0.25 / q * shares


def _least_scatter(
    dv: Float[Array, "t 10 9"],
    z: Float[Array, "t n 3"],
    c: Float[Array, "t n"],
    q: Float[Array, "t n"],
) -> Float[Array, " t"]:
    # eq. (U2)
    w = 0.25 / q
    pull = np.vecmat(weighted_sum(z, w * c), dv)
    back = solve_positive(_contract(dv, moment_matrix(z, w)), pull[..., None])[0]
    least = np.vecdot(w * c, c) - np.vecdot(pull, back[..., 0])
    return np.maximum(least, 0.0) / (z.shape[1] - 9)  # rounding may leave -1e-32


def _huber_variance(
    distance: Float[Array, "t n"], ratio: Float[Array, "t n"], loss: str
) -> Float[Array, " t"]:
    # eq. (U3)
    count = distance.shape[-1]
    pull = distance * LOSSES[loss].weight(ratio)
    slope = LOSSES[loss].slope(ratio)
    mean = slope.mean(axis=-1)
    total = np.vecdot(pull, pull) / max(count - 9, 1)
    with np.errstate(divide="ignore", invalid="ignore"):  # no pose is near: NaN
        inflation = 1.0 + 9.0 / count * slope.var(axis=-1) / mean**2
        return np.asarray(inflation**2 * total / mean**2)


def _sandwich(
    dv: Float[Array, "t 10 9"],
    z: Float[Array, "t n 3"],
    a: Float[Array, "t n"] | None,
    middle: Float[Array, "t n"],
) -> Float[Array, "t 9 9"]:
    # eq. (U1) with `middle` the variance of c in each pose
    normal = _contract(dv, moment_matrix(z, a))
    inverse = solve_positive(normal, np.broadcast_to(np.eye(9), normal.shape))[0]
    weights = middle if a is None else a * a * middle
    return inverse @ _contract(dv, moment_matrix(z, weights)) @ inverse


def _contract(
    dv: Float[Array, "t 10 9"], moments: Float[Array, "t 10 10"]
) -> Float[Array, "t 9 9"]:
    # Sum of w_k d_k d_k' from the moment matrix with those weights.
    return np.swapaxes(dv, -1, -2) @ (moments @ dv)
