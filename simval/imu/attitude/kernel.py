r"""Closed-form two-vector quaternion on structure-of-arrays blocks, without checks.

With :math:`s_i = (b_i + r_i)/2` and :math:`d_i = (b_i - r_i)/2`,

.. math:: \bar q = [d_1 \times d_2;\ s_1^T d_2]  \tag{K1}

(Peng and Choukroun, eqs. 8 to 10) is proportional to the attitude quaternion. A
half turn of the reference frame about axis k, :math:`r \to R_k r`, followed by the
composition :math:`[1_k; 0] * \bar q'`, eq. (G2) of `geometry`, gives the columns x, y
and z. Without noise the four columns are

.. math:: M = q\, p^T,\quad p = [e \times n - s\, n;\ e^T n],\quad
   n = r_1 \times r_2,  \tag{K2}

in the order x, y, z, plain, so :math:`\sum_k |M_k|^2 = |n|^2` and the greatest
column is never shorter than :math:`|n|/2`. Replacing the scalar
:math:`s_1^T d_2` by the symmetric :math:`(s_1^T d_2 - s_2^T d_1)/2` leaves (K2)
alone and halves that entry's noise.

Where the angle between the body vectors differs from that of the references, no
attitude fits both pairs. For unit vectors M, with the symmetric scalar and any noise,
still has Davenport's eigenvectors (docs/theory.md, section 9 derives all that follows):

.. math:: M M^T = \tfrac14 \det(I - K) (I - K)^{-1} (I + K).  \tag{K5}

Wahba's optimum is the greatest left singular vector, and (K1) gives it by itself for

.. math:: (r_1 - r_2,\ \lambda (b_1 - b_2)), \quad (r_1 + r_2,\ \mu (b_1 + b_2)),
   \tag{K3}

the body vectors scaled to the lengths of the references: these pairs fit one attitude,
and every column of (K2) is the optimum or zero. Weights a1 and a2 turn both body
vectors in their plane first, by an angle of tangent

.. math:: \tan\epsilon = \frac{a_1 - a_2}{a_1 + a_2} \tan\frac{\theta_r - \theta_b}{2}.
   \tag{K4}

Lengths 1 + e turn that singular vector about the normal alone, by

.. math:: \cot\theta\, (a_1 (e_{b1} - e_{r1}) - a_2 (e_{b2} - e_{r2})),  \tag{K6}

so isotropic noise costs the RMS error, over the Cramer-Rao bound, of all columns

.. math:: \sqrt{5 / (4 + \sin^2\theta)}.  \tag{K7}

A block holds one sample per column: rows are the components of b1, b2, r1, r2.
Blocks of `BLOCK` columns stay in the processor's cache.
"""

from typing import Final

import numpy as np

from simval.arrays import Array
from simval.shapes import Float, Shaped

BLOCK: Final = 4096  # samples worked at once, for the cache; no result depends on it
FRAMES: Final = ("x", "y", "z", "plain")  # the order of the columns in (K2)

# for each frame, is component j of r kept (a half turn about k keeps only k)?
_KEPT: Final = {
    "x": (True, False, False),
    "y": (False, True, False),
    "z": (False, False, True),
    "plain": (True, True, True),
}
# where component j of the vector part goes, with its sign, and where the scalar
# goes: [1_k; 0] * [v; s] = [s 1_k + 1_k x v; -v_k]
_PLACES: Final = {
    "x": (((3, -1), (2, 1), (1, -1)), 0),
    "y": (((2, -1), (3, -1), (0, 1)), 1),
    "z": (((1, 1), (0, -1), (3, -1)), 2),
    "plain": (((0, 1), (1, 1), (2, 1)), 3),
}


def raw_quaternion(
    vectors: Shaped[Array, "4 3 n"] | Shaped[Array, "12 n"],
    frame: str,
    out: Shaped[Array, "4 n"] | None = None,
) -> Shaped[Array, "4 n"]:
    """Quaternions in a fixed frame by eq. (K1), not normalised, sign as it comes."""
    b1, b2, r1, r2 = vectors.reshape(4, 3, -1)
    d1, d2, s1 = np.empty_like(b1), np.empty_like(b1), np.empty_like(b1)
    for j, kept in enumerate(_KEPT[frame]):
        minus, plus = (np.subtract, np.add) if kept else (np.add, np.subtract)
        minus(b1[j], r1[j], out=d1[j])
        minus(b2[j], r2[j], out=d2[j])
        plus(b1[j], r1[j], out=s1[j])
    d2 *= 0.25  # the halves of s1 or d1 and of d2
    out = np.empty((4, b1.shape[1]), dtype=b1.dtype) if out is None else out
    places, scalar = _PLACES[frame]
    term = np.empty_like(b1[0])
    for j, (row, sign) in enumerate(places):
        k, m = (j + 1) % 3, (j + 2) % 3
        if sign < 0:
            k, m = m, k
        np.multiply(d1[k], d2[m], out=out[row])
        np.multiply(d1[m], d2[k], out=term)
        out[row] -= term
    np.multiply(s1[0], d2[0], out=out[scalar])
    for j in (1, 2):
        np.multiply(s1[j], d2[j], out=term)
        out[scalar] += term
    return out


