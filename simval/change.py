r"""The change of a number: same, close, moved or changed.

A baseline is a small run, so the gate (which compares with its baseline) and `simval
compare` (which compares with another run) need the same: which cells belong together
(`matched`); on the same noise, whether a value moved by more than rounding
(`on_same_noise`); and on other noise, whether two values are equivalent
(`on_other_noise`) or differ significantly (`holm`).

On other noise the values always differ; the question is by how much. With
:math:`d` the difference, :math:`s` its standard error and :math:`m` the margin of the
statistic,

.. math:: |d| + z_{0.95}\, s \le m  \tag{B1}

shows equivalence by two one-sided tests of size 0.05; :math:`|d| - z\, s > m`, with z
from the comparisons' share of the false-alarm rate by Bonferroni's rule, shows a
change; and anything between is not resolved by so many samples. Many values are decided
at once, a column each.
"""

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping
from typing import Any, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.shapes import Float, Shaped

A = TypeVar("A")
B = TypeVar("B")

EFFORT = ("samples", "trials")
"""Parameters that say how much was computed, not what."""

PAIRED_BOUND = 1e-3
"""Standard errors that a value drawn from the same noise may move by rounding. Bounded:
another order of summation moves a mean of n samples by at most n eps of their size,
n^1.5 eps = 2e-6 standard errors of 4e6 samples whose size is their spread."""

EXACT_BOUND = 1e-6
"""Relative change that a deterministic value may show: rounding, amplified by a
condition of up to EXACT_BOUND / eps = 4.5e9."""

ROUNDING = 1e-13
"""Change that a deterministic value may always show, in its SI unit: the rounding
noise of a difference of numbers of size one."""

PAIRED_SHARE = 0.1
"""Share of what a value is judged to by which it may move: of the remainder of an exact
row, of the standard error and remainder of a mean. Chosen: what is left, nine tenths,
still judges the value."""

ROUNDED_MEAN = 1e-14
"""Change that a mean over samples may show, in its SI unit, up to `PAIRED_SHARE` of
what it is judged to: an estimate less its truth is rounded like the numbers of size one
to ten that it is the difference of, however little chance control variates leave it.
Over five kinds of processor kernels 2.5e-15 was the most seen."""

JUDGING_BOUND = 1e-3
"""Relative change of a standard error, a limit or a remainder that is rounding. Chosen:
it moves a distance of five standard errors by 0.005 of them."""

TOST_QUANTILE = 1.6448536269514722
"""Normal quantile of each of the two one-sided tests of equivalence, each at 5 %:
``scipy.special.ndtri(0.95)``, written out because its import takes 0.2 s."""


def question(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters of a cell, without those that only say how much was computed."""
    return {k: v for k, v in sorted(parameters.items()) if k not in EFFORT}


def matched(
    old: Iterable[A],
    new: Iterable[B],
    asked: Callable[[A | B], Hashable],
    same: Callable[[A | B], Hashable],
) -> tuple[list[tuple[A, B]], list[A], list[B]]:
    """Pair items of equal `asked`: those of equal `same` first, the rest in order.

    After the pairs come the items that only `old` has and those that only `new` has,
    each in its own order.
    """
    left, right = _grouped(old, asked), _grouped(new, asked)
    pairs: list[tuple[A, B]] = []
    only_old: list[A] = []
    only_new = [item for key in right if key not in left for item in right[key]]
    for key, members in left.items():
        others = right.get(key, [])
        twins: dict[Hashable, deque[int]] = {}
        for place, other in enumerate(others):
            twins.setdefault(same(other), deque()).append(place)
        rest, taken = [], set()
        for item in members:
            places = twins.get(same(item))
            if not places:
                rest.append(item)
                continue
            pairs.append((item, others[places[0]]))
            taken.add(places.popleft())
        free = [other for place, other in enumerate(others) if place not in taken]
        count = min(len(rest), len(free))
        pairs += zip(rest[:count], free[:count], strict=True)
        only_old += rest[count:]
        only_new += free[count:]
    return pairs, only_old, only_new


def _grouped(
    items: Iterable[A], key: Callable[[A], Hashable]
) -> dict[Hashable, list[A]]:
    groups: dict[Hashable, list[A]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


Values = Float[Array, " n"]
Words = Shaped[NDArray[np.str_], " n"]


@np.errstate(all="ignore")  # what is no number has changed
def on_same_noise(old: Values, new: Values, bound: Values) -> Words:
    """Answer for each value: ``same``, ``close`` within rounding, or ``changed``."""
    step = np.abs(new - old)
    close = np.isfinite(step) & (step <= bound)
    return np.select([new == old, close], ["same", "close"], "changed")


@np.errstate(all="ignore")  # what is no number has changed
def on_other_noise(
    distance: Values, error: Values, margin: Values, quantile: float
) -> Words:
    """``equivalent`` by eq. (B1), ``changed`` by the reverse, or ``unresolved``."""
    near = distance + TOST_QUANTILE * error <= margin
    far = ~(distance - quantile * error <= margin)
    return np.select([near, far], ["equivalent", "changed"], "unresolved")


def rounding_bound(value: Values, error: Values, remainder: Values) -> Values:
    """Largest change that rounding alone makes in values with the same noise.

    Processors sum in other orders, and what a value is judged to is its standard error
    and the least remainder that a theory allows it; 0 of one that has none.
    """
    share = PAIRED_SHARE * (error + remainder)
    chance = np.maximum(PAIRED_BOUND * error, np.minimum(ROUNDED_MEAN, share))
    exact = np.maximum(EXACT_BOUND * np.abs(value), ROUNDING)
    exact = np.maximum(exact, PAIRED_SHARE * remainder)
    return np.asarray(np.where(error > 0.0, chance, exact), dtype=float)


def is_near(old: float, new: float, relative: float, least: float = 0.0) -> bool:
    """True if a number equals another up to rounding; NaN does not."""
    return abs(new - old) <= max(least, relative * abs(old))


@np.errstate(all="ignore")  # what is no number has changed
def two_sided(difference: Values, error: Values) -> Values:
    """Probability of a difference at least so great by chance; 0 for NaN."""
    known = np.isfinite(difference) & np.isfinite(error)
    p = 2.0 * scipy.special.ndtr(-np.abs(difference) / error)
    return np.asarray(np.where(known, p, 0.0), dtype=float)


def holm(values: Values, alpha: float) -> Values:
    """Limit of each p-value by Holm's step-down rule.

    The k-th smallest of m is compared with alpha / (m - k + 1), and once one is kept
    all larger ones are. So every member of a family gets the limit at which the
    procedure stopped, or its own where it was rejected before.
    """
    m = len(values)
    order = np.argsort(values, kind="stable")
    steps = alpha / (m - np.arange(m))
    kept = values[order] > steps
    stop = int(np.argmax(kept)) if kept.any() else m - 1
    limits = np.empty(m)
    limits[order] = np.minimum(steps, steps[stop]) if m else alpha
    return limits
