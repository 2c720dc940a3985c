r"""Rests during which the gyroscope turns: the turning part is cut off.

A turn about the vertical leaves an accelerometer as it is. In a rest the mean of a
gyroscope's readings over `WINDOW` is its bias and noise,

.. math:: |\bar y_a - \beta_a(t)| \le t_{k-2}\!\left(1 - \tfrac{\alpha}{6N}\right)
   \sqrt{S_a^2 d + \kappa q_a^2/m}, \quad a = 1, 2, 3, \tag{D2}

with :math:`\beta` the line through the medians of the rests (Theil 1950, Sen 1968), S
their scatter about it, :math:`q^2/m` what the noise of a rest leaves in a mean of m
blocks of 0.1 s, by the differences of successive ones, and :math:`\kappa \ge 1` how
much more the means of a typical rest scatter: trembling hands. N is the number of
blocks, so that a log of still rests has an alarm with a chance of about
:math:`\alpha`. A bias that walks leaves more at a distance from the other rests: d is
that over the usual one, 1 at least. S is of the k rests that agree: the closest half to
begin with, then one by one the closest that (D2) lets in (a forward search), so that
nearly half of the rests may turn.
"""

from typing import NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.imu.statics.detector import EvenLog, Intervals, runs_of
from simval.imu.statics.levels import (
    FALSE_ALARM,
    MEDIAN,
    block_differences,
    block_size,
    colour,
    ticks_of,
)
from simval.shapes import Float

WINDOW = 0.5  # s; of the means that are judged
LEAST = 1e-4  # of the log's rates: a scale is not known to less, a simulated one has no
# noise, and then a motion that ends smoothly would never end


class Cut(NamedTuple):
    """A rest during which the gyroscope turns."""

    rest: tuple[int, int]  # rows start <= k < stop
    kept: tuple[int, int] | None  # of these what is still, None of too little
    rate: float  # greatest mean off the bias, raw units
    chance: float  # what it may be by chance


class _Still(NamedTuple):
    # what a gyroscope shows where it is still
    level: Float[Array, "m 3"]  # median of each rest
    middle: Float[Array, " m"]  # its middle, ticks
    slope: Float[Array, "3"]
    start: Float[Array, "3"]
    noise: Float[Array, "m 3"]  # variance of a block of each rest, kappa times
    scatter: Float[Array, "3"]  # variance of the levels
    freedom: int
    spacing: float  # ticks from rest to rest

    def off(self, mean: Array, at: Array) -> Array:
        # of the bias
        return mean - self.start - at[:, None] * self.slope

    def limit(self, noise: Array, tries: int, away: Array) -> Array:
        # (D2); noise: of the means, away: ticks to the nearest other rest
        tail = FALSE_ALARM / (6.0 * tries)
        far = np.maximum(away / self.spacing, 1.0)[:, None]
        t = -float(scipy.special.stdtrit(self.freedom, tail))
        return t * np.sqrt(self.scatter * far + noise)


def still_parts(even: EvenLog, rests: Intervals) -> tuple[Intervals, list[Cut]]:
    """Cut off the turning parts of a log's rests, if there are four or more.

    Parameters
    ----------
    even : EvenLog
        Readings of the gyroscope.
    rests : Intervals
        Rows of each rest, start <= k < stop, (m, 2).

    Returns
    -------
    tuple of Intervals and list of Cut
        Rows in which it is still, and each rest that was cut or left out.
    """
    ticks = ticks_of(even, rests)
    if len(ticks) < 4:
        return rests, []
    still = _still(even, ticks)
    kept, cuts = [], []
    for k, rest in enumerate(ticks):
        part, rate, chance = _part(even, still, ticks, k)
        rows = None if part is None else even.rows(np.array([part]))[0]
        if part != (rest[0], rest[1]):
            whole = (int(rests[k, 0]), int(rests[k, 1]))
            left = None if rows is None else (int(rows[0]), int(rows[1]))
            cuts.append(Cut(whole, left, rate, chance))
        else:
            rows = rests[k]
        if rows is not None:
            kept.append(rows)
    return np.array(kept, dtype=np.intp).reshape(-1, 2), cuts


