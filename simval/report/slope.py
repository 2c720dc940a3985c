"""Slope of a curve on log-log axes, with its confidence interval."""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array

Z95 = 1.959963984540054


@dataclass(frozen=True, slots=True)
class Slope:
    """A fitted slope.

    Attributes
    ----------
    value : float
        Of log y over log x.
    half_width : float
        Half of the 95 % interval.
    """

    value: float
    half_width: float

    def __str__(self) -> str:
        """Slope and interval in words."""
        return f"{self.value:.3f} ± {self.half_width:.3f}"


def fitted_slope(x: Array, y: Array, error: Array) -> Slope | None:
    """Weighted least-squares slope of log y over log x.

    Parameters
    ----------
    x, y : Array
        Positive points, (n,).
    error : Array
        Standard errors of y, all above zero, (n,).

    Returns
    -------
    Slope or None
        None with fewer than two different x or where a point is not positive.
    """
    if len(np.unique(x)) < 2 or not (np.all(y > 0) and np.all(error > 0)):
        return None
    weight = (y / error) ** 2  # 1 / variance of log y
    lx, ly = np.log(x), np.log(y)
    centre = np.average(lx, weights=weight)
    spread = float(np.sum(weight * (lx - centre) ** 2))
    value = float(np.sum(weight * (lx - centre) * ly)) / spread
    return Slope(value, Z95 / float(np.sqrt(spread)))
