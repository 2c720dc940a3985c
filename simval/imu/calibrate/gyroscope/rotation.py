r"""Rotations between rests and their derivatives, from path statistics in one pass.

With the ten statistics X of a chunk (N1) of `path_statistics` is linear in them,

.. math:: \phi = F X, \qquad F = [M,\ \mathrm{cof} M,\ -\mathrm{cof} M [B\times],\ -MB],

and the rotation is :math:`C = \prod_j \exp([\phi_j\times])`, body now to body at its
start. With J the left Jacobian of the exponential, C_j the rotation up to chunk j and
:math:`D_j = C_j J(\phi_j)`, a change of the parameters turns the whole by
:math:`\theta`, axes of its start,

.. math:: \theta = \sum_j D_j\, \mathrm{d}\phi_j
   = \sum_p \mathrm{d}p \sum_{ix} \Big(\sum_j D_j \otimes X_j\Big)_{ix}
     \partial_p F_{ix}, \tag{N3}

so one contraction over the chunks, a product of matrices, gives the columns of all
twelve parameters. J is a rotation by half of :math:`\phi`, shortened across it, and
the sum of the quaternions before and after a chunk points halfway; so with R(q) the
matrix that is quadratic in a quaternion of any length, and no other function of the
angle than its fourth's tangent,

.. math:: D_j = R + \frac{1 - s}{s\,|\phi|^2} (R\phi)\,\phi^T, \qquad
   R = \frac{\tan(|\phi|/4)}{|\phi|} R(q_{j-1} + q_j), \quad
   s = \frac{\sin(|\phi|/2)}{|\phi|/2}.

The derivatives of the cofactors are linear in M,

.. math:: \partial_{ab}\,\mathrm{cof}_{ij}
   = \sum_{ln} \epsilon_{ial}\, \epsilon_{jbn}\, M_{ln}. \tag{N4}
"""

from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.geometry import cross_matrix
from simval.shapes import Float, Inexact

_CROSS = cross_matrix(np.eye(3)) + 0.0  # [v x]_ij = sum over k of _CROSS[k, i, j] v_k
_ENTRIES = np.eye(9).reshape(9, 3, 3)  # derivative of M by its entries, row by row
# of its cofactors, by entry ab: sum over l, n of e_ial e_jbn M_ln
_COFACTOR = np.einsum("lia,njb->lnabij", _CROSS, _CROSS).reshape(9, 81)
_CACHED = 1 << 13  # chunks worked at once: thirty arrays of 64 kB stay in the cache


class Rotations(NamedTuple):
    """Rotations between rests at one guess of the parameters."""

    statistics: Float[Array, "t k 10 j"]
    M: Float[Array, "t 3 3"]
    B: Float[Array, "t 3"]  # less the centre of the statistics
    C: Float[Array, "t k 3 3"]  # body at the end to body at the start
    slopes: Float[Array, "t k 3 12"]  # theta by M (row by row) and B, eq. (N3)
    D: Float[Array, "t k 9 j"]  # of each chunk

    def by_rate(self, scale: Any = 1.0) -> Float[Array, "t k 3 j 3"]:
        """Derivative D M of theta by the integrated reading of each chunk."""
        t, k, _, j = self.D.shape
        D = self.D.reshape(t, k, 3, 3, j).transpose(0, 1, 2, 4, 3)
        return D @ (self.M * scale)[:, None, None]

    def by_line(self, weights: Float[Array, "k j"]) -> Float[Array, "t k 3 3"]:
        """Derivative of theta by a bias with such weights along each rotation."""
        moments = self.D @ (self.statistics * weights[:, None]).mT
        t, k = moments.shape[:2]
        slopes = map_slopes(self.M, self.B)[:, None, :, 9:]
        return moments.reshape(t, k, 3, 30) @ slopes


def cofactor(M: Inexact[Array, "... 3 3"]) -> Inexact[Array, "... 3 3"]:
    """Matrix of cofactors: each row the cross product of the two others."""
    return np.cross(M[..., [1, 2, 0], :], M[..., [2, 0, 1], :])


