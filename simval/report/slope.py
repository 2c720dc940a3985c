r"""Slope of a curve on log-log axes, and confidence bands that hold together.

The slope is that of a power law :math:`y = a x^k` fitted by weighted least squares to
the values themselves, not to their logarithms: a value that scatters about zero
counts with its sign, so no point has to be left out, which would bias the slope.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from simval.arrays import Array
from simval.shapes import Float

Z95 = float(scipy.special.ndtri(0.975))  # of a two-sided interval of 95 %
STEEPEST = 12.0
"""Slopes are sought between plus and minus this: twice the greatest order
of a formula."""


@dataclass(frozen=True, slots=True)
class Slope:
    """A fitted slope."""

    value: float  # of log y over log x
    half_width: float  # half of the 95 % interval

    def __str__(self) -> str:
        """Slope and interval in words."""
        return f"{self.value:.3f} ± {self.half_width:.3f}"


def fitted_slope(
    x: Float[Array, " n"], y: Float[Array, " n"], error: Float[Array, " n"]
) -> Slope | None:
    """Weighted least-squares exponent k of y = a x^k."""
    if len(np.unique(x)) < 2 or not (np.all(error > 0) and np.all(np.isfinite(y))):
        return None
    z, weighted = np.log(x) - np.log(x).mean(), y / error
    size = float(np.abs(weighted).max())
    if not np.isfinite(weighted).all() or not size > 0.0:
        return None

    def cost(k: float) -> float:
        shape = _shape(k, z, error)
        return float(np.sum((weighted - (weighted @ shape) * shape) ** 2))

    grid = np.linspace(-STEEPEST, STEEPEST, 97)
    start = grid[int(np.argmin([cost(k) for k in grid]))]
    if abs(start) == STEEPEST:
        return None
    step = grid[1] - grid[0]
    fit = scipy.optimize.minimize_scalar(
        cost,
        bounds=(start - step, start + step),
        method="bounded",
        options={"xatol": 1e-10},
    )
    k = float(fit.x)
    shape = _shape(k, z, error)
    amplitude = float(weighted @ shape)
    # derivative along k, with the part that the amplitude takes up removed
    slant = amplitude * (z - (z * shape) @ shape) * shape
    length = float(np.linalg.norm(slant))
    if not abs(amplitude) > Z95 or not length > 0.0:
        return None
    return Slope(k, Z95 / length)


def _shape(
    k: float, z: Float[Array, " n"], error: Float[Array, " n"]
) -> Float[Array, " n"]:
    """Weighted curve x^k of unit length."""
    exponent = k * z - np.log(error)  # errors may be as small or great as floats are
    curve = np.exp(exponent - exponent.max())
    return curve / np.linalg.norm(curve)


def order(x: Float[Array, " n"], y: Float[Array, " n"]) -> float | None:
    """Slope between the two smallest x of a deterministic curve."""
    good = (x > 0) & (y > 0) & np.isfinite(y)
    xs, first = np.unique(x[good], return_index=True)
    if len(xs) < 2:
        return None
    ys = y[good][first]
    return float(np.log(ys[1] / ys[0]) / np.log(xs[1] / xs[0]))


def simultaneous(count: int, confidence: float = 0.95) -> float:
    """Half width, in standard errors, of bands that hold for all points together."""
    single = confidence ** (1.0 / max(count, 1))
    return float(scipy.special.ndtri(0.5 + 0.5 * single))
