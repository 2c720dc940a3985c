"""Batched factorisation of small symmetric systems, positive definite or not.

The factorisation runs over the batch in the last axis, so every trial sees the
same sequence of elementwise operations however many neighbours it has; LAPACK
through numpy costs ten times as much at this size, and raises for the whole batch
when one matrix is singular.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Factors:
    """Matrices N with S N S = U'DU, in lanes; S scales N to a unit diagonal."""

    scale: Float[Array, "p t"]  # diagonal of S
    upper: Float[Array, "p p t"]  # U above the diagonal, D on it
    pivot: Float[Array, " t"]  # least of D; solutions are NaN unless it is positive

    def solve(self, right: Float[Array, "p k t"]) -> Float[Array, "p k t"]:
        """Solve N x = r."""
        n, size = self.upper, len(self.upper)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            x = right * self.scale[:, None]
            for i in range(size):
                x[i + 1 :] -= n[i, i + 1 :, None] * x[i]
                x[i] /= n[i, i]
            for i in range(size - 1, 0, -1):
                x[:i] -= n[:i, i, None] * x[i]
            x *= self.scale[:, None]
            x[..., ~(self.pivot > 0.0)] = np.nan
        return x

    def take(self, rows: Any) -> "Factors":
        """Those of some trials."""
        return Factors(
            scale=self.scale[:, rows],
            upper=self.upper[..., rows],
            pivot=self.pivot[rows],
        )

    def root(self) -> Float[Array, "p p t"]:
        """Lower triangular R of the inverse R'R; NaN where N is not positive."""
        n, size = self.upper, len(self.upper)
        x = np.zeros_like(n)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for i in range(size):
                x[i, i] = 1.0
                x[i + 1 :, : i + 1] -= n[i, i + 1 :, None] * x[i, : i + 1]
                x[i, : i + 1] *= self.scale[: i + 1] / np.sqrt(n[i, i])
            x[..., ~(self.pivot > 0.0)] = np.nan
        return x


def factorize(matrices: Float[Array, "p p t"]) -> Factors:
    """Factorise matrices in lanes, after scaling them to a unit diagonal."""
    size = len(matrices)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        scale = 1.0 / np.sqrt(matrices[range(size), range(size)])
        n = matrices * scale[:, None]
        n *= scale
        pivot = np.ones(n.shape[-1])
        for i in range(size):
            np.minimum(pivot, n[i, i], out=pivot)
            row = n[i, i + 1 :] / n[i, i]
            n[i + 1 :, i + 1 :] -= n[i, i + 1 :, None] * row
            n[i, i + 1 :] = row
    return Factors(scale=scale, upper=n, pivot=pivot)


def solve_positive(
    matrices: Float[Array, "t p p"], right: Float[Array, "t p k"]
) -> tuple[Float[Array, "t p k"], Float[Array, " t"]]:
    """Solve N x = r by Cholesky after scaling N to a unit diagonal."""
    factors = factorize(np.moveaxis(matrices, 0, -1))
    x = factors.solve(np.moveaxis(right, 0, -1))
    return np.moveaxis(x, -1, 0), factors.pivot


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