def map_of(
    M: Inexact[Array, "... 3 3"], B: Inexact[Array, "... 3"]
) -> Inexact[Array, "... 3 10"]:
    """Matrix F that takes path statistics to a rotation vector, eq. (N1)."""
    cof = cofactor(M)
    bias = B @ _CROSS.reshape(3, 9)
    last = -(M @ B[..., None])
    bent = -cof @ bias.reshape(*B.shape[:-1], 3, 3)
    return np.concatenate([M, cof, bent, last], axis=-1)


def map_slopes(
    M: Float[Array, "t 3 3"], B: Float[Array, "t 3"]
) -> Float[Array, "t 30 12"]:
    """Derivative of F by M, row by row, and B, eq. (N4)."""
    t = len(M)
    bias = (B @ _CROSS.reshape(3, 9)).reshape(t, 1, 3, 3)
    dcof = (M.reshape(t, 9) @ _COFACTOR).reshape(t, 9, 3, 3)
    result = np.zeros((t, 12, 3, 10))
    result[:, :9, :, :3] = _ENTRIES
    result[:, :9, :, 3:6] = dcof
    result[:, :9, :, 6:9] = -dcof @ bias
    result[:, :9, :, 9] = -(_ENTRIES @ B[:, None, :, None])[..., 0]
    result[:, 9:, :, 6:9] = -cofactor(M)[:, None] @ _CROSS
    result[:, 9:, :, 9] = -M.mT
    return result.reshape(t, 12, 30).mT


