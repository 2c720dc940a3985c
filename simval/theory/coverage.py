r"""Coverage of stated intervals and ellipsoids by errors that have a bias.

An error is normal about a bias, and its stated covariance is right but for what theory
leaves out. An interval of t standard deviations, one of them d-fold its true size, then
holds the truth of an error with the bias b, in standard deviations, with

.. math:: P(|t_b| \le t d), \tag{B1}

:math:`t_b` normal about b, or Student's t with the non-centrality b where the deviation
is that of the residuals. The ellipsoid of p parameters holds it with

.. math:: P(\chi^2_p(\lambda) \le x d^2), \quad \lambda = b^T C^{-1} b, \tag{B2}

with F for chi-square likewise. Both fall as the bias grows and rise with d. So what
they may be off by is not more than their distance from their values where b is at
either end of its range and d is at the other: no derivative is taken.
"""

from collections.abc import Callable

import numpy as np
import scipy

from simval.arrays import Array
from simval.moments import deviations
from simval.shapes import Float

Coverage = tuple[Array, Array]
"""A probability, and what it may be off by."""


def interval_coverage(
    level: float,
    bias: Float[Array, " p"],
    left: Float[Array, " p"],
    relative: float,
    freedom: int | None = None,
) -> Coverage:
    """Chance that intervals hold the truth, eq. (B1), with its possible error.

    The bias and what it may be off by are in standard deviations, `relative` is what a
    stated deviation may be off by. `freedom` is that of the residuals; None where the
    noise is known.
    """
    tail = 0.5 + level / 2.0
    t = (
        scipy.special.ndtri(tail)
        if freedom is None
        else scipy.special.stdtrit(freedom, tail)
    )

    def held(b: Array, d: float) -> Array:
        def below(x: float) -> Array:
            if freedom is None:
                return np.asarray(scipy.special.ndtr(x - b))
            return np.asarray(scipy.special.nctdtr(freedom, b, x))

        return below(t * d) - below(-t * d)

    return _between(held, np.abs(bias), left, relative)


def ellipsoid_coverage(
    level: float,
    parameters: int,
    square: float,
    left: float,
    relative: float,
    freedom: int | None = None,
) -> Coverage:
    """Chance that an ellipsoid holds the truth, eq. (B2), with its possible error.

    `square` is that of the bias under the inverse covariance.
    """
    p = parameters
    if freedom is None:
        x = 2.0 * scipy.special.gammaincinv(p / 2.0, level)
    else:
        x = scipy.special.fdtri(p, freedom, level)

    def held(shift: Array, d: float) -> Array:
        if freedom is None:
            return np.asarray(scipy.special.chndtr(x * d * d, p, shift))
        return np.asarray(scipy.special.ncfdtr(p, freedom, shift, x * d * d))

    return _between(held, np.asarray(square), np.asarray(left), relative)


def _between(
    held: Callable[[Array, float], Array], at: Array, left: Array, relative: float
) -> Coverage:
    # the ends of what falls by the first and rises by the second
    value, low = held(at, 1.0), held(at + left, max(1.0 - relative, 0.0))
    high = held(np.maximum(at - left, 0.0), 1.0 + relative)
    return value, np.asarray(np.maximum(value - low, high - value))


def bias_square(
    bias: Float[Array, " p"], left: Float[Array, " p"], covariance: Float[Array, "p p"]
) -> tuple[float, float]:
    r"""Non-centrality :math:`\lambda` of eq. (B2), with its possible error."""
    sd = deviations(covariance)
    inverse = np.linalg.inv(covariance / np.outer(sd, sd))
    b, d = bias / sd, left / sd
    pulled = inverse @ b
    off = 2.0 * np.abs(pulled) @ d + d @ np.abs(inverse) @ d
    return float(b @ pulled), float(off)
