r"""Error bars of a fit whose residuals are correlated: leave out one block at a time.

The rows are cut into blocks of time with equal shares of the information. Residuals
within a block may be correlated in any way; between blocks they are taken as
independent. At the solution, where residuals r with derivatives J are orthogonal to
instruments Z (J itself in least squares), and :math:`H_b, g_b` are a block's share of
Z'J and Z'r,

.. math:: \delta_b = (H - H_b)^{-1} g_b, \quad
   \mathrm{cov} = \tfrac{B - 1}{B} \sum_b (\delta_b - \bar\delta)(\delta_b -
   \bar\delta)'. \tag{R2}

What all blocks have in common, as a constant error of the model, does not show in it.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from simval.arrays import Array
from simval.shapes import Float, Int

BLOCKS: Final = 24
"""As many as Student's t with one less is 4 % wider than the normal; more are shorter,
and their neighbours are no longer independent."""

COVERAGE: Final = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A number with its error bar."""

    value: float
    sd: float
    dof: int  # of its standard deviation

    @property
    def half(self) -> float:
        """Half width of the 95 % interval, Student's t."""
        return self.sd * quantile(self.dof)


def quantile(dof: int, coverage: float = COVERAGE) -> float:
    """Two-sided quantile of Student's t."""
    return float(scipy.special.stdtrit(dof, 0.5 + 0.5 * coverage))


def block_of(
    weight: Float[Array, " m"], blocks: int = BLOCKS
) -> tuple[Int[np.ndarray, " m"], int]:
    """Block of each row, of equal shares of a weight, and how many there are."""
    share = np.cumsum(weight) / np.sum(weight)
    found = np.minimum((share * blocks * (1.0 - 1e-12)).astype(int), blocks - 1)
    _, number = np.unique(found, return_inverse=True)
    return number, int(number[-1]) + 1


def jackknife(
    instruments: Float[Array, "m k p"],
    rows: Float[Array, "m k p"],
    residuals: Float[Array, "m k"],
    block: Int[np.ndarray, " m"],
) -> Float[Array, "p p"]:
    """Covariance of a solution by eq. (R2)."""
    count, p = int(block.max()) + 1, rows.shape[-1]
    each_H = np.einsum("mkp,mkq->mpq", instruments, rows)
    each_g = np.einsum("mkp,mk->mp", instruments, residuals)
    H, g = np.zeros((count, p, p)), np.zeros((count, p))
    np.add.at(H, block, each_H)
    np.add.at(g, block, each_g)
    moved = np.linalg.solve(H.sum(axis=0) - H, g[..., None])[..., 0]
    off = moved - moved.mean(axis=0)
    return (count - 1) / count * off.T @ off


def mean_with_error(
    values: Float[Array, "m k"], blocks: int = BLOCKS
) -> tuple[Float[Array, " k"], Float[Array, "k k"], int]:
    """Mean of correlated rows, its covariance by blocks, and degrees of freedom."""
    block, count = block_of(np.ones(len(values)), min(blocks, len(values)))
    mean = values.mean(axis=0)
    rows = np.broadcast_to(np.eye(values.shape[1]), (*values.shape, values.shape[1]))
    return mean, jackknife(rows, rows, mean - values, block), count - 1
