r"""How many quadrics pass through the poses within their noise.

A quadric with coefficients v has the value :math:`m_k^T v` at a reading, and noise s
of the reading moves it by s times its gradient. So the noise of each axis that lets a
quadric through the poses is the root of :math:`v^T G_c v / v^T C v`, and the roots
:math:`s_1 \le s_2 \le \ldots` of the pencil

.. math:: \det(G_c - s^2 C) = 0, \quad
   G_c = \sum_k w_k (m_k - \bar m)(m_k - \bar m)^T, \quad
   C = \sum_k w_k \frac{\partial m_k}{\partial y} \frac{\partial m_k}{\partial y}^T
   \tag{N1}

rank them: the first is the ellipsoid's own, the second says how far the next one is.
Poses below rank nine have a second quadric through them, so :math:`s_2` is noise, too.
Nothing is fitted, so no axis is stretched until its noise looks like poses; and a
shear or a scale of the axes changes the rank of no pose set.

Where two quadrics pass through the poses, their values are Gaussian to first order and
the ratio of the two roots is that of the singular values of (n - 8) x 2 random numbers,
which exceeds x with the probability

.. math:: \left(\frac{2x}{1 + x^2}\right)^{\nu}, \quad \nu = n - 9,  \tag{N2}

the law of Mauchly's test of sphericity in two dimensions. So s_2 must exceed the noise
found in the residuals by a factor that is great where few of them are left.
"""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.moments import in_lanes
from simval.calibrate.positive import negative_pivots
from simval.shapes import Float

FALSE_ACCEPTANCE = 1e-3  # of poses with two quadrics through them, by (N2)

# The greatest error of a combination of parameters is about the noise over s_2; beyond
# 1/7 the terms of second order, left out of the error bars, reach a seventh of them.
NOISE_MARGIN = 7.0

# In units of the root mean square reading. No mean of a hold is off by a tenth of
# gravity: s_2 above that is shape, whatever the residuals. Even poses have a s_2 of 0.2
# (9 poses) to 0.31, with scales up to a factor 4 apart 0.107 or more; rank-deficient
# ones at 0.3 m/s^2 of noise reach it in two of 48 000 sets of 9 to 20 poses.
GREATEST_NOISE = 0.1


# for each axis, the monomials that it is in and what else their slopes are made of: an
# axis or 1; the slope of a square is twice that
_SLOPES = (
    ([0, 3, 4, 6], [0, 1, 2, 3]),
    ([1, 3, 5, 7], [1, 0, 2, 3]),
    ([2, 4, 5, 8], [2, 0, 1, 3]),
)


def pencil(
    moments: Float[Array, "t 10 10"],
) -> tuple[Float[Array, "t 9 9"], Float[Array, "t 9 9"]]:
    """The two matrices of eq. (N1)."""
    m = in_lanes(moments)
    mean, total, linear = m[:9, 9], m[9, 9], m[6:, 6:]
    scatter = m[:9, :9] - (mean / total)[:, None] * mean
    by_axis = np.zeros_like(scatter)
    for places, rest in _SLOPES:
        slopes = linear[np.ix_(rest, rest)]
        slopes[0] *= 2.0
        slopes[:, 0] *= 2.0
        by_axis[np.ix_(places, places)] += slopes
    return np.moveaxis(scatter, -1, 0), np.moveaxis(by_axis, -1, 0)


def second_noise(moments: Float[Array, "10 10"]) -> float:
    """Noise that lets a second quadric through one pose set, s_2 of eq. (N1)."""
    scatter, noise = pencil(moments[None])
    values = np.linalg.eigvals(np.linalg.solve(noise[0], scatter[0])).real
    return float(np.sqrt(max(np.sort(values)[1], 0.0)))


def required_noise(
    level: Float[Array, " t"], dof: int, *, known: bool
) -> Float[Array, " t"]:
    """Least s_2 that is accepted, in the unit of the level."""
    factor = NOISE_MARGIN
    if not known and dof > 0:
        tail = FALSE_ACCEPTANCE ** (1.0 / dof)
        factor = max(factor, (1.0 + np.sqrt(1.0 - tail * tail)) / tail)  # of (N2)
    return np.fmin(factor * level, GREATEST_NOISE)


def ambiguous(moments: Float[Array, "t 10 10"], limit: Float[Array, " t"]) -> Any:
    """Whether a second quadric passes through the poses.

    By Sylvester's law of inertia the roots of (N1) below the limit are as many as the
    negative pivots of G_c - limit^2 C.
    """
    scatter, noise = pencil(moments)
    return negative_pivots(scatter - (limit * limit)[:, None, None] * noise) > 1
