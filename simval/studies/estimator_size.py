r"""How large an estimator's errors are: RMS, efficiency, difference from least squares.

With m the mean square of its errors and :math:`m_0` that of the built-in least squares
under the same noise, the efficiency is the trace of the Cramer-Rao bound over m, and
the difference :math:`\sqrt m - \sqrt{m_0}`. Cubature gives both without chance, to
twice what its next lower degree differs by. Simulated they are a check of that; since
both estimators see the same vectors the difference has a small standard error, by

.. math:: \frac12 \left(\frac{dm}{\sqrt m} - \frac{dm_0}{\sqrt{m_0}}\right), \tag{D1}

and at least by the rounding of one estimate.
"""

import numpy as np

from simval.arrays import Array
from simval.montecarlo import Sums, mean_square, moments_of
from simval.results import Row, plain, unjudged
from simval.shapes import Float
from simval.statistics import (
    CRAMER_RAO,
    CUBATURE,
    EFFICIENCY,
    RMS,
    RMS_DIFFERENCE,
    SQUARED_ERROR,
)
from simval.studies.estimator_setting import SQUARES, Moments, Setting

_EPS = float(np.finfo(float).eps)

SAME = 1e-9
"""Relative difference of two RMS errors that may be rounding."""

_CLEARLY = 3.0
"""A spread of so many remainders is enough to judge: twice is required."""


def size_rows(
    setting: Setting,
    sums: Sums,
    noise: float,
    cubatures: tuple[Moments, Moments],
    rounding: float,
) -> tuple[Row, ...]:
    """Rows of sums, beside cubature and the next lower one; `rounding` in rad."""
    weight = np.zeros((sums.size, sums.size))
    weight[:3, :3] = np.eye(3)
    square, error = mean_square(sums, weight)
    least, n = float(np.trace(setting.bound(noise))), sums.samples
    rms = float(np.sqrt(square))
    fine, coarse = (moments[0][SQUARES] for moments in cubatures)
    efficiency = least / float(fine[0])
    left = 2.0 * abs(efficiency - least / float(coarse[0]))
    return (
        *unjudged(
            RMS(unit="rad"), rms, error / (2.0 * rms), n, np.sqrt(least), CRAMER_RAO
        ),
        *unjudged(EFFICIENCY(), efficiency, remainder=left),
        *_tail_row(square, n, cubatures),
        *plain(
            EFFICIENCY("simulated"), least / square, least * error / square**2, n,
            efficiency, CUBATURE, left,
        ),
        *_difference_rows(sums, fine, coarse, max(rounding, _EPS), setting.weights),
    )  # fmt: skip


def _tail_row(
    square: float, n: int, cubatures: tuple[Moments, Moments]
) -> tuple[Row, ...]:
    """Mean square over cubature's, with the standard error that cubature gives it.

    The trials' own is no measure: rare ones that are far off make both great.
    """
    (mean, covariance), (coarse, _) = cubatures
    fine = float(mean[SQUARES][0])
    gaussian = 2.0 * float(np.sum(covariance[:3, :3] ** 2))
    variance = max(gaussian, float(covariance[SQUARES, SQUARES][0, 0]))
    return plain(
        SQUARED_ERROR(), square / fine, np.sqrt(variance / n) / fine, n,
        1.0, CUBATURE, 2.0 * abs(1.0 - float(coarse[SQUARES][0]) / fine),
    )  # fmt: skip


def _difference_rows(
    sums: Sums,
    fine: Float[Array, "2"],
    coarse: Float[Array, "2"],
    rounding: float,
    weights: float,
) -> tuple[Row, ...]:
    measured = moments_of(sums)
    squares = measured.bias[SQUARES]
    slope = np.array([0.5, -0.5]) / np.sqrt(squares)
    variance = float(slope @ measured.covariance[SQUARES, SQUARES] @ slope)
    predicted = _difference(fine)
    unresolved, rounded = 2.0 * abs(predicted - _difference(coarse)), weights * rounding
    left = unresolved + rounded
    spread = max(variance, rounding**2 * sums.samples)
    # what differs by rounding, its own or of cubature, is judged by it
    if unresolved < max(rounded, SAME * np.sqrt(squares[1])):
        spread = max(spread, (_CLEARLY * left) ** 2)
    return plain(
        RMS_DIFFERENCE(), _difference(squares), np.sqrt(spread / sums.samples),
        sums.samples, predicted, CUBATURE, left,
    )  # fmt: skip


def _difference(squares: Float[Array, "2"]) -> float:
    own, other = np.sqrt(squares)
    return float(own - other)
