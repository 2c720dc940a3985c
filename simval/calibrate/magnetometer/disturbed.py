r"""Poses that do not fit the others, and a field that varies with time.

With :math:`P = (J^T W J)^{-1}` the three residuals of a pose have the covariance
:math:`W_i^{-1} - J_i P J_i^T`, and

.. math:: t_i = c_i^T (W_i^{-1} - J_i P J_i^T)^{-1} c_i \sim \chi^2(3)  \tag{M5}

is at the same time what leaving the pose out takes off the total. Poses are left out
one by one, the worst first, while it is beyond chance for the worst of n.

A strength of the field that varies as :math:`1 + \sum_j \kappa_j P_j(\tau)`, Legendre
polynomials of degree 1 to 3 over the time of the poses, adds the columns
:math:`\partial c/\partial \kappa_j = P_j(\tau) [0, -2, s]`; the chi-square of the three
:math:`\kappa` beside all 22 parameters says whether it does, over their scatter
where that is more than the noise  (M6).
"""

from dataclasses import dataclass

import numpy as np
import scipy

from simval.arrays import Array
from simval.calibrate.magnetometer.equations import DIP, PARAMETERS
from simval.calibrate.magnetometer.solver import Local
from simval.shapes import Float

FALSE_ALARM = 0.01
"""Of a clean set: that a pose of it is named, or that its field is called varying."""
_FREE = 1e-9  # share of a residual that its own fit leaves; below it says nothing
_DEGREE = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trend:
    """How the strength of the field varies with time, eq. (M6)."""

    span: float  # greatest less least strength over the poses, relative
    chi_square: float  # what it takes off the total
    p_value: float  # that a steady field shows as much; 1 where it cannot be seen


def pose_chi_squares(here: Local, covariance: Float[Array, "22 22"]) -> Array:
    """Chi-square of each pose of one trial, eq. (M5); NaN where none is left."""
    count = here.whiten.shape[1]
    slopes = here.slopes[0, : 3 * count].reshape(count, 3, PARAMETERS)
    rows = here.rows[0, : 3 * count].reshape(count, 3)
    left = np.eye(3) - slopes @ covariance @ np.swapaxes(slopes, -1, -2)
    values, vectors = np.linalg.eigh(left)
    along = np.vecmat(rows, vectors)
    seen = np.where(values > _FREE, along**2 / np.maximum(values, _FREE), 0.0)
    return np.where(values[:, 0] > _FREE, seen.sum(axis=1), np.nan)


def chance_limit(count: int) -> float:
    """Chi-square of three that the worst of a clean set's poses exceeds by chance."""
    return float(2.0 * scipy.special.gammainccinv(1.5, FALSE_ALARM / count))


def trend(
    here: Local,
    theta: Float[Array, "22"],
    covariance: Float[Array, "22 22"],
    time: Float[Array, " n"],
    dof: int,
) -> Trend:
    """How the strength of the field of one trial varies with time, eq. (M6)."""
    count = here.whiten.shape[1]
    whole = np.zeros((len(here.rows[0]), _DEGREE))
    tau = 2.0 * (time - time.min()) / np.ptp(time) - 1.0
    basis = np.polynomial.legendre.legvander(tau, _DEGREE)[:, 1:]
    column = here.whiten[0] @ np.array([0.0, -2.0, theta[DIP]])
    whole[: 3 * count] = (column[:, :, None] * basis[:, None, :]).reshape(-1, _DEGREE)
    slopes, rows = here.slopes[0], here.rows[0]
    # what is left of the columns beside the 22 parameters
    own = whole - slopes @ (covariance @ (slopes.T @ whole))
    normal = own.T @ whole
    if not np.linalg.eigvalsh(normal)[0] > _FREE * np.trace(whole.T @ whole):
        return Trend(span=0.0, chi_square=0.0, p_value=1.0)
    kappa = -np.linalg.solve(normal, own.T @ rows)
    chi_square = float(kappa @ normal @ kappa)
    # beside scatter that the noise does not explain, it is judged by that scatter
    rest = (float(rows @ rows) - chi_square) / max(dof - _DEGREE, 1)
    if rest > 1.0:
        ratio = chi_square / rest / _DEGREE
        p_value = scipy.special.fdtrc(_DEGREE, max(dof - _DEGREE, 1), ratio)
    else:
        p_value = scipy.special.gammaincc(_DEGREE / 2.0, chi_square / 2.0)
    return Trend(
        span=float(np.ptp(basis @ kappa)), chi_square=chi_square, p_value=float(p_value)
    )
