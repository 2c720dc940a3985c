r"""The residual as a quadric in the reading, and its derivatives.

With :math:`A = M^T M` the residual of all three derivations is

.. math:: c(y) = |M (y - b)|^2 - 1 = m(y)^T v(\theta)  \tag{Q1}

in units where gravity is 1: :math:`m` are the ten monomials of the reading,
:math:`v` ten coefficients. So every sum over poses of products of :math:`c` and
its derivatives is a form in the moment matrix :math:`G = \sum_k w_k m_k m_k^T`
(Q2): one pass over the data, then each iteration costs the same for any number of
samples. The weighted-distance residual also needs :math:`q(y) = |M^T M (y - b)|^2`,
the quadric of :math:`A^2`, without the constant.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.calibrate.moments import CHUNK, PAIRS, monomials
from simval.sensor import forms
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Quadric:
    """A quadric's coefficients with their derivatives by the nine parameters."""

    gram: Float[Array, "t 3 3"]  # the quadratic part
    # its derivatives by the first six parameters, or by none of them
    slopes: Float[Array, "t k 3 3"]
    bias: Float[Array, "t 3"]  # the centre
    values: Float[Array, "t 10"]  # the ten coefficients v


def residual_quadric(model: str, theta: Float[Array, "t 9"]) -> Quadric:
    """The quadric c of eq. (Q1)."""
    m = forms.matrix(model, theta)
    gram = np.swapaxes(m, -1, -2) @ m
    slopes = forms.gram_derivatives(model, theta)
    return _quadric(gram, slopes, theta[:, 6:], constant=-1.0)


def distance_quadric(residual: Quadric) -> Quadric:
    """The quadric q = |M'M (y - b)|^2, a quarter of the squared gradient of c."""
    half = residual.slopes @ residual.gram[:, None]
    slopes = half + np.swapaxes(half, -1, -2)
    gram = residual.gram @ residual.gram
    return _quadric(gram, slopes, residual.bias, constant=0.0)


def _quadric(
    gram: Float[Array, "t 3 3"],
    slopes: Float[Array, "t k 3 3"],
    bias: Float[Array, "t 3"],
    *,
    constant: float,
) -> Quadric:
    linear = np.matvec(gram, bias)
    values = np.empty((gram.shape[0], 10))
    for axis in range(3):
        values[:, axis] = gram[:, axis, axis]
    for index, (i, j) in enumerate(PAIRS):
        values[:, 3 + index] = 2.0 * gram[:, i, j]
    values[:, 6:9] = -2.0 * linear
    values[:, 9] = np.vecdot(bias, linear) + constant
    return Quadric(gram=gram, slopes=slopes, bias=bias, values=values)


def residual_values(
    model: str, theta: Float[Array, "t 9"], z: Float[Array, "t n 3"]
) -> tuple[Float[Array, "t n"], Float[Array, "t n"]]:
    """The quadrics c and q of each reading, without derivatives."""
    m = forms.matrix(model, theta)
    h = m @ (np.ascontiguousarray(np.swapaxes(z, -1, -2)) - theta[:, 6:, None])
    return _squared(h) - 1.0, _squared(np.swapaxes(m, -1, -2) @ h)


def _squared(x: Float[Array, "t 3 n"]) -> Float[Array, "t n"]:
    return x[:, 0] * x[:, 0] + x[:, 1] * x[:, 1] + x[:, 2] * x[:, 2]


def evaluate(
    quadrics: Sequence[Quadric], z: Float[Array, "t n 3"]
) -> list[Float[Array, "t n"]]:
    """Values of some quadrics at each reading, in one pass."""
    columns = np.stack([quadric.values for quadric in quadrics], axis=-1)
    result = np.empty((len(quadrics), *z.shape[:-1]))
    for start in range(0, z.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        values = monomials(z[:, part]) @ columns
        result[:, :, part] = np.moveaxis(values, -1, 0)
    return list(result)


def value_derivatives(quadric: Quadric) -> Float[Array, "t 10 9"]:
    """Derivatives of the ten coefficients by the nine parameters."""
    result = np.zeros((quadric.gram.shape[0], 10, 9))
    slopes, bias = quadric.slopes, quadric.bias
    for axis in range(3):
        result[:, axis, :6] = slopes[:, :, axis, axis]
    for index, (i, j) in enumerate(PAIRS):
        result[:, 3 + index, :6] = 2.0 * slopes[:, :, i, j]
    linear = np.matvec(slopes, bias[:, None])  # (t, 6, 3)
    result[:, 6:9, :6] = -2.0 * np.swapaxes(linear, -1, -2)
    result[:, 9, :6] = np.vecdot(linear, bias[:, None])
    result[:, 6:9, 6:] = -2.0 * quadric.gram
    result[:, 9, 6:] = 2.0 * np.matvec(quadric.gram, bias)
    return result


def curvature(
    quadric: Quadric, seconds: Float[Array, "t 6 6 3 3"], weights: Float[Array, "t 10"]
) -> Float[Array, "t 9 9"]:
    r"""Weighted sum of the second derivatives of the ten coefficients.

    With the weights folded into a symmetric matrix :math:`S` (quadratic part), a
    vector :math:`l` and a constant :math:`s_0`, the sum :math:`s^T v` is

    .. math:: \mathrm{tr}(A W) + \mathrm{const}, \quad
       W = S - b l^T - l b^T + s_0 b b^T  \tag{Q3}

    so the derivatives are tr(d2A W) by two parameters of A, -2 dA (l - s_0 b) by
    one of them and b, and 2 s_0 A by b twice.
    """
    bias, linear, constant = quadric.bias, weights[:, 6:9], weights[:, 9]
    w = np.zeros_like(quadric.gram)
    for axis in range(3):
        w[:, axis, axis] = weights[:, axis]
    for index, (i, j) in enumerate(PAIRS):
        w[:, i, j] = w[:, j, i] = weights[:, 3 + index]
    outer = bias[:, :, None] * linear[:, None, :]
    w -= outer + np.swapaxes(outer, -1, -2)
    w += constant[:, None, None] * bias[:, :, None] * bias[:, None, :]
    rest = linear - constant[:, None] * bias
    result = np.empty((bias.shape[0], 9, 9))
    result[:, :6, :6] = (seconds * w[:, None, None]).sum(axis=(-2, -1))
    mixed = -2.0 * np.matvec(quadric.slopes, rest[:, None])
    result[:, :6, 6:] = mixed
    result[:, 6:, :6] = np.swapaxes(mixed, -1, -2)
    result[:, 6:, 6:] = 2.0 * constant[:, None, None] * quadric.gram
    return result


def residual_seconds(
    model: str, theta: Float[Array, "t 9"]
) -> Float[Array, "t 6 6 3 3"]:
    """Second derivatives of A = M'M by the first six parameters."""
    m = forms.matrix(model, theta)[:, None, None]
    first = forms.matrix_derivatives(model, theta)
    bent = np.swapaxes(forms.matrix_second_derivatives(model), -1, -2) @ m
    crossed = np.swapaxes(first, -1, -2)[:, :, None] @ first[:, None]
    half = bent + crossed
    return half + np.swapaxes(half, -1, -2)


def distance_seconds(
    residual: Quadric, seconds: Float[Array, "t 6 6 3 3"]
) -> Float[Array, "t 6 6 3 3"]:
    """Second derivatives of A^2 by the first six parameters."""
    half = seconds @ residual.gram[:, None, None]
    half += residual.slopes[:, :, None] @ residual.slopes[:, None]
    return half + np.swapaxes(half, -1, -2)
