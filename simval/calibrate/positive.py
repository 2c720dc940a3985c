"""Batched factorisation of small symmetric systems, positive definite or not.

The factorisation runs over the batch in the last axis, so every trial sees the
same sequence of elementwise operations however many neighbours it has; LAPACK
through numpy costs ten times as much at this size, and raises for the whole batch
when one matrix is singular.
"""

import numpy as np

from simval.arrays import Array
from simval.shapes import Float


def solve_positive(
    matrices: Float[Array, "t p p"], right: Float[Array, "t p k"]
) -> tuple[Float[Array, "t p k"], Float[Array, " t"]]:
    """Solve N x = r by Cholesky after scaling N to a unit diagonal."""
    size = matrices.shape[-1]
    n = np.moveaxis(matrices, 0, -1).copy()
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        scale = 1.0 / np.sqrt(n[range(size), range(size)])
        n *= scale[:, None]
        n *= scale[None, :]
        x = np.moveaxis(right, 0, -1) * scale[:, None]
        pivot = np.ones(n.shape[-1])
        for i in range(size):  # N = L D L', L x = r on the way
            pivot = np.minimum(pivot, n[i, i])
            row = n[i, i + 1 :] / n[i, i]
            n[i + 1 :, i + 1 :] -= n[i, i + 1 :, None] * row
            x[i + 1 :] -= row[:, None] * x[i]
            x[i] /= n[i, i]
            n[i, i + 1 :] = row
        for i in range(size - 1, 0, -1):
            x[:i] -= n[:i, i, None] * x[i]
        x *= scale[:, None]
        x[..., ~(pivot > 0.0)] = np.nan
    return np.moveaxis(x, -1, 0), pivot


def negative_pivots(matrices: Float[Array, "t p p"]) -> Float[Array, " t"]:
    """How many eigenvalues of each symmetric matrix are below zero."""
    n = np.moveaxis(matrices, 0, -1).copy()
    count = np.zeros(n.shape[-1])
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for i in range(matrices.shape[-1]):
            count += ~(n[i, i] > 0.0)
            row = n[i, i + 1 :] / n[i, i]
            n[i + 1 :, i + 1 :] -= n[i, i + 1 :, None] * row
    return count


def trace(matrices: Float[Array, "t p p"]) -> Float[Array, " t"]:
    """Trace of each matrix, summed in the same order for every size of batch."""
    total = matrices[:, 0, 0].copy()
    for i in range(1, matrices.shape[-1]):
        total += matrices[:, i, i]
    return total