def rotations(
    statistics: Float[Array, "t k 10 j"],
    M: Float[Array, "t 3 3"],
    B: Float[Array, "t 3"],
) -> Rotations:
    """Rotations and derivatives, eqs. (N1) and (N3)."""
    t, k, _, j = statistics.shape
    phi = _vectors(statistics, M, B)
    squared, ratio = _angles(phi)
    whole = prefixes(quaternions(phi, squared, ratio))
    D = np.empty((3, 3, t * k, j))
    size = max(1, _CACHED // j)
    for some in (slice(i, i + size) for i in range(0, t * k, size)):
        both = whole[:, some, 1:] + whole[:, some, :-1]
        _sweep(D[:, :, some], both, phi[:, some], squared[some], ratio[some])
    D = np.moveaxis(D.reshape(9, t, k, j), 0, 2)
    moments = D @ statistics.mT  # t k 9 10
    slopes = moments.reshape(t, k, 3, 30) @ map_slopes(M, B)[:, None]
    C = _matrices(whole[..., -1], t, k)
    return Rotations(statistics=statistics, M=M, B=B, C=C, slopes=slopes, D=D)


def final_rotations(
    statistics: Float[Array, "s k 10 j"],
    M: Float[Array, "m 3 3"],
    B: Float[Array, "m 3"],
) -> Float[Array, "t k 3 3"]:
    """The rotation C alone, for one guess a trial or for many guesses of one trial."""
    t, k = max(len(statistics), len(M)), statistics.shape[1]
    phi = _vectors(statistics, M, B)
    q = quaternions(phi, *_angles(phi))
    q = np.ascontiguousarray(q.swapaxes(1, 2))  # neighbours are multiplied in rows
    while q.shape[1] > 1:
        odd = q[:, -1:] if q.shape[1] % 2 else q[:, :0]
        even = q.shape[1] - odd.shape[1]
        q = np.concatenate([product(q[:, 0:even:2], q[:, 1:even:2]), odd], axis=1)
    return _matrices(q[:, 0], t, k)


def _vectors(statistics: Array, M: Array, B: Array) -> Float[Array, "3 n j"]:
    F, (k, _, j) = map_of(M, B), statistics.shape[1:]
    phi = np.empty((3, max(len(F), len(statistics)), k, j))
    np.matmul(F[:, None], statistics, out=np.moveaxis(phi, 0, 2))
    return phi.reshape(3, -1, j)


def _angles(
    phi: Float[Array, "3 n j"],
) -> tuple[Float[Array, "n j"], Float[Array, "n j"]]:
    # squares of the angles, never 0, where a ratio is not told (1e-100 is 0 beside any
    # angle), and tan(angle/4)/angle
    squared = phi[0] * phi[0]
    squared += phi[1] * phi[1]
    squared += phi[2] * phi[2]
    np.maximum(squared, 1e-200, out=squared)
    angle = np.sqrt(squared)
    return squared, np.tan(0.25 * angle) / angle


def quaternions(
    phi: Float[Array, "3 n j"],
    squared: Float[Array, "n j"],
    ratio: Float[Array, "n j"],
) -> Inexact[Array, "2 n j"]:
    """Quaternions of rotation vectors, each as a pair s + ix, y + iz."""
    square = ratio * ratio * squared  # tan^2(angle/4)
    share = 2.0 / (1.0 + square)
    q = np.empty((2, *ratio.shape), dtype=complex)
    np.subtract(1.0, square * share, out=q[0].real)
    share *= ratio
    for x, part in zip(phi, (q[0].imag, q[1].real, q[1].imag), strict=True):
        np.multiply(x, share, out=part)
    return q


def product(
    p: Inexact[Array, "2 ..."], q: Inexact[Array, "2 ..."]
) -> Inexact[Array, "2 ..."]:
    """Hamilton's product: first p, then q about the axes that p has turned."""
    turned = q.conj()
    result = p[0] * q
    result[0] -= p[1] * turned[1]
    result[1] += p[1] * turned[0]
    return result


def prefixes(q: Inexact[Array, "2 n j"]) -> Inexact[Array, "2 n i"]:
    """Products of the first 0, 1, 2 ... quaternions."""
    many, count = q.shape[1], q.shape[2] + 1
    size = max(1, round(count**0.5))
    blocks = -(-count // size)
    padded = np.zeros((2, many, blocks * size), dtype=complex)
    padded[0] = 1.0
    padded[:, :, 1:count] = q
    inner = np.ascontiguousarray(
        padded.reshape(2, many, blocks, size).transpose(0, 3, 2, 1)
    )
    for i in range(1, size):
        inner[:, i] = product(inner[:, i - 1], inner[:, i])
    outer = inner[:, -1].copy()
    for i in range(1, blocks):
        outer[:, i] = product(outer[:, i - 1], outer[:, i])
    for i in range(size):
        inner[:, i, 1:] = product(outer[:, :-1], inner[:, i, 1:])
    return inner.transpose(0, 3, 2, 1).reshape(2, many, -1)[..., :count]


def _sweep(
    D: Float[Array, "3 3 n j"],
    both: Inexact[Array, "2 n j"],
    phi: Float[Array, "3 n j"],
    squared: Float[Array, "n j"],
    ratio: Float[Array, "n j"],
) -> None:
    # into D, from the sums of the quaternions before and after each chunk
    sinc = 4.0 * ratio / (1.0 + ratio * ratio * squared)
    bent = phi * ((1.0 - sinc) / (sinc * squared))
    _set_entries(D, both, ratio, sinc)
    along = D[:, 0] * phi[0]
    along += D[:, 1] * phi[1]
    along += D[:, 2] * phi[2]
    for row, one in zip(D, along, strict=True):
        row += one * bent


def _set_entries(
    R: Float[Array, "3 3 ..."],
    q: Inexact[Array, "2 ..."],
    factor: Float[Array, "..."],
    size: Any,
) -> None:
    # transposes of the attitude matrices, eq. (G1) of `geometry`, times the factor, of
    # quaternions of any length; size is its square, times the factor
    s, *u = (np.ascontiguousarray(x) for pair in q for x in (pair.real, pair.imag))
    twice = 2.0 * factor
    v = [twice * x for x in u]
    squares = [a * b for a, b in zip(u, v, strict=True)]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(size, squares[j], out=R[i, i])
        R[i, i] -= squares[k]
        one, two = v[i] * u[j], v[k] * s
        np.subtract(one, two, out=R[i, j])
        np.add(one, two, out=R[j, i])


def _matrices(q: Inexact[Array, "2 n"], t: int, k: int) -> Float[Array, "t k 3 3"]:
    # unit to rounding after hundreds of products
    R = np.empty((3, 3, t * k))
    _set_entries(R, q, 1.0 / (np.abs(q) ** 2).sum(axis=0), 1.0)
    return np.moveaxis(R, -1, 0).reshape(t, k, 3, 3)