def column_matrix(
    vectors: Shaped[Array, "4 3 n"] | Shaped[Array, "12 n"], *, symmetric: bool
) -> Shaped[Array, "4 4 n"]:
    """The four columns M of eq. (K2), not normalised."""
    b1, b2, r1, r2 = vectors.reshape(4, 3, -1)
    # [False]: differences d, [True]: sums s; the factor 1/4 is applied once
    first = (0.25 * (b1 - r1), 0.25 * (b1 + r1))
    second = (b2 - r2, b2 + r2)
    out = np.empty((4, 4, b1.shape[1]), dtype=b1.dtype)
    term = np.empty_like(b1[0])
    scalars = first[1] * second[0]  # s1 d2 by component, for kept components
    turned = first[0] * second[1]  # d1 s2, where the half turn swaps s and d
    if symmetric:
        scalars -= turned
        scalars *= 0.5
        np.negative(scalars, out=turned)
    for column, frame in zip(out, FRAMES, strict=True):
        kept = _KEPT[frame]
        places, scalar = _PLACES[frame]
        for j, (row, sign) in enumerate(places):
            k, m = (j + 1) % 3, (j + 2) % 3
            if sign < 0:
                k, m = m, k
            np.multiply(first[not kept[k]][k], second[not kept[m]][m], out=column[row])
            np.multiply(first[not kept[m]][m], second[not kept[k]][k], out=term)
            column[row] -= term
        parts = [scalars[j] if kept[j] else turned[j] for j in range(3)]
        np.add(parts[0], parts[1], out=column[scalar])
        column[scalar] += parts[2]
    return out


def best_quaternion(columns: Shaped[Array, "4 4 n"]) -> Shaped[Array, "4 n"]:
    """The longest of the four columns, not normalised, sign as it comes."""
    norms = np.einsum("kin,kin->kn", columns, columns)
    first, first_norm = _longer(columns[0], norms[0], columns[1], norms[1])
    second, second_norm = _longer(columns[2], norms[2], columns[3], norms[3])
    return _longer(first, first_norm, second, second_norm)[0]


def _longer(
    a: Shaped[Array, "4 n"],
    a_norm: Shaped[Array, " n"],
    b: Shaped[Array, "4 n"],
    b_norm: Shaped[Array, " n"],
) -> tuple[Shaped[Array, "4 n"], Shaped[Array, " n"]]:
    pick = a_norm > b_norm
    return np.where(pick, a, b), np.maximum(a_norm, b_norm)


def combined_quaternion(columns: Shaped[Array, "4 4 n"]) -> Shaped[Array, "4 n"]:
    """One power step from the greatest column towards the top left singular vector."""
    best = best_quaternion(columns)
    weights = np.einsum("kin,in->kn", columns, best)
    total: Array = np.einsum("kin,kn->in", columns, weights)
    return total


def squared_norm(v: Shaped[Array, "m n"]) -> Shaped[Array, " n"]:
    """Sum of squares over the rows."""
    total: Array = np.einsum("in,in->n", v, v)
    return total


def normalize_vectors(vectors: Shaped[Array, "12 n"]) -> Shaped[Array, "4 n"]:
    """Divide each vector by its length, in place, and return the lengths."""
    v = vectors.reshape(4, 3, -1)
    lengths: Array = np.sqrt(np.einsum("kjn,kjn->kn", v, v))
    v /= lengths[:, None]
    return lengths


def fit_pairs(
    vectors: Shaped[Array, "12 n"], weights: Float[Array, "2 n"] | None = None
) -> None:
    """Replace unit vectors by the pairs (K3), which give the optimum in any frame."""
    v = vectors.reshape(4, 3, -1)
    v[::2], v[1::2] = v[::2] - v[1::2], v[::2] + v[1::2]
    squares = np.einsum("kjn,kjn->kn", v, v)
    if weights is None:
        v[:2] *= np.sqrt(squares[2:] / squares[:2])[:, None]
        return
    lengths = np.sqrt(squares)
    sin, cos = _half_difference(lengths)
    a1, a2 = weights / np.max(weights, axis=0)
    sin *= (a1 - a2) / (a1 + a2)
    sin, cos = (sin, cos) / np.hypot(sin, cos)
    d, s = v[:2] / lengths[:2, None]
    v[0], v[1] = lengths[2] * (cos * d + sin * s), lengths[3] * (cos * s - sin * d)


def angle_difference(vectors: Float[Array, "12 n"]) -> Float[Array, " n"]:
    """Angle between the body vectors minus that between the references, rad."""
    v = vectors.reshape(4, 3, -1)
    pairs = np.stack([v[::2] - v[1::2], v[::2] + v[1::2]], axis=1).reshape(4, 3, -1)
    lengths = np.sqrt(np.einsum("kjn,kjn->kn", pairs, pairs))
    return -2.0 * np.arctan2(*_half_difference(lengths))


def _half_difference(lengths: Float[Array, "4 n"]) -> tuple[Array, Array]:
    # four times sine and cosine of half of what the references' angle is greater, from
    # the lengths of differences and sums, body first: twice the sines and cosines
    d_b, s_b, d_r, s_r = lengths
    return d_r * s_b - s_r * d_b, s_r * s_b + d_r * d_b


def normalize_columns(q: Float[Array, "4 n"]) -> Float[Array, "4 n"]:
    """Divide each column by its length, in place."""
    q /= np.sqrt(squared_norm(q))
    return q