def _means(samples: Array, size: int) -> Array:
    # of all windows of so many ticks
    total = np.cumsum(np.pad(samples, ((1, 0), (0, 0))), axis=0)
    return (total[size:] - total[:-size]) / size


def _part(
    even: EvenLog, still: _Still, ticks: Intervals, k: int
) -> tuple[tuple[int, int] | None, float, float]:
    # longest part of a rest in which (D2) holds, and the greatest rate in it
    start, stop = (int(edge) for edge in ticks[k])
    half = min(round(0.5 * WINDOW * even.rate), (stop - start - 1) // 2)
    size = 2 * half + 1
    samples = even.samples[start:stop]
    centre = np.arange(start + half, stop - half) + 0.5
    away = _away(ticks, k, centre)
    block = block_size(even)
    tries = max(1, int(np.ptp(ticks, axis=1).sum()) // block)
    off = np.abs(still.off(_means(samples, size), centre))
    limit = still.limit(still.noise[k] * block / size, tries, away)
    row, axis = np.unravel_index(int(np.argmax(off / limit)), off.shape)
    rate, chance = float(off[row, axis]), float(limit[row, axis])
    still_rows = np.asarray((off <= limit).all(axis=1))
    runs = runs_of(still_rows) + start + half
    if len(runs) == 0:
        return None, rate, chance
    first, end = (int(edge) for edge in runs[np.argmax(np.ptp(runs, axis=1))])
    first = start if first == start + half else first
    end = stop if end == stop - half else end
    if end - first < min(even.minimum, stop - start):
        return None, rate, chance
    whole = even.samples[first:end].mean(axis=0)
    middle = np.array([0.5 * (first + end)])
    mean = np.abs(still.off(whole, middle))[0]
    most = still.limit(
        still.noise[k] * block / (end - first), len(ticks), _away(ticks, k, middle)
    )[0]
    if (mean > most).any():
        worst = int(np.argmax(mean / most))
        return None, float(mean[worst]), float(most[worst])
    return (first, end), rate, chance


def _away(ticks: Intervals, k: int, at: Array) -> Array:
    # from the nearest middle of another rest
    others = np.delete(ticks.mean(axis=1), k)
    return np.abs(at[:, None] - others).min(axis=1)


def _still(even: EvenLog, ticks: Intervals) -> _Still:
    parts = [even.samples[a:b] for a, b in ticks]
    level = np.array([np.median(part, axis=0) for part in parts])
    middle = ticks.mean(axis=1)
    blocks = block_differences(even, parts)
    square = np.array([np.median(own**2, axis=0) for own in blocks]) / (2.0 * MEDIAN)
    noise = colour(even, parts, square) * np.maximum(square, np.median(square, axis=0))
    i, j = np.triu_indices(len(ticks), 1)
    slopes = (level[j] - level[i]) / (middle[j] - middle[i])[:, None]
    slope = np.median(slopes, axis=0)
    start = np.median(level - middle[:, None] * slope, axis=0)
    off = level - start - middle[:, None] * slope
    own = noise * block_size(even) / np.ptp(ticks, axis=1)[:, None]
    steps = np.abs(np.diff(even.samples, axis=0))
    coarse = np.min(np.where(steps > 0.0, steps, np.inf), axis=0)
    coarse = np.where(np.isfinite(coarse), coarse, 1.0) ** 2 / 12.0
    coarse += LEAST**2 * even.samples.var(axis=0).mean()
    near = off**2 / (own + np.median(off**2, axis=0) + coarse)
    chosen = list(np.argsort(near.max(axis=1))[: len(ticks) // 2 + 1])
    while True:
        found = _Still(
            level=level,
            middle=middle,
            slope=slope,
            start=start,
            noise=noise,
            scatter=np.mean(off[chosen] ** 2, axis=0) + coarse,
            freedom=len(chosen) - 2,
            spacing=float(np.median(np.diff(middle))),
        )
        over = (np.abs(off) / found.limit(own, len(ticks), 0.0 * middle)).max(axis=1)
        over[chosen] = np.inf
        closest = int(np.argmin(over))
        if not over[closest] <= 1.0:
            return found
        chosen.append(closest)
