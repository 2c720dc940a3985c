r"""Parametrisations of a calibration's matrix, and the conversions between them.

A calibration maps a raw reading to specific force, :math:`f = M (y - B)`. Norms
alone fix :math:`M` up to a rotation, that is they fix :math:`A = M^T M`  (F1); each
form picks one :math:`M` out of that family, with six parameters, and three more
for :math:`B`:

- ``triangular``: :math:`M = T\,\mathrm{diag}(K)`, :math:`T` unit lower triangular
  with rows ``1``; ``S_yx 1``; ``-S_zx S_zy 1`` (the IMU-TK derivation);
- ``upper``: the same with :math:`T` unit upper triangular, plain entries
  ``T_xy T_xz T_yz`` (the published IMU-TK form);
- ``symmetric``: :math:`M = M^T`, entries ``k11 k12 k13 k22 k23 k33`` (the
  symmetric Gauss-Newton derivation).

All functions accept leading batch axes. The diagonal of :math:`M` is taken
positive: norms cannot tell the sign of an axis.

A gyroscope's matrix has nine entries. As others write it, each with its covariance,
these are, row by row,

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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

import numpy as np

from simval import vocabulary
from simval.arguments import choice
from simval.arrays import (
    GREATEST,
    Array,
    ReadOnly,
    finite_array,
    physical_array,
    shaped_array,
)
from simval.errors import InputError
from simval.geometry import axial, cross_matrix
from simval.shapes import Float, Inexact
from simval.vocabulary import Model

MODELS = vocabulary.MODELS

_SCALE_BIAS = ("K_x", "K_y", "K_z", "B_x", "B_y", "B_z")
_NAMES = {
    "triangular": ("S_yx", "S_zx", "S_zy", *_SCALE_BIAS),
    "upper": ("T_xy", "T_xz", "T_yz", *_SCALE_BIAS),
    "symmetric": ("k11", "k12", "k13", "k22", "k23", "k33", "b_x", "b_y", "b_z"),
}
# row, column and sign of each off-diagonal parameter of T
_OFF_DIAGONAL = {
    "triangular": ((1, 0, 1.0), (2, 0, -1.0), (2, 1, 1.0)),
    "upper": ((0, 1, 1.0), (0, 2, 1.0), (1, 2, 1.0)),
}
_SYMMETRIC = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def check_model(model: Any) -> Model:
    """Refuse a form that does not exist.

    Raises
    ------
    InputError
        If there is no such form.
    """
    return cast(Model, choice("model", model, MODELS))


def names(model: Model) -> tuple[str, ...]:
    """Names of the nine parameters in their order.

    Parameters
    ----------
    model : str
        Name of a form.

    Returns
    -------
    tuple of str
        Nine names.
    """
    return _NAMES[check_model(model)]


def entries(model: Model) -> tuple[tuple[str, float], ...]:
    """The parameters as entries of T, K and B, each with its sign."""
    known = tuple((name, 1.0) for name in names(model))
    if model == "symmetric":
        return known
    off = tuple((f"T[{i}][{j}]", sign) for i, j, sign in _OFF_DIAGONAL[model])
    return off + known[3:]


ENTRIES = {
    name: entry
    for model in MODELS
    for name, entry in zip(_NAMES[model], entries(model), strict=True)
}
"""Entry of T, K or B, with its sign, that a parameter's name stands for."""


def sign_notes(model: Model) -> list[str]:
    """Say which parameters have the opposite sign of the printed entry of T."""
    return [
        f"parameters[{place}], {names(model)[place]}, is -{entry}"
        for place, (entry, sign) in enumerate(entries(model))
        if sign < 0.0
    ]


def matrix(
    model: str, parameters: Inexact[Array, "... 9"]
) -> Inexact[Array, "... 3 3"]:
    """Matrix M of a form."""
    result = np.zeros((*parameters.shape[:-1], 3, 3), parameters.dtype)
    if model == "symmetric":
        for index, (row, column) in enumerate(_SYMMETRIC):
            result[..., row, column] = parameters[..., index]
            result[..., column, row] = parameters[..., index]
        return result
    for axis in range(3):
        result[..., axis, axis] = parameters[..., 3 + axis]
    for index, (row, column, sign) in enumerate(_OFF_DIAGONAL[model]):
        value = sign * parameters[..., index] * parameters[..., 3 + column]
        result[..., row, column] = value
    return result


def factors(
    model: str, parameters: Float[Array, "... 9"]
) -> tuple[Float[Array, "... 3 3"], Float[Array, "..."], Float[Array, "... 3"]]:
    """Factors T and K, and bias B, of a form."""
    bias = parameters[..., 6:].copy()
    misalignment = np.zeros((*parameters.shape[:-1], 3, 3)) + np.eye(3)
    if model == "symmetric":
        return misalignment, matrix(model, parameters), bias
    for index, (row, column, sign) in enumerate(_OFF_DIAGONAL[model]):
        misalignment[..., row, column] = sign * parameters[..., index]
    return misalignment, parameters[..., 3:6].copy(), bias


