r"""Recursions over many rows, in blocks of rows that advance together.

A row maps the state before it to the state after it, and two maps of one family compose
to a map of that family. The rows are cut into about as many blocks as a block has rows;
the maps from a block's start to each of its rows are composed for all blocks at once,
the state is carried from block to block, and each map is applied to its block's start.
T rows so take some :math:`2\sqrt T` operations on arrays instead of T.

A row of the Riccati recursion, a step F, Q of the state and then measurements that add
the information :math:`\Omega`, is

.. math:: P \mapsto A (P^{-1} + J)^{-1} A^T + C, \quad A = W F,\ C = W Q,\
   J = F^T \Omega W F,\ W = (I + Q \Omega)^{-1}  \tag{F3}

and two of them, i first, compose to

.. math:: A = A_j D A_i,\ C = A_j D C_i A_j^T + C_j,\ J = A_i^T J_j D A_i + J_i,\quad
   D = (I + C_i J_j)^{-1}.  \tag{F4}

(S. Särkkä and A. F. García-Fernández, Temporal parallelization of Bayesian smoothers,
IEEE Trans. Automatic Control 66 (2021), give such maps for estimates with their means.)
Once the gains are known, covariances X of one source of error each and columns S of
means and sensitivities go linearly,

.. math:: X \mapsto A X A^T + N, \qquad S \mapsto A S + D.  \tag{F5}
"""

from collections.abc import Callable
from math import ceil, sqrt
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.shapes import Float

Matrices = tuple[Array, ...]
"""Of a map or of a state; all of a kind have the same leading axes."""

SIZE: Final = 6
"""States: rotation vector of the attitude's error, and error of the bias."""


def scan(
    rows: Matrices,
    start: Matrices,
    compose: Callable[[Matrices, Matrices], Matrices],
    apply: Callable[[Matrices, Matrices], Matrices],
) -> Matrices:
    """States after each of T rows, whose maps have the leading axis T."""
    T = len(rows[0])
    length = ceil(sqrt(T))
    first = np.arange(0, T, length)
    # row of a block, then block; the last block goes on with copies of its last row
    place = np.minimum(np.arange(length)[:, None] + first, T - 1)
    maps = tuple(each[place] for each in rows)
    for k in range(1, length):
        before = tuple(each[k - 1] for each in maps)
        for into, value in zip(
            maps, compose(before, tuple(each[k] for each in maps)), strict=True
        ):
            into[k] = value
    starts = [start]
    for b in range(len(first) - 1):
        starts.append(apply(starts[-1], tuple(each[-1, b] for each in maps)))
    states = apply(tuple(np.stack(each) for each in zip(*starts, strict=True)), maps)
    # row of a block, block -> row
    return tuple(
        each.swapaxes(0, 1).reshape(-1, *each.shape[2:])[:T] for each in states
    )


def riccati_rows(
    F: Float[Array, "T 6 6"],
    Q: Float[Array, "T 6 6"],
    information: Float[Array, "T 3 3"],
) -> Matrices:
    """Maps of single rows, eq. (F3); the information is on the attitude alone."""
    # W = I - Q[:, :3] (I + information Q[:3, :3])^-1 information [I 0]
    inner = np.linalg.inv(np.eye(3) + information @ Q[:, :3, :3]) @ information
    W = np.tile(np.eye(SIZE), (len(F), 1, 1))
    W[:, :, :3] -= Q[:, :, :3] @ inner
    A = W @ F
    J = F[:, :3].swapaxes(-1, -2) @ information @ A[:, :3]
    return A, W @ Q, J


def compose_riccati(first: Matrices, then: Matrices) -> Matrices:
    """One map after another, eq. (F4)."""
    A_i, C_i, J_i = first
    A_j, C_j, J_j = then
    D = np.linalg.inv(np.eye(SIZE) + C_i @ J_j)
    DA = D @ A_i
    C = A_j @ (D @ C_i) @ A_j.swapaxes(-1, -2) + C_j
    return A_j @ DA, C, A_i.swapaxes(-1, -2) @ (J_j @ DA) + J_i


def apply_riccati(state: Matrices, maps: Matrices) -> Matrices:
    """Covariances after maps, eq. (F3), from a root of those before."""
    A, C, J = maps
    R = _root(state[0])
    middle = np.linalg.inv(np.eye(SIZE) + R.swapaxes(-1, -2) @ J @ R)
    AR = A @ R
    P = AR @ middle @ AR.swapaxes(-1, -2) + C
    return ((P + P.swapaxes(-1, -2)) / 2.0,)


def _root(P: Float[Array, "... 6 6"]) -> Float[Array, "... 6 6"]:
    # R R' = P, which may be singular; of the correlations, whose units are one
    sd = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))
    unit = np.where(sd > 0.0, sd, 1.0)
    values, V = np.linalg.eigh(P / (unit[..., :, None] * unit[..., None, :]))
    return unit[..., :, None] * V * np.sqrt(np.maximum(values, 0.0))[..., None, :]


def compose_linear(first: Matrices, then: Matrices) -> Matrices:
    """One linear map after another, eq. (F5): A, N by source and D by column."""
    A_i, N_i, D_i = first
    A_j, N_j, D_j = then
    return A_j @ A_i, _carried(A_j, N_i) + N_j, A_j @ D_i + D_j


def apply_linear(state: Matrices, maps: Matrices) -> Matrices:
    """Covariances by source and columns after linear maps, eq. (F5)."""
    X, S = state
    A, N, D = maps
    return _carried(A, X) + N, A @ S + D


def _carried(
    A: Float[Array, "... 6 6"], X: Float[Array, "... s 6 6"]
) -> Float[Array, "... s 6 6"]:
    A = A[..., None, :, :]
    return A @ X @ A.swapaxes(-1, -2)
