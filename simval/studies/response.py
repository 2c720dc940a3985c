r"""How an estimate answers its readings, found by moving each of them a little.

Of an estimator :math:`\hat\theta(y)` whose readings have independent noise of
deviation :math:`\sigma_k`, central differences at the truth give, with no derivative of
anybody's,

.. math:: C = \sum_k \sigma_k^2\, \theta_k \theta_k^T, \qquad
   b = \tfrac12 \sum_k \sigma_k^2\, \theta_{kk},  \tag{R2}

the covariance of first and the bias of second order. Theory has both from its own
Jacobian and Hessian, an algorithm its error bars from another: each must meet (R2) to
what the differences leave. These are of fourth order,
:math:`h\,\theta_k \approx \tfrac23(\theta_+ - \theta_-) - \tfrac1{12}(\theta_{++} -
\theta_{--})`, so a step of :math:`h` leaves :math:`h^4` and rounding
:math:`\epsilon/h`, relative to the size of a reading.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

FIRST = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
SECOND = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0
"""Weights of the values at -2, -1, 0, 1 and 2 steps."""

STEP = 2e-3
"""Of the size of a reading: h^4 is 1.6e-11, rounding over h 1e-13, over h^2 6e-11."""

MET = 1e-7
"""Relative to the standard deviations: `STEP`'s remainders, times what the poses
enlarge them by (1e-9 was the worst seen, `tests/studies/test_foundations.py`)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Response:
    """Derivatives of an estimate by each reading."""

    first: Float[Array, "d p"]
    second: Float[Array, "d p"]  # each by the same reading twice

    def covariance(self, noise: Float[Array, " d"]) -> Float[Array, "p p"]:
        """Covariance of first order, eq. (R2)."""
        scaled = self.first * noise[:, None]
        return scaled.T @ scaled

    def bias(self, noise: Float[Array, " d"]) -> Float[Array, " p"]:
        """Bias of second order, eq. (R2)."""
        return 0.5 * noise**2 @ self.second


def response(
    estimate: Callable[[Array], Array],
    readings: Float[Array, " d"],
    step: float,
) -> Response:
    """Derivatives of ``estimate(y)``, (t, d) to (t, p), in readings' own unit."""
    d = len(readings)
    moved = readings + step * np.concatenate([k * np.eye(d) for k in (-2, -1, 0, 1, 2)])
    found = estimate(moved)
    found = found.reshape(5, d, found.shape[-1])
    return Response(
        first=np.tensordot(FIRST, found, axes=1) / step,
        second=np.tensordot(SECOND, found, axes=1) / step**2,
    )


def apart(stated: Float[Array, "... p p"], known: Float[Array, "p p"]) -> float:
    """Greatest distance of two covariances, relative to the known deviations."""
    sd = np.sqrt(np.diagonal(known))
    return float(np.max(np.abs(stated - known) / np.outer(sd, sd)))