def from_factors(model: str, T: Any, K: Any, bias: Any) -> Float[Array, "9"] | None:
    """Parameters of a form from its factors, the inverse of `factors`."""
    misalignment, scale = physical_array("T", T, ()), physical_array("K", K, ())
    symmetric = model == "symmetric"
    if scale.shape != ((3, 3) if symmetric else (3,)) or misalignment.shape != (3, 3):
        return None
    parameters = np.empty(9)
    parameters[6:] = bias
    if symmetric:
        parameters[:6] = [scale[place] for place in _SYMMETRIC]
    else:
        parameters[:3] = [s * misalignment[i, j] for i, j, s in _OFF_DIAGONAL[model]]
        parameters[3:6] = scale
    made = factors(model, parameters)
    same = np.array_equal(made[0], misalignment) and np.array_equal(made[1], scale)
    return parameters if same else None


def matrix_derivatives(
    model: str, parameters: Inexact[Array, "... 9"]
) -> Inexact[Array, "... 6 3 3"]:
    """First derivatives of M by the six parameters that it depends on."""
    result = np.zeros((*parameters.shape[:-1], 6, 3, 3), parameters.dtype)
    if model == "symmetric":
        for index, (row, column) in enumerate(_SYMMETRIC):
            result[..., index, row, column] = 1.0
            result[..., index, column, row] = 1.0
        return result
    for axis in range(3):
        result[..., 3 + axis, axis, axis] = 1.0
    for index, (row, column, sign) in enumerate(_OFF_DIAGONAL[model]):
        result[..., index, row, column] = sign * parameters[..., 3 + column]
        result[..., 3 + column, row, column] = sign * parameters[..., index]
    return result


def matrix_second_derivatives(model: str) -> Float[Array, "6 6 3 3"]:
    """Second derivatives of M, the same for every value of the parameters."""
    result = np.zeros((6, 6, 3, 3))
    for index, (row, column, sign) in enumerate(_OFF_DIAGONAL.get(model, ())):
        result[index, 3 + column, row, column] = sign
        result[3 + column, index, row, column] = sign
    return result


def from_gram(
    model: str, gram: Float[Array, "... 3 3"], bias: Float[Array, "... 3"]
) -> Float[Array, "... 9"]:
    """Parameters of the form whose M has the given M'M, eq. (F1).

    The triangular forms are Cholesky factors (from the last axis up, or from the
    first down), the symmetric one is the square root.
    """
    result = np.empty((*gram.shape[:-2], 9))
    result[..., 6:] = bias
    if model == "symmetric":
        root = _square_root(gram)
        for index, (row, column) in enumerate(_SYMMETRIC):
            result[..., index] = root[..., row, column]
        return result
    flip = slice(None, None, -1) if model == "triangular" else slice(None)
    factor = _upper_factor(gram[..., flip, flip])[..., flip, flip]
    for axis in range(3):
        result[..., 3 + axis] = factor[..., axis, axis]
    for index, (row, column, sign) in enumerate(_OFF_DIAGONAL[model]):
        result[..., index] = (
            sign * factor[..., row, column] / factor[..., column, column]
        )
    return result


def _upper_factor(gram: Float[Array, "... 3 3"]) -> Float[Array, "... 3 3"]:
    # Upper triangular R with R'R = gram and a positive diagonal; NaN if none.
    factor = np.zeros_like(gram)
    with np.errstate(invalid="ignore", divide="ignore"):
        for i in range(3):
            row = gram[..., i, i:].copy()
            for k in range(i):
                row -= factor[..., k, i : i + 1] * factor[..., k, i:]
            row[..., 0] = np.sqrt(row[..., 0])
            row[..., 1:] /= row[..., :1]
            factor[..., i, i:] = row
    return factor


def _square_root(gram: Float[Array, "... 3 3"]) -> Float[Array, "... 3 3"]:
    # Symmetric positive definite square root; NaN where there is none.
    finite = np.asarray(np.isfinite(gram).all(axis=(-2, -1), keepdims=True))
    values, vectors = np.linalg.eigh(np.where(finite, gram, np.eye(3)))
    with np.errstate(invalid="ignore"):
        roots = np.where(finite[..., 0], np.sqrt(values), np.nan)
    return (vectors * roots[..., None, :]) @ vectors.mT


def gram_derivatives(
    model: str, parameters: Float[Array, "... 9"]
) -> Float[Array, "... 6 3 3"]:
    """Derivatives of A = M'M by the six parameters that it depends on."""
    slopes = matrix_derivatives(model, parameters)
    half = slopes.mT @ matrix(model, parameters)[..., None, :, :]
    return half + half.mT


