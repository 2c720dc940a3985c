r"""Interval of a median, whatever the distribution: the sign test turned round.

Each of n independent values is below the median of their distribution with chance one
half, so of the sorted values :math:`x_{(1)} \le \dots \le x_{(n)}`

.. math:: P\{x_{(k)} \le m \le x_{(n+1-k)}\} \ge
   1 - 2^{1-n} \sum_{i=0}^{k-1} \binom{n}{i},  \tag{B1}

with equality where no two values can be equal. Seven rounds from the least to the
greatest have 98.4 %, six 96.9 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from typing import Final

CONFIDENCE: Final = 0.98
"""Least confidence that is asked for: seven rounds have it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """Interval of a median.

    Attributes
    ----------
    low, high : float
        Its ends.
    confidence : float
        At least this, eq. (B1).
    """

    low: float
    high: float
    confidence: float


def confidence_of(n: int, k: int) -> float:
    """Chance that the median is from the k-th to the k-th last of n, eq. (B1)."""
    return _share(sum(comb(n, i) for i in range(k)), n)


def _share(beyond: int, n: int) -> float:
    # of whole numbers, for a float has no 2**1024
    return (2**n - 2 * beyond) / 2**n


def median_interval(
    values: Sequence[float], confidence: float = CONFIDENCE
) -> Interval:
    """Shortest interval (B1) of this confidence; all values where there is none."""
    ordered, n = sorted(values), len(values)
    k = place_of(n, confidence)
    return Interval(
        low=ordered[k - 1],
        high=ordered[n - k],
        confidence=max(0.0, confidence_of(n, k)),
    )


def place_of(n: int, confidence: float = CONFIDENCE) -> int:
    """Greatest k whose interval of n values has this confidence, or 1."""
    k, term, beyond = 1, n, 1  # of the 2**n signs, 2 beyond are beyond the k-th
    while k < (n + 1) // 2 and _share(beyond + term, n) >= confidence:
        beyond += term
        term = term * (n - k) // (k + 1)
        k += 1
    return k


def rounds_for(confidence: float = CONFIDENCE) -> int:
    """Least number of rounds whose interval has this confidence."""
    n = 1
    while confidence_of(n, 1) < confidence:
        n += 1
    return n
