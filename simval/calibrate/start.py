r"""The closed-form start: the ellipsoid through the poses, by linear least squares.

In readings :math:`z` moved to their mean and scaled to unit size, every ellipsoid
through the poses has its own equation :math:`z^T \tilde A z + \ell^T z = 1`  (E1),
because the mean lies inside it. The nine coefficients are linear, so no starting
values are needed, whatever the unit, the scale or the bias. Then
:math:`b = -\tilde A^{-1} \ell / 2` and :math:`A = \tilde A / (1 + b^T \tilde A b)`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.leverage import Leverage
from simval.calibrate.moments import in_lanes, quadratic
from simval.calibrate.positive import factorize
from simval.shapes import Float

# Relative to a column's own length, so the square of a sine: rounding of exactly
# singular monomials leaves 1e-15, poses at the limit of the condition 1e-7 or more.
_LEAST_PIVOT = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ellipsoid:
    """An ellipsoid |M(z - b)| = 1 through the poses, and how well they fix it."""

    gram: Float[Array, "t 3 3"]  # A = M'M; NaN where the poses do not fix an ellipsoid
    bias: Float[Array, "t 3"]  # its centre
    leverage: Leverage  # of the same moments
    # whether the nine monomials of the poses have full rank, (t,) of bool
    determined: Any
    proper: Any  # whether the quadric is an ellipsoid, (t,) of bool


def fit_ellipsoid(moments: Float[Array, "t 10 10"]) -> Ellipsoid:
    """Linear least squares of eq. (E1) from the moment matrices."""
    leverage = Leverage.of(moments)
    p = leverage.start
    gram = in_lanes(quadratic(p.T))
    three = factorize(gram)
    bias = three.solve(p[6:, None] / -2.0)[:, 0]
    # b'Ab = -b'l/2
    level = 1.0 - (bias[0] * p[6] + bias[1] * p[7] + bias[2] * p[8]) / 2.0
    gram /= level
    return Ellipsoid(
        gram=np.ascontiguousarray(np.moveaxis(gram, -1, 0)),
        bias=bias.T.copy(),
        leverage=leverage,
        determined=leverage.factors.pivot > _LEAST_PIVOT,
        proper=three.pivot > 0.0,  # the level is then 1 or more
    )
