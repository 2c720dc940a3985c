r"""Moments of the readings: one pass over the data, then none.

The residual of a calibration is linear in ten monomials of the reading (`quadric`), so
every sum over poses that a step needs is a form in the moment matrix

.. math:: G = \sum_k w_k\, m_k m_k^T.  \tag{Q2}
"""

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

CHUNK = 1 << 15  # samples of one pass; 2.6 MB of monomials
PAIRS = ((0, 1), (0, 2), (1, 2))
_EXPONENTS = (
    (2, 0, 0),
    (0, 2, 0),
    (0, 0, 2),
    (1, 1, 0),
    (1, 0, 1),
    (0, 1, 1),
    (1, 0, 0),
    (0, 1, 0),
    (0, 0, 1),
    (0, 0, 0),
)


def monomials(z: Float[Array, "... 3"]) -> Float[Array, "... 10"]:
    """The ten monomials xx yy zz xy xz yz x y z 1 of a reading."""
    result = np.empty((*z.shape[:-1], 10))
    np.multiply(z, z, out=result[..., :3])
    for index, (i, j) in enumerate(PAIRS):
        np.multiply(z[..., i], z[..., j], out=result[..., 3 + index])
    result[..., 6:9] = z
    result[..., 9] = 1.0
    return result


def quadratic(p: Float[Array, "... m"]) -> Float[Array, "... 3 3"]:
    """Symmetric matrix of the quadratic part of coefficients of the monomials."""
    matrix = np.zeros((*p.shape[:-1], 3, 3))
    matrix[..., range(3), range(3)] = p[..., :3]
    for index, (i, j) in enumerate(PAIRS):
        matrix[..., i, j] = matrix[..., j, i] = p[..., 3 + index] / 2.0
    return matrix


def moment_matrix(
    z: Float[Array, "t n 3"], weights: Float[Array, "t n"] | None = None
) -> Float[Array, "t 10 10"]:
    """Moment matrix G of the monomials, eq. (Q2)."""
    total: Array | float = 0.0
    for start in range(0, z.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        m = _monomial_rows(z[:, part])
        right = m if weights is None else m * weights[:, None, part]
        total = total + m @ np.swapaxes(right, -1, -2)
    return np.asarray(total)


def _monomial_rows(z: Float[Array, "t n 3"]) -> Float[Array, "t 10 n"]:
    # a row for each monomial, so that the poses are next to each other in memory
    x = np.ascontiguousarray(np.swapaxes(z, -1, -2))
    result = np.empty((len(x), 10, x.shape[-1]))
    np.multiply(x, x, out=result[:, :3])
    for index, (i, j) in enumerate(PAIRS):
        np.multiply(x[:, i], x[:, j], out=result[:, 3 + index])
    result[:, 6:9] = x
    result[:, 9] = 1.0
    return result


def in_lanes(matrices: Float[Array, "t p q"]) -> Float[Array, "p q t"]:
    """The same with the trials next to each other; no copy where they are already."""
    return np.ascontiguousarray(np.moveaxis(matrices, 0, -1))


def unbiased_moment_matrix(
    z: Float[Array, "t n 3"], noise_std: Float[Array, "t n"]
) -> Float[Array, "t 10 10"]:
    """Moment matrix whose mean is that of the noise-free readings.

    A power of a reading with Gaussian noise is replaced by the Hermite polynomial
    whose mean is the power of the true value: x, x^2 - s^2, x^3 - 3 s^2 x,
    x^4 - 6 s^2 x^2 + 3 s^4.
    """
    total = np.zeros((z.shape[0], 10, 10))
    for start in range(0, z.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        x, s2 = z[:, part], noise_std[:, part, None] ** 2
        square = x * x
        powers = np.stack(
            [
                np.ones_like(x),
                x,
                square - s2,
                x * (square - 3.0 * s2),
                square * (square - 6.0 * s2) + 3.0 * s2 * s2,
            ]
        )
        for i, first in enumerate(_EXPONENTS):
            for j, second in enumerate(_EXPONENTS[: i + 1]):
                a, b, c = np.add(first, second)
                product = powers[a, ..., 0] * powers[b, ..., 1] * powers[c, ..., 2]
                total[:, i, j] += product.sum(axis=-1)
    lower = np.tril(total, -1)
    return total + np.swapaxes(lower, -1, -2)


def weighted_sum(
    z: Float[Array, "t n 3"], weights: Float[Array, "t n"]
) -> Float[Array, "t 10"]:
    """Weighted sum of the monomials over poses."""
    total = np.zeros((z.shape[0], 10))
    for start in range(0, z.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        total += np.vecmat(weights[:, part], monomials(z[:, part]))
    return total