def convert(
    parameters: Float[Array, "... 9"],
    covariance: Float[Array, "... 9 9"] | None,
    *,
    source: Model,
    target: Model,
) -> tuple[Array, Array | None]:
    """Convert a calibration, and its covariance, from one form to another.

    Exact: the ellipsoid A = M'M and the bias stay the same. The covariance is
    carried by the exact Jacobian at these parameters.

    Parameters
    ----------
    parameters : Array
        Nine parameters of the source form, (..., 9).
    covariance : Array or None
        Their covariance, (..., 9, 9), or None.
    source : str
        Form of `parameters`.
    target : str
        Form wanted.

    Returns
    -------
    parameters : Array
        Nine parameters of the target form, (..., 9).
    covariance : Array or None
        Their covariance, (..., 9, 9); None where None was given.

    Raises
    ------
    InputError
        If a form does not exist, or the parameters are those of no ellipsoid.
    """
    source, target = choice("source", source, MODELS), choice("target", target, MODELS)
    parameters = shaped_array("parameters", parameters, (9,))
    given = ~np.isnan(parameters).any(axis=-1)  # a refused trial of a batch is NaN
    physical_array("parameters", parameters[given], (9,), GREATEST**2)
    m = matrix(source, parameters)
    gram = m.mT @ m
    result = from_gram(target, gram, parameters[..., 6:])
    if not np.isfinite(result[given]).all():
        msg = (
            "`parameters` are those of no ellipsoid (a scale is 0, or the axes lie in "
            "a plane), which has no other form; calibrate again"
        )
        raise InputError(msg)
    if covariance is None:
        return result, None
    covariance = shaped_array("covariance", covariance, (9, 9))
    if covariance.shape[:-1] != parameters.shape:
        msg = (
            f"`covariance` has shape {covariance.shape} for parameters of shape "
            f"{parameters.shape}; give {(*parameters.shape, 9)}"
        )
        raise InputError(msg)
    finite_array("covariance", covariance[~np.isnan(covariance)], ())
    jacobian = conversion_jacobian(parameters, result, source=source, target=target)
    return result, jacobian @ covariance @ jacobian.mT


def conversion_jacobian(
    parameters: Float[Array, "... 9"],
    result: Float[Array, "... 9"],
    *,
    source: Model,
    target: Model,
) -> Float[Array, "... 9 9"]:
    """Derivative of the target's parameters by the source's.

    Both forms describe the same A, so ``dA_target d(target) = dA_source d(source)``,
    six equations in the six distinct entries of A.
    """
    rows, columns = np.array(_SYMMETRIC).T
    # (..., entry of A, parameter)
    from_source = gram_derivatives(source, parameters)[..., rows, columns].mT
    from_target = gram_derivatives(target, result)[..., rows, columns].mT
    jacobian = np.zeros((*parameters.shape[:-1], 9, 9)) + np.eye(9)
    jacobian[..., :6, :6] = np.linalg.solve(from_target, from_source)
    return jacobian


Factors = Literal["misalignment-scale", "kalibr", "polar"]
FACTORS = get_args(Factors)
_OFF = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
_LOWER = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))
_AXES = "xyz"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GyroscopeFactors(ReadOnly):
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

    form: Factors
    shape: Float[Array, "3 3"]
    rest: Float[Array, "3 3"]
    names: tuple[str, ...]
    values: Float[Array, "9"]
    covariance: Float[Array, "9 9"]

    @property
    def sd(self) -> Float[Array, "9"]:
        """Standard deviations, (9,)."""
        return np.sqrt(np.diagonal(self.covariance))


def gyroscope_factors(
    M: Any, covariance: Any = None, *, form: Factors = "misalignment-scale"
) -> GyroscopeFactors:
    """Write a gyroscope's matrix in another form, with its covariance.

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

    def derivative(dM: Array) -> tuple[Array, Array]:
        X = np.linalg.solve(L, -inverse @ dM @ inverse) @ C.T
        turn = np.array([-X[1, 2], X[0, 2], -X[0, 1]])
        return L @ (X - cross_matrix(turn)), turn

    return _turned("L", L, C, _LOWER, derivative)


def _polar(M: Float[Array, "3 3"]) -> _Made:
    left, stretch, right = np.linalg.svd(M)
    C = left @ right
    S = right.T @ np.diag(stretch) @ right
    P = C @ S @ C.T

    def derivative(dM: Array) -> tuple[Array, Array]:
        turn = np.linalg.solve(np.trace(P) * np.eye(3) - P, axial(dM @ C.T))
        return C.T @ (dM - cross_matrix(turn) @ M), turn

    return _turned("S", S, C, _SYMMETRIC, derivative)


def _turned(
    letter: str,
    shape: Float[Array, "3 3"],
    C: Float[Array, "3 3"],
    places: tuple[tuple[int, int], ...],
    derivative: Callable[[Array], tuple[Array, Array]],
) -> _Made:
    # a shape and a rotation, whose small angles are 0
    slopes = [derivative(dM) for dM in np.eye(9).reshape(9, 3, 3)]
    columns = [[*(dS[place] for place in places), *turn] for dS, turn in slopes]
    names = [f"{letter}_{_AXES[i]}{_AXES[j]}" for i, j in places]
    names += [f"angle_{axis}" for axis in _AXES]
    values = np.array([shape[place] for place in places] + [0.0] * 3)
    return shape, C, tuple(names), values, np.transpose(columns)
