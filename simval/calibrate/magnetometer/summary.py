r"""Covariance, chi-square and the checks that decide whether a fit is a calibration.

The natural size of an error of the magnetometer is that of the corrected field:
:math:`E = dM\, M^{-1}`, :math:`M\, db` and ds, all relative to the strength of the
field; the same holds for the accelerometer with gravity.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import scipy

from simval.arrays import Array
from simval.calibrate.evidence import WIDEST
from simval.calibrate.magnetometer.equations import (
    ACCELEROMETER,
    DIP,
    IRON,
    MATRIX,
    PARAMETERS,
    Corrected,
    Readings,
    corrected,
)
from simval.calibrate.magnetometer.solver import Local, Prior, local
from simval.calibrate.positive import solve_positive
from simval.sensor import forms
from simval.shapes import Float

LEAST_COSINE = 0.01
"""Of the dip. At 89.4 degrees the horizontal field is 1 % of the whole: the noise of a
good magnetometer. Up to 89 degrees all are alike (docs/magnetometer.md)."""
_SDS = 5.0  # standard deviations that the dip must be from 90 degrees, or from 0
_LEAST_PIVOT = 1e-14  # squared sine of a column on the others; rounding leaves 1e-16
_TAIL = 1e-3  # of the chi-square, beyond which the scatter seen widens the bars judged
_NORMAL_95 = 1.96


class Code(IntEnum):
    """How a trial ended."""

    CONVERGED = 0
    MAX_ITERATIONS = 1
    NON_FINITE = 2
    RANK = 3
    VERTICAL = 4
    WIDE = 5
    HEMISPHERE = 6
    AMBIGUOUS = 7


STATUS_NAMES = np.array(
    [
        "converged",
        "max iterations",
        "refused: non-finite readings",
        "refused: rank below 22",
        "refused: field along the vertical",
        "refused: error bars too wide",
        "refused: the dip does not tell the hemisphere",
        "refused: two calibrations fit alike",
    ]
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Summary:
    """What is known at the end of a fit, in its scaled units."""

    at: Corrected
    here: Local
    covariance: Float[Array, "t 22 22"]  # NaN where the rank is below 22
    chi_square: Float[Array, " t"]
    # greatest natural half-width of a 95 % interval, and of which parameter it is
    half_width: Float[Array, " t"]
    widest: Any  # index, (t,)
    full_rank: Any  # bool, (t,)


def summarize(
    model: str,
    theta: Float[Array, "t 22"],
    readings: Readings,
    prior: Prior | None,
    dof: int,
) -> Summary:
    """Work out covariance and evidence at the solutions."""
    with np.errstate(all="ignore"):  # hopeless trials are NaN
        here = local(model, theta, readings, prior)
        at = corrected(model, theta, readings)
        normal = here.normal
        one = np.broadcast_to(np.eye(PARAMETERS), normal.shape)
        covariance, pivot = solve_positive(normal, one)
        covariance = (covariance + np.swapaxes(covariance, -1, -2)) / 2.0
        full = np.asarray(pivot > _LEAST_PIVOT, dtype=bool)
        covariance[~full] = np.nan
        chi_square = np.vecdot(here.rows, here.rows)
        natural = natural_sd(model, theta, at, covariance)
        half = _NORMAL_95 * natural * seen_over_stated(chi_square, dof)[:, None]
    half = np.where(np.isfinite(half), half, np.inf)
    widest = np.argmax(half, axis=1)
    return Summary(
        at=at,
        here=here,
        covariance=covariance,
        chi_square=chi_square,
        half_width=np.max(half, axis=1),
        widest=widest,
        full_rank=full,
    )


def seen_over_stated(chi_square: Float[Array, " t"], dof: int) -> Float[Array, " t"]:
    """Factor by which the scatter seen exceeds the noise stated, 1 where chance can."""
    if dof <= 0:
        return np.ones(len(chi_square))
    limit = 2.0 * scipy.special.gammaincinv(dof / 2.0, 1.0 - _TAIL)
    return np.where(chi_square > limit, np.sqrt(chi_square / dof), 1.0)


def natural_sd(
    model: str, theta: Array, at: Corrected, covariance: Array
) -> Float[Array, "t 25"]:
    """Standard deviations of E, M db of both sensors and ds: natural sizes."""
    count = len(theta)
    carry = np.zeros((count, 25, PARAMETERS))
    bad = np.asarray(~np.isfinite(theta).all(axis=1))
    eye = np.eye(3)
    matrix_a = np.where(bad[:, None, None], eye, at.matrix_a)
    matrix_m = np.where(bad[:, None, None], eye, at.matrix_m)
    slopes = forms.matrix_derivatives(model, theta[:, ACCELEROMETER])
    moved = slopes @ np.linalg.pinv(matrix_a)[:, None]
    carry[:, :9, :6] = np.swapaxes(moved.reshape(count, 6, 9), -1, -2)
    carry[:, 9:12, 6:9] = at.matrix_a
    inverse = np.linalg.pinv(matrix_m)
    for row in range(3):  # a row of dM times the inverse
        rows = slice(12 + 3 * row, 15 + 3 * row)
        columns = slice(MATRIX.start + 3 * row, MATRIX.start + 3 * row + 3)
        carry[:, rows, columns] = np.swapaxes(inverse, -1, -2)
    carry[:, 21:24, IRON] = at.matrix_m
    carry[:, 24, DIP] = 1.0
    return np.sqrt(np.einsum("tij,tjk,tik->ti", carry, covariance, carry))


def judge(
    summary: Summary, theta: Float[Array, "t 22"], converged: Any, hemisphere: str
) -> Any:
    """Code of each trial from its fit."""
    sine = theta[:, DIP]
    with np.errstate(invalid="ignore"):
        sd = np.sqrt(summary.covariance[:, DIP, DIP])
        cosine = np.sqrt(np.maximum(1.0 - sine**2, 0.0))
        # an error of the sine is one of the dip times the cosine
        vertical = ~(cosine > LEAST_COSINE) | ~(cosine**2 > _SDS * sd)
        weak = ~(np.abs(sine) > _SDS * sd)
    near = np.abs(sine) < 1.0 + LEAST_COSINE  # beyond, the poses fit no field at all
    wide = ~(summary.half_width <= WIDEST)
    code = np.where(converged, int(Code.CONVERGED), int(Code.MAX_ITERATIONS))
    if hemisphere != "unstated":
        code = np.where(weak, int(Code.HEMISPHERE), code)
    code = np.where(wide, int(Code.WIDE), code)
    steep = ~(cosine > LEAST_COSINE)
    code = np.where(vertical & ~wide | steep & near, int(Code.VERTICAL), code)
    return np.where(~summary.full_rank & ~(steep & near), int(Code.RANK), code)
