r"""Rotations between rests and their derivatives, from path statistics in one pass.

With the ten statistics X of a chunk (N1) is linear in them,

.. math:: \phi = F X, \qquad F = [M,\ \mathrm{cof} M,\ -\mathrm{cof} M [B\times],\ -MB],

and the rotation is :math:`C = \prod_j \exp([\phi_j\times])`, body now to body at its
start. With J the left Jacobian of the exponential, C_j the rotation up to chunk j and
:math:`D_j = C_j J(\phi_j)`, a change of the parameters turns the whole by
:math:`\theta`, axes of its start,

.. math:: \theta = \sum_j D_j\, \mathrm{d}\phi_j
   = \sum_p \mathrm{d}p \sum_{ix} \Big(\sum_j D_j \otimes X_j\Big)_{ix}
     \partial_p F_{ix}, \tag{N3}

so one contraction over the chunks, a product of matrices, gives the columns of all
twelve parameters. Those of the cofactors are linear in M,

.. math:: \partial_{ab}\,\mathrm{cof}_{ij}
   = \sum_{ln} \epsilon_{ial}\, \epsilon_{jbn}\, M_{ln}. \tag{N4}
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.shapes import Float, Inexact

_CROSS = np.zeros((3, 3, 3))  # [v x]_ij = sum over k of _CROSS[k, i, j] v_k
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _CROSS[_k, _i, _j], _CROSS[_k, _j, _i] = -1.0, 1.0
_ENTRIES = np.eye(9).reshape(9, 3, 3)  # derivative of M by its entries, row by row
# of its cofactors, by entry ab: sum over l, n of e_ial e_jbn M_ln
_COFACTOR = np.einsum("lia,njb->lnabij", _CROSS, _CROSS).reshape(9, 81)
_CACHED = 1 << 12  # chunks worked at once: thirty arrays of 32 kB, 3 times as fast
_SMALL = 1e-2  # rad; the next term of each series is below 1e-16 of its first


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rotations:
    """Rotations between rests for one guess of the parameters."""

    statistics: Float[Array, "t k 10 j"]
    M: Float[Array, "t 3 3"]
    B: Float[Array, "t 3"]  # less the centre of the statistics
    C: Float[Array, "t k 3 3"]  # body at the end to body at the start
    slopes: Float[Array, "t k 3 12"]  # theta by M (row by row) and B, eq. (N3)
    D: Float[Array, "t k 9 j"]  # of each chunk

    def by_rate(self, scale: Any = 1.0) -> Float[Array, "t k 3 j 3"]:
        """Slope D M of theta by the integrated reading of each chunk, axes scaled."""
        t, k, _, j = self.D.shape
        D = self.D.reshape(t, k, 3, 3, j).transpose(0, 1, 2, 4, 3)
        return np.asarray(D @ (self.M * scale)[:, None, None])

    def by_line(self, weights: Float[Array, "k j"]) -> Float[Array, "t k 3 3"]:
        """Slope of theta by a bias with such weights along each rotation."""
        moments = self.D @ np.swapaxes(self.statistics * weights[:, None], -1, -2)
        t, k = moments.shape[:2]
        slopes = map_slopes(self.M, self.B)[:, None, :, 9:]
        return np.asarray(moments.reshape(t, k, 3, 30) @ slopes)


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
    result[:, 9:, :, 9] = -np.swapaxes(M, -1, -2)
    return np.swapaxes(result.reshape(t, 12, 30), -1, -2)


def rotations(
    statistics: Float[Array, "t k 10 j"],
    M: Float[Array, "t 3 3"],
    B: Float[Array, "t 3"],
) -> Rotations:
    """Rotations and derivatives, eqs. (N1) and (N3)."""
    t, k, _, j = statistics.shape
    phi = _vectors(statistics, M, B)
    whole, swept = prefixes(quaternions(phi)), np.empty((3, 3, j, t * k))
    size = max(1, _CACHED // (t * k))
    for some in (slice(i, i + size) for i in range(0, j, size)):
        swept[:, :, some] = _swept(phi[:, some], whole[:, :-1][:, some])
    flat = np.moveaxis(swept.reshape(9, j, t, k), 1, -1)  # 9 t k j
    D = np.ascontiguousarray(np.moveaxis(flat, 0, 2))  # t k 9 j
    moments = D @ np.swapaxes(statistics, -1, -2)  # t k 9 10
    slopes = moments.reshape(t, k, 3, 30) @ map_slopes(M, B)[:, None]
    C = _matrices(whole[:, -1], t, k)
    return Rotations(statistics=statistics, M=M, B=B, C=C, slopes=slopes, D=D)


def final_rotations(
    statistics: Float[Array, "s k 10 j"],
    M: Float[Array, "m 3 3"],
    B: Float[Array, "m 3"],
) -> Float[Array, "t k 3 3"]:
    """C alone, of many trials for one guess each, or of one for many guesses."""
    t, k = max(len(statistics), len(M)), statistics.shape[1]
    q = quaternions(_vectors(statistics, M, B))
    while q.shape[1] > 1:
        odd = q[:, -1:] if q.shape[1] % 2 else q[:, :0]
        even = q.shape[1] - odd.shape[1]
        q = np.concatenate([product(q[:, 0:even:2], q[:, 1:even:2]), odd], axis=1)
    return _matrices(q[:, 0], t, k)


def _vectors(statistics: Array, M: Array, B: Array) -> Float[Array, "3 j n"]:
    # rotation vectors, chunks first, so that sums along a rotation go in rows
    phi = map_of(M, B)[:, None] @ statistics  # t k 3 j
    j = phi.shape[-1]
    result = np.empty((3, j, phi.size // (3 * j)))
    for i in range(3):
        result[i] = phi[..., i, :].reshape(-1, j).T
    return result


def quaternions(phi: Float[Array, "3 j n"]) -> Float[Array, "4 j n"]:
    """Quaternions, vector first, of rotation vectors."""
    half = 0.5 * _length(phi)
    q = np.empty((4, *half.shape))
    np.cos(half, out=q[3])
    share = np.sin(half)
    share /= half
    share *= 0.5
    np.multiply(phi, share, out=q[:3])
    return q


def _length(phi: Float[Array, "3 j n"]) -> Float[Array, "j n"]:
    # never 0, where sin(x)/x is not told; 1e-100 is 0 beside any angle
    squared = phi[0] * phi[0]
    squared += phi[1] * phi[1]
    squared += phi[2] * phi[2]
    return np.sqrt(np.maximum(squared, 1e-200))


# of each entry of the vector of p q: entries of p and q, the last product subtracted
_TERMS: Final = (
    ((3, 0), (0, 3), (1, 2), (2, 1)),
    ((3, 1), (1, 3), (2, 0), (0, 2)),
    ((3, 2), (2, 3), (0, 1), (1, 0)),
)


def product(p: Float[Array, "4 ..."], q: Float[Array, "4 ..."]) -> Array:
    """Hamilton's product: first p, then q about the axes that p left."""
    result = np.empty(np.broadcast_shapes(p.shape, q.shape))
    term = np.empty(result.shape[1:])
    for entry, (one, two, three, less) in zip(result[:3], _TERMS, strict=True):
        np.multiply(p[one[0]], q[one[1]], out=entry)
        for a, b in (two, three):
            entry += np.multiply(p[a], q[b], out=term)
        entry -= np.multiply(p[less[0]], q[less[1]], out=term)
    np.multiply(p[3], q[3], out=result[3])
    for a in range(3):
        result[3] -= np.multiply(p[a], q[a], out=term)
    return result


