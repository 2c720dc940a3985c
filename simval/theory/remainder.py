r"""What an expansion of the attitude error may be off by.

With :math:`F_2` and :math:`F_4` the second and the complete fourth order of a moment,
entry by entry the greatest difference counts, and
:math:`\rho = |C_4 - C_2| / |C_2|` of the covariance is the ratio of one order to the
one before. Taking the series as geometric and doubling it,

.. math:: |F - F_2| \le 2\,|F_4 - F_2|, \tag{R1}
.. math:: |F - F_4| \le 2\,\rho\,|F_4 - F_2|. \tag{R2}

The source's fourth order leaves out terms of its own order, so it may be off by (R1).
Below :math:`|\bar q|/\sigma` = `RANGE` the ratio of two orders is above a quarter and
the estimate too small: there an expansion should not be judged.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from simval.theory.attitude import AttitudeMoments

RANGE = 5.0


@dataclass(frozen=True, slots=True)
class Remainder:
    """Greatest error of any entry of a predicted bias and of a covariance."""

    bias: float
    covariance: float


def expansion_remainders(
    second: AttitudeMoments, fourth: AttitudeMoments
) -> Mapping[int | str, Remainder]:
    """Remainder of each order, eqs. (R1), (R2), from the two complete ones."""
    bias = float(np.abs(fourth.bias - second.bias).max())
    covariance = float(np.abs(fourth.covariance - second.covariance).max())
    ratio = covariance / float(np.abs(second.covariance).max())
    first = Remainder(2 * bias, 2 * covariance)
    return {
        2: first,
        "4-paper": first,
        4: Remainder(2 * ratio * bias, 2 * ratio * covariance),
        "exact": Remainder(0.0, 0.0),
    }
