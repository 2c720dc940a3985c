r"""The three ways to write the matrix of a calibration, and the conversions.

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
"""

from typing import Any

import numpy as np

from simval import vocabulary
from simval.arguments import choice
from simval.arrays import GREATEST, Array, finite_array, physical_array, shaped_array
from simval.errors import InputError
from simval.shapes import Float, Inexact

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


def check_model(model: str) -> str:
    """Refuse a form that does not exist.

    Raises
    ------
    InputError
        If there is no such form.
    """
    return str(choice("model", model, MODELS))


def names(model: str) -> tuple[str, ...]:
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


def entries(model: str) -> tuple[tuple[str, float], ...]:
    """The parameters as entries of T, K and B, each with its sign."""
    known = tuple((name, 1.0) for name in names(model))
    if model == "symmetric":
        return known
    off = tuple((f"T[{i}][{j}]", sign) for i, j, sign in _OFF_DIAGONAL[model])
    return off + known[3:]


def sign_notes(model: str) -> list[str]:
    """Say which parameters are minus the entry of T that is printed."""
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
            for j in range(i, 3):
                rest = gram[..., i, j].copy()
                for k in range(i):
                    rest -= factor[..., k, i] * factor[..., k, j]
                factor[..., i, j] = (
                    np.sqrt(rest) if i == j else rest / factor[..., i, i]
                )
    return factor


def _square_root(gram: Float[Array, "... 3 3"]) -> Float[Array, "... 3 3"]:
    # Symmetric positive definite square root; NaN where there is none.
    finite = np.asarray(np.isfinite(gram).all(axis=(-2, -1), keepdims=True))
    values, vectors = np.linalg.eigh(np.where(finite, gram, np.eye(3)))
    with np.errstate(invalid="ignore"):
        roots = np.where(finite[..., 0], np.sqrt(values), np.nan)
    return (vectors * roots[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def gram_derivatives(
    model: str, parameters: Float[Array, "... 9"]
) -> Float[Array, "... 6 3 3"]:
    """Derivatives of A = M'M by the six parameters that it depends on."""
    slopes = matrix_derivatives(model, parameters)
    half = np.swapaxes(slopes, -1, -2) @ matrix(model, parameters)[..., None, :, :]
    return half + np.swapaxes(half, -1, -2)


def convert(
    parameters: Float[Array, "... 9"],
    covariance: Float[Array, "... 9 9"] | None,
    *,
    source: str,
    target: str,
) -> tuple[Array, Array | None]:
    """Carry a calibration, and its covariance, from one form to another.

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
    gram = np.swapaxes(m, -1, -2) @ m
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
    return result, jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)


def conversion_jacobian(
    parameters: Float[Array, "... 9"],
    result: Float[Array, "... 9"],
    *,
    source: str,
    target: str,
) -> Float[Array, "... 9 9"]:
    """Derivative of the target's parameters by the source's.

    Both forms describe the same A, so ``dA_target d(target) = dA_source d(source)``,
    six equations in the six distinct entries of A.
    """
    rows, columns = np.array(_SYMMETRIC).T
    # (..., entry of A, parameter)
    from_source = np.swapaxes(
        gram_derivatives(source, parameters)[..., rows, columns], -1, -2
    )
    from_target = np.swapaxes(
        gram_derivatives(target, result)[..., rows, columns], -1, -2
    )
    jacobian = np.zeros((*parameters.shape[:-1], 9, 9)) + np.eye(9)
    jacobian[..., :6, :6] = np.linalg.solve(from_target, from_source)
    return jacobian
