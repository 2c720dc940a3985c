r"""The noise that was drawn, beside what was asked for: no estimator is in between.

A study hands over the noise of each sensor in each block, in units of the deviation
that its parameters state. It is independent standard normal, so

- the mean square of n such numbers is 1, with a standard error of :math:`\sqrt{2/n}`;
- two vectors x, y of m of them have a correlation r = x'y/|x||y| with
  :math:`r \sqrt{(m-1)/(1-r^2)}` Student's t of m - 1 degrees of freedom.  (R1)

The strongest correlation of any two, of two blocks or of two sensors, must stay below
what (R1) exceeds with probability `FALSE_ALARM` in any of the pairs. A stream that is
used twice has the correlation 1.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from simval.arrays import Array
from simval.results import Row, limit, plain
from simval.shapes import Float
from simval.statistics import (
    CHI_SQUARE,
    INDEPENDENT,
    NOISE_SQUARE,
    STRONGEST_CORRELATION,
)

KEPT = 1024
"""Numbers of a block that are compared: two blocks correlate by 0.03, and none of a
thousand by 0.25."""

FALSE_ALARM = 1e-9
"""Of a cell, over all of its pairs."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawn:
    """What is kept of the noise of a sensor in a block."""

    square: float  # sum of squares
    count: int
    first: Float[Array, " m"]  # the first `KEPT`

    @classmethod
    def of(cls, noise: Array) -> "Drawn":
        """Of noise in units of its deviation."""
        flat = np.ravel(noise)
        return cls(
            square=float(np.vdot(flat, flat)),
            count=flat.size,
            first=flat[:KEPT].copy(),
        )


def drawn_rows(blocks: Sequence[Mapping[str, Drawn]]) -> tuple[Row, ...]:
    """Rows of the noise of some blocks, of each sensor by its name."""
    strongest = correlation_row(each.first for b in blocks for each in b.values())
    return square_rows(blocks) + strongest


def square_rows(blocks: Sequence[Mapping[str, Drawn]]) -> tuple[Row, ...]:
    """Mean squares of the noise of some blocks, of each sensor by its name."""
    rows: tuple[Row, ...] = ()
    for name in blocks[0]:
        n = sum(block[name].count for block in blocks)
        square = sum(block[name].square for block in blocks) / n
        error = float(np.sqrt(2.0 / n))
        rows += plain(NOISE_SQUARE(name), square, error, n, 1.0, CHI_SQUARE)
    return rows


def correlation_row(vectors: Iterable[Array]) -> tuple[Row, ...]:
    """The strongest correlation of two vectors of noise, beside what chance reaches."""
    given = [np.ravel(vector) for vector in vectors]
    m = min(len(vector) for vector in given)
    X = np.array([vector[:m] for vector in given])
    X /= np.maximum(np.linalg.norm(X, axis=1), np.finfo(float).tiny)[:, None]
    r = np.minimum(np.abs(X @ X.T), 1.0)  # of equal ones, rounding
    np.fill_diagonal(r, 0.0)
    most = strongest_by_chance(len(X), m)
    return limit(STRONGEST_CORRELATION(), r.max(), most, INDEPENDENT, n=m)


def strongest_by_chance(count: int, m: int) -> float:
    """Correlation that any two of so many reach with probability `FALSE_ALARM`."""
    pairs = max(count * (count - 1) // 2, 1)
    t = float(scipy.special.stdtrit(m - 1, FALSE_ALARM / (2.0 * pairs)))
    return float(np.sqrt(t * t / (m - 1 + t * t)))