def prefixes(q: Float[Array, "4 j n"]) -> Float[Array, "4 i n"]:
    """Products of the first 0, 1, ... quaternions, in blocks: few, long operations."""
    count, many = q.shape[1:]
    size = max(1, round(count**0.5))
    blocks = -(-count // size)
    padded = np.zeros((4, blocks * size, many))
    padded[3] = 1.0
    padded[:, :count] = q
    inner = np.ascontiguousarray(
        padded.reshape(4, blocks, size, many).transpose(0, 2, 1, 3)
    )
    for i in range(1, size):
        inner[:, i] = product(inner[:, i - 1], inner[:, i])
    outer = inner[:, -1].copy()
    for i in range(1, blocks):
        outer[:, i] = product(outer[:, i - 1], outer[:, i])
    inner[:, :, 1:] = product(outer[:, None, :-1], inner[:, :, 1:])
    whole = np.empty((4, blocks * size + 1, many))
    whole[:3, 0], whole[3, 0] = 0.0, 1.0
    whole[:, 1:] = inner.transpose(0, 2, 1, 3).reshape(4, -1, many)
    return whole[:, : count + 1]


def _swept(
    phi: Float[Array, "3 j n"], before: Float[Array, "4 j n"]
) -> Float[Array, "3 3 j n"]:
    # D = C J(phi), J = I + b [phi x] + c (phi phi' - |phi|^2 I)
    angle = _length(phi)
    squared = angle * angle
    half = np.sin(0.5 * angle)
    half /= angle
    b = 2.0 * half * half
    c = np.sin(angle)
    c /= angle
    np.subtract(1.0, c, out=c)
    c /= squared
    small = angle < _SMALL
    few = squared[small]
    c[small] = (1.0 - few / 20.0 * (1.0 - few / 42.0)) / 6.0
    J = np.empty((3, 3, *angle.shape))
    cphi, bphi, squares = c * phi, b * phi, phi * phi
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        even = cphi[i] * phi[j]
        np.subtract(even, bphi[k], out=J[i, j])
        np.add(even, bphi[k], out=J[j, i])
        np.subtract(1.0, c * (squares[i] + squares[j]), out=J[k, k])
    C = _entries(before)
    D = C[:, 0, None] * J[0]
    for row, by in zip(D, C, strict=True):  # a row at a time stays in the cache
        row += by[1] * J[1]
        row += by[2] * J[2]
    return D


def _entries(q: Float[Array, "4 ..."]) -> Float[Array, "3 3 ..."]:
    # rotation matrices, transposes of the attitude matrices, eq. (G1) of `geometry`
    x, y, z, s = q
    R = np.empty((3, 3, *x.shape))
    xx, yy, zz = x * x, y * y, z * z
    R[0, 0], R[1, 1] = 1.0 - 2.0 * (yy + zz), 1.0 - 2.0 * (xx + zz)
    R[2, 2] = 1.0 - 2.0 * (xx + yy)
    for i, j, one, two in ((0, 1, x * y, z * s), (2, 0, x * z, y * s)):
        R[i, j], R[j, i] = 2.0 * (one - two), 2.0 * (one + two)
    R[1, 2], R[2, 1] = 2.0 * (y * z - x * s), 2.0 * (y * z + x * s)
    return R


def _matrices(q: Float[Array, "4 n"], t: int, k: int) -> Float[Array, "t k 3 3"]:
    # unit to rounding after hundreds of products
    q = q / np.sqrt((q * q).sum(axis=0))
    return np.moveaxis(_entries(q), -1, 0).reshape(t, k, 3, 3)
