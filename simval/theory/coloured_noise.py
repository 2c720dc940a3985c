r"""Bound on a noise model's coefficients, and Allan variance of sampled noise.

**Cramer-Rao bound, by Whittle's likelihood.** The periodogram of n rows at steps of h
has, at the frequencies :math:`f_k = k/(n h)`, independent values with the mean

.. math:: S(f) = N^2 + \frac{B^2}{2 \pi f} + \frac{K^2}{(2 \pi f)^2}  \tag{N8}

(of both signs of the frequency), exponentially distributed, as n grows. The information
on the squares of the coefficients is then

.. math:: I_{ij} = \sum_{0 < f_k < 1/(2h)}
   \frac{\partial \ln S}{\partial \theta_i} \frac{\partial \ln S}{\partial \theta_j},
   \qquad \theta = (N^2, B^2, K^2),  \tag{N9}

and no unbiased estimate has a smaller covariance than its inverse. White noise alone:
:math:`\mathrm{var}(N^2) = 2 N^4/n`.

**Noise that is sampled, not averaged over each row.** Rows of flicker noise and of a
random walk, as `simval.imu.sensor` draws them, have the spectra
:math:`B^2/(2|\sin\pi f|)` and :math:`K^2/(2\sin\pi f)^2`, f in cycles per row. The
differences of neighbouring rows are stationary, with autocovariances

.. math:: \gamma_k = \frac{4}{\pi}\,\frac{1}{1 - 4k^2}\,B^2,\qquad
   \gamma_k = K^2\,[k = 0]  \tag{N10}

and two neighbouring averages of m rows differ by their sum with the weights
:math:`w = (1, 2, \dots, m, \dots, 2, 1)/m`, so that

.. math:: \sigma^2(m) = \tfrac12 \sum_k \gamma_k \sum_j w_j w_{j+k}
   = \frac{2m^2 + 1}{6m}\,K^2 \text{ for the walk.}  \tag{N11}

For many rows these are the laws of averages of a continuous signal,
:math:`(2\ln 2/\pi)\,B^2` and :math:`K^2 m/3`; at one row they are 1.44 and 1.5 of them.
"""

from typing import Any, Final

import numpy as np

from simval.arguments import whole_number
from simval.arrays import Array, nonnegative_number, positive_number
from simval.errors import InputError
from simval.shapes import Float, Int

LEAST_ROWS = 16
"""Seven frequencies: fewer say nothing of three coefficients."""


def noise_bound(
    n: int, rate_hz: float, *, white: Any, flicker: Any = 0.0, walk: Any = 0.0
) -> Float[Array, "3 3"]:
    """Cramér-Rao bound on estimates of N^2, B^2 and K^2, eq. (N9).

    Parameters
    ----------
    n : int
        Number of rows, 16 or more.
    rate_hz : float
        Rows per second, Hz.
    white : float
        White noise N, units of the readings per root hertz, above 0.
    flicker : float
        Flicker B, units of the readings.
    walk : float
        Rate random walk K, units of the readings per root second.

    Returns
    -------
    Array
        In the order N^2, B^2, K^2, (3, 3).

    Raises
    ------
    InputError
        If a number cannot be used.
    """
    n = whole_number("n", n, LEAST_ROWS, 10**9)
    rate_hz = positive_number("rate_hz", rate_hz, "Hz")
    white = positive_number("white", white, "per root hertz")
    flicker = nonnegative_number("flicker", flicker, "")
    walk = nonnegative_number("walk", walk, "per root second")
    omega = 2.0 * np.pi * np.arange(1, (n + 1) // 2) * rate_hz / n
    # relative to the white noise, so that no unit makes a power too large or small
    shapes = np.stack([np.ones_like(omega), 1.0 / omega, 1.0 / omega**2])
    level = np.array([1.0, (flicker / white) ** 2, (walk / white) ** 2]) @ shapes
    rows = shapes / level
    size = np.linalg.norm(rows, axis=1)
    spread = np.linalg.pinv((rows / size[:, None]).T)
    bound = white**4 * (spread @ spread.T) / np.multiply.outer(size, size)
    if not np.all(np.isfinite(bound)):
        msg = (
            f"the bound for noise of {white:g}, {flicker:g} and {walk:g} is not "
            "finite; check the units"
        )
        raise InputError(msg)
    return bound


FLOOR: Final = 2.0 * np.log(2.0) / np.pi  # of flicker, continuous
LONGEST: Final = 256
"""Rows of an average from which flicker is that of a continuous signal, to 3e-5."""


def sampled_allan_law(counts: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
    """Allan variance of samples for one unit of N^2, B^2, K^2, eq. (N11)."""
    m = np.asarray(counts, dtype=float)
    flicker = [_flicker(count) if count < LONGEST else FLOOR for count in counts]
    return np.stack(
        [1.0 / m, np.array(flicker), (2.0 * m**2 + 1.0) / (6.0 * m)], axis=1
    )


def _flicker(m: int) -> float:
    up = np.arange(1.0, m + 1.0)
    weights = np.concatenate([up, up[-2::-1]]) / m
    products = np.correlate(weights, weights, "full")
    k = np.arange(len(products)) - len(weights) + 1
    return float(0.5 * products @ (4.0 / np.pi / (1.0 - 4.0 * k**2)))
