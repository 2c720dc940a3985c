r"""Steps in a series of values with known standard errors.

A series is constant but for steps. At each place k and for each span h = 1, 2, 4, ...
up to the whole, the h values before k are compared with the h values from k on. Each
side has its mean with weights :math:`w_i = 1/s_i^2`. Values of one seed draw the same
noise, so their errors add; those of different seeds are independent. With
:math:`S_\ell` the sum of :math:`w_i s_i` over the values of seed :math:`\ell`,

.. math:: V = \sum_\ell S_\ell^2 \Big/ \Big(\sum_i w_i\Big)^2 \tag{D4}

is the variance of a mean, and at most that where the values of one seed are less
correlated. That seeds stand on both sides makes the difference only more certain, as
in eq. (D1). By Bonferroni's rule over all M comparisons the least of them has
:math:`p = 2 M \Phi(-|z|)`.

The comparison that is farthest off splits the series, and each part is searched in the
same way. A step is kept if the levels on its two sides, the means from one step to the
next, differ by as much as the rule asks.
"""

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from math import hypot, inf, sqrt

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.shapes import Float, Int


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Values in order, with their standard errors."""

    values: Float[Array, " n"]
    errors: Float[Array, " n"]  # standard errors, above zero
    seeds: Int[NDArray[np.int64], " n"]  # equal ones draw the same noise
    spans: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        most = max(len(self.values) - 1, 1)
        spans = [2**k for k in range(most.bit_length()) if 2**k < most]
        object.__setattr__(self, "spans", (*spans, most))

    @property
    def comparisons(self) -> int:
        """Number of comparisons, M."""
        return max(len(self.values) - 1, 1) * len(self.spans)

    @cached_property
    def unit(self) -> float:
        """Unit in which all is computed, so that no square overflows."""
        return float(self.errors.max())

    @cached_property
    def _sums(self) -> tuple[Array, Array, Array]:
        """Running sums of w, of w v, and by seed of w s."""
        errors = self.errors / self.unit
        known = np.unique(self.seeds)
        shared = (self.seeds[:, None] == known) / errors[:, None]
        w, v = errors**-2.0, (self.values - self.values[0]) / self.unit
        zero = np.zeros(1)
        return (
            np.concatenate([zero, np.cumsum(w)]),
            np.concatenate([zero, np.cumsum(w * v)]),
            np.concatenate([np.zeros((1, len(known))), np.cumsum(shared, axis=0)]),
        )

    def _mean(
        self, start: Int[NDArray[np.int64], " m"], stop: Int[NDArray[np.int64], " m"]
    ) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        """Mean less the first value, and its variance, eq. (D4), in the unit."""
        weights, products, shared = self._sums
        w = weights[stop] - weights[start]
        parts = shared[stop] - shared[start]
        return (products[stop] - products[start]) / w, np.sum(parts**2, axis=-1) / w**2

    def level(self, start: int, stop: int) -> tuple[float, float]:
        """Mean and its standard error, from `start` until before `stop`."""
        mean, variance = self._mean(np.array([start]), np.array([stop]))
        size = float(self.values[0]) + self.unit * float(mean[0])
        return size, self.unit * sqrt(float(variance[0]))

    def farthest(self, start: int, stop: int) -> tuple[int, float]:
        """Place and size, in standard errors, of the largest difference."""
        best = (start, 0.0)
        k = np.arange(start + 1, stop)
        if not len(k):
            return best
        for h in self.spans:
            before, v = self._mean(np.maximum(k - h, start), k)
            after, u = self._mean(k, np.minimum(k + h, stop))
            z = np.abs(after - before) / np.sqrt(v + u)
            at = int(np.argmax(z))
            if z[at] > best[1]:
                best = (int(k[at]), float(z[at]))
        return best

    def p_value(self, z: float) -> float:
        """Upper bound on the chance that any comparison is so far off."""
        tail = float(scipy.special.ndtr(-z))
        return min(1.0, 2.0 * self.comparisons * tail)


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A step: its place, and the levels before and after it."""

    place: int  # of the first value after it
    before: float
    after: float
    error: float  # standard error of the difference of the levels

    @property
    def z(self) -> float:
        """Size of the step in standard errors."""
        return abs(self.after - self.before) / self.error if self.error else inf


def least_p(series: Series) -> float:
    """Chance of the largest difference if the series has no steps."""
    return series.p_value(series.farthest(0, len(series.values))[1])


def steps_in(series: Series, limit: float, more: float) -> tuple[Found, ...]:
    """Find the steps of a series: the first at one level of p, others at another."""
    n = len(series.values)
    place, z = series.farthest(0, n)
    if series.p_value(z) > limit:
        return ()
    places = [place]
    parts = [(0, place), (place, n)]
    while parts:
        start, stop = parts.pop()
        place, z = series.farthest(start, stop)
        if z > 0.0 and series.p_value(z) <= more:
            places.append(place)
            parts += [(start, place), (place, stop)]
    return _kept(series, sorted(places), limit)


def _kept(series: Series, places: list[int], limit: float) -> tuple[Found, ...]:
    """Drop places one by one while the levels around one do not differ enough."""
    while True:
        found = _levels(series, places)
        weakest = min(found, key=lambda step: step.z)
        if len(found) == 1 or series.p_value(weakest.z) <= limit:
            return tuple(found)
        places = [place for place in places if place != weakest.place]


def _levels(series: Series, places: list[int]) -> list[Found]:
    edges = [0, *places, len(series.values)]
    levels = [series.level(a, b) for a, b in pairwise(edges)]
    return [
        Found(
            place=place, before=old[0], after=new[0],
            error=hypot(old[1], new[1]),
        )
        for place, old, new in zip(places, levels[:-1], levels[1:], strict=True)
    ]  # fmt: skip
