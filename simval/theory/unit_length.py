r"""What bias and covariance of a unit estimate owe each other.

Truth and estimate have length 1, so sample by sample
:math:`|q - \hat q|^2 = 2 - 2 q^T\hat q = 2 q^T (q - \hat q)`. With the mean m and the
covariance C of :math:`q - \hat q`,

.. math:: \mathrm{tr}\,C + m^T m = 2 q^T m,  \tag{L1}

whatever the estimator, the noise and its size. An approximation of m and C can be held
to it without any oracle: what it misses by is of the order of what it leaves out. It
also says which way a bias points: inward, by half of the mean square.
"""

import numpy as np

from simval.arrays import Array
from simval.moments import Moments
from simval.shapes import Float

EPS = float(np.finfo(np.float64).eps)
_LEAST = EPS**2
"""A mean square below this is one of rounding errors."""


def unit_length_defect(mean_square: float, inward: float) -> float:
    """Left less right of (L1), over the left: of a mean square and q'm."""
    return (mean_square - 2.0 * inward) / max(mean_square, _LEAST)


def predicted_defect(predicted: Moments, q: Float[Array, "4"]) -> float:
    """Defect of a predicted bias and covariance about a true quaternion."""
    square = float(np.trace(predicted.second_moment))
    return unit_length_defect(square, float(q @ predicted.bias))


def unit_length_rounding(mean_square: float, off: float = 0.0) -> float:
    r"""Size of the defect that rounding alone can make.

    A normalised quaternion has a squared length within 8 roundings of 1 (squares, sum,
    root, division), 4 eps; so has the truth. Each error and mean is rounded by its own
    size at most, which is the RMS: eps times the RMS in each of four components, times
    the depth of the sums, 16 and less by pairs. What else the squared length of an
    estimate may be off by is `off`.
    """
    rms = float(np.sqrt(mean_square))
    return (8.0 * EPS + 64.0 * EPS * rms + off) / max(mean_square, _LEAST)
