r"""Allan variance of coloured noise that is sampled, not averaged over each row.

Rows of flicker noise and of a random walk, as `simval.sensor` draws them, have the
spectra :math:`B^2/(2|\sin\pi f|)` and :math:`K^2/(2\sin\pi f)^2`, f in cycles per row.
The differences of neighbouring rows are stationary, with autocovariances

.. math:: \gamma_k = \frac{4}{\pi}\,\frac{1}{1 - 4k^2}\,B^2,\qquad
   \gamma_k = K^2\,[k = 0]  \tag{N10}

and two neighbouring averages of m rows differ by their sum with the weights
:math:`w = (1, 2, \dots, m, \dots, 2, 1)/m`, so that

.. math:: \sigma^2(m) = \tfrac12 \sum_k \gamma_k \sum_j w_j w_{j+k}
   = \frac{2m^2 + 1}{6m}\,K^2 \text{ for the walk.}  \tag{N11}

For many rows these are the laws of averages of a continuous signal,
:math:`(2\ln 2/\pi)\,B^2` and :math:`K^2 m/3`; at one row they are 1.44 and 1.5 of them.
"""

from typing import Final

import numpy as np

from simval.shapes import Float, Int

FLOOR: Final = 2.0 * np.log(2.0) / np.pi  # of flicker, continuous
LONGEST: Final = 256
"""Rows of an average from which flicker is that of a continuous signal, to 3e-5."""


def sampled_allan_law(counts: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
    """Allan variance of samples that one unit of N^2, B^2 and K^2 leaves, eq. (N11)."""
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
