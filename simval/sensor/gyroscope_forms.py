r"""A gyroscope's matrix as others write it, each with its covariance.

The nine entries of M, row by row, are

- ``misalignment-scale``: :math:`M = T\,\mathrm{diag}(K)`, T with a unit diagonal
  (IMU-TK's six misalignments and three scales);
- ``kalibr``: :math:`M^{-1} = L\,C`, L lower triangular with a positive diagonal and C a
  rotation from the accelerometer's axes to the gyroscope's (Kalibr's ``M`` and
  ``C_gyro_i``; for M itself the factors are an upper triangle after a rotation, RQ);
- ``polar``: :math:`M = C S`, S symmetric, C the nearest rotation.

Covariances are carried by the exact derivative. A rotation has three small angles, of
:math:`\exp([\omega\times])\,C`, axes after the rotation. With :math:`X = L^{-1}
\mathrm{d}(M^{-1}) C^T` the part above the diagonal is that of :math:`[\omega\times]`,
and :math:`\mathrm{d}L = L (X - [\omega\times])`; with :math:`X = \mathrm{d}M\,C^T` and
:math:`P = C S C^T`, :math:`X - X^T = [(\mathrm{tr}P\,I - P)\,\omega \times]`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arguments import choice
from simval.arrays import GREATEST, Array, frozen, physical_array
from simval.errors import InputError
from simval.geometry import cross_matrix
from simval.shapes import Float

FACTORS = ("misalignment-scale", "kalibr", "polar")
_OFF = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
_LOWER = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))
_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_AXES = "xyz"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopeFactors:
    """A gyroscope's matrix in two factors.

    Attributes
    ----------
    form : str
        misalignment-scale, kalibr or polar.
    shape : Array
        T, L or S, (3, 3).
    rest : Array
        diag(K), or the rotation C, (3, 3).
    names : tuple of str
        Names of the nine values.
    values : Array
        Six of the shape and three scales, or three angles that are 0, (9,).
    covariance : Array
        Their covariance, (9, 9); NaN where none was given.
    """

    form: str
    shape: Float[Array, "3 3"]
    rest: Float[Array, "3 3"]
    names: tuple[str, ...]
    values: Float[Array, "9"]
    covariance: Float[Array, "9 9"]

    def __post_init__(self) -> None:
        for name in ("shape", "rest", "values", "covariance"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def sd(self) -> Float[Array, "9"]:
        """Standard deviations, (9,)."""
        return np.sqrt(np.diagonal(self.covariance))


def gyroscope_factors(
    M: Any, covariance: Any = None, *, form: str = "misalignment-scale"
) -> GyroscopeFactors:
    """Write a gyroscope's matrix in another form, covariance carried along.

    Parameters
    ----------
    M : array_like
        Raw units to rad/s, (3, 3).
    covariance : array_like, optional
        Of its nine entries row by row, (9, 9).
    form : {"misalignment-scale", "kalibr", "polar"}
        Form wanted.

    Returns
    -------
    GyroscopeFactors
        The factors.

    Raises
    ------
    InputError
        If M has no such form: a diagonal entry is 0, or the determinant is not above 0.
    """
    form = choice("form", form, FACTORS)
    M = physical_array("M", M, (3, 3), GREATEST**2)
    cov = np.full((9, 9), np.nan)
    if covariance is not None:
        cov = physical_array("covariance", covariance, (9, 9), GREATEST**4)
    if M.shape != (3, 3) or cov.shape != (9, 9):
        msg = f"`M` has shape {M.shape}, its covariance {cov.shape}; give one sensor's"
        raise InputError(msg)
    sound = np.linalg.det(M) > 0.0 if form != FACTORS[0] else np.diagonal(M).all()
    if not sound:
        msg = (
            f"`M` has no form {form}: its determinant is {np.linalg.det(M):.2g}, its "
            f"diagonal {np.diagonal(M)}; the axes must be right-handed, and each scale "
            "other than 0, so look for swapped axes"
        )
        raise InputError(msg)
    made = {"misalignment-scale": _scaled, "kalibr": _kalibr, "polar": _polar}[form](M)
    shape, rest, names, values, jacobian = made
    return GyroscopeFactors(
        form=form,
        shape=shape,
        rest=rest,
        names=names,
        values=values,
        covariance=jacobian @ cov @ jacobian.T,
    )


_Made = tuple[Array, Array, tuple[str, ...], Array, Array]


def _scaled(M: Float[Array, "3 3"]) -> _Made:
    K = np.diagonal(M)
    T = M / K
    jacobian = np.zeros((9, 9))
    for row, (i, j) in enumerate(_OFF):
        jacobian[row, 3 * i + j] = 1.0 / K[j]
        jacobian[row, 4 * j] = -T[i, j] / K[j]
    jacobian[range(6, 9), [0, 4, 8]] = 1.0
    names = [f"T_{_AXES[i]}{_AXES[j]}" for i, j in _OFF] + [f"K_{a}" for a in _AXES]
    values = np.array([T[place] for place in _OFF] + list(K))
    return T, np.diag(K), tuple(names), values, jacobian


def _kalibr(M: Float[Array, "3 3"]) -> _Made:
    inverse = np.linalg.inv(M)
    L = np.linalg.cholesky(inverse @ inverse.T)
    C = np.linalg.solve(L, inverse)
    jacobian = np.zeros((9, 9))
    for column in range(9):
        dM = np.zeros((3, 3))
        dM.flat[column] = 1.0
        X = np.linalg.solve(L, -inverse @ dM @ inverse) @ C.T
        turn = np.array([-X[1, 2], X[0, 2], -X[0, 1]])
        dL = L @ (X - cross_matrix(turn))
        jacobian[:, column] = [*(dL[place] for place in _LOWER), *turn]
    return L, C, _names("L", _LOWER), _values(L, _LOWER), jacobian


def _polar(M: Float[Array, "3 3"]) -> _Made:
    left, stretch, right = np.linalg.svd(M)
    C = left @ right
    S = right.T @ np.diag(stretch) @ right
    P = C @ S @ C.T
    jacobian = np.zeros((9, 9))
    for column in range(9):
        dM = np.zeros((3, 3))
        dM.flat[column] = 1.0
        X = dM @ C.T
        axial = np.array([X[2, 1] - X[1, 2], X[0, 2] - X[2, 0], X[1, 0] - X[0, 1]])
        turn = np.linalg.solve(np.trace(P) * np.eye(3) - P, axial)
        dS = C.T @ (dM - cross_matrix(turn) @ M)
        jacobian[:, column] = [*(dS[place] for place in _UPPER), *turn]
    return S, C, _names("S", _UPPER), _values(S, _UPPER), jacobian


def _names(letter: str, places: Any) -> tuple[str, ...]:
    shape = [f"{letter}_{_AXES[i]}{_AXES[j]}" for i, j in places]
    return (*shape, *(f"angle_{a}" for a in _AXES))


def _values(shape: Float[Array, "3 3"], places: Any) -> Float[Array, "9"]:
    return np.array([shape[place] for place in places] + [0.0] * 3)
