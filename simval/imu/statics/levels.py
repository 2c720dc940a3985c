r"""Rests split by their own rows, where they contain a step or a slope.

A window of the detector that holds two positions a few degrees apart may vary less than
its threshold allows. Where one level ends and another begins, the means of up to
`REACH` before and after differ, by the vector :math:`\Delta`, with n and n' blocks of
`BLOCK` in them. A rest is cut where

.. math:: |\Delta| > \theta r + c\,\sqrt{\kappa q_\Delta^2 (1/n + 1/n')}, \quad
   c^2 = \chi^2_{3}(1 - \alpha/N), \tag{D3}

is exceeded the most, and its parts again, until none is. Here r is gravity in the unit
of the readings, by the scatter of the means of the rests, :math:`q_\Delta^2` the
variance of the mean of a block along :math:`\Delta`, by differences of successive ones
within the rest less their median, and N the number of ticks in rests. Levels cut with
:math:`\kappa = 1` show how much more means of `WIDE` scatter within them (a trembling
hand, flicker); with that the rests are cut anew, until no cut goes. A log of rests of
one level loses a part of one with a chance below :math:`\alpha`.

What is below :math:`\theta` is left: a hand creeps by some tenths of a degree, and a
step of it shortens the mean of a rest by :math:`\theta^2/8`, 6e-6 of gravity.
A slope is a row of short levels, which leaves the rest out; a drift of less than
:math:`\theta` in `REACH`, such as that of a sensor that warms up, is none.
"""

from itertools import chain
from typing import NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.imu.statics.detector import EvenLog, Intervals
from simval.shapes import Float

FALSE_ALARM = 1e-3  # chance that a log whose rests are still loses a part of one
BLOCK = 0.1  # s; slower than the band of a sensor, faster than a hand turns
WIDE = 0.5  # s; of the means that show how slow the noise is
REACH = 2.0  # s; on either side of a step
SHORTEST = 0.25  # s; of a level
LEAST = np.radians(0.4)  # of a step
FEW = 6  # rests and more, whose means scatter by gravity
ONE_POSE = 60.0  # times it: by a degree or so, if all are in one pose
MEDIAN = 0.4549  # of the square of a normal variable


class Step(NamedTuple):
    """A rest that contains more than one level."""

    rest: tuple[int, int]  # rows start <= k < stop
    levels: tuple[tuple[int, int], ...]  # those that are long enough, rows
    angle: float  # of the greatest step, rad


def single_levels(even: EvenLog, rests: Intervals) -> tuple[Intervals, list[Step]]:
    """Split the rests of a log where their level changes, if there are six or more.

    Parameters
    ----------
    even : EvenLog
        Readings of the accelerometer.
    rests : Intervals
        Rows of each rest, start <= k < stop, (m, 2).

    Returns
    -------
    tuple of Intervals and list of Step
        Rows that are of one level each, and each rest that was cut or left out.
    """
    if len(rests) < FEW:
        return rests, []
    ticks = ticks_of(even, rests)
    parts = [even.samples[start:stop] for start, stop in ticks]
    means = np.array([part.mean(axis=0) for part in parts])
    gravity = float(np.sqrt(means.var(axis=0).sum()))
    if ONE_POSE * gravity < np.linalg.norm(means, axis=1).max():
        return rests, []
    short, least = round(SHORTEST * even.rate), LEAST * gravity
    # no two means within a rest differ by more than those of the shortest level do
    moving = [_range(part, short) > least for part in parts]
    if not any(moving):
        return rests, []
    block, reach = block_size(even), round(REACH * even.rate)
    own = np.array([_noise(each) for each in block_differences(even, parts)])
    noise = np.maximum(own, np.median(own, axis=0))
    tail = FALSE_ALARM / np.ptp(ticks, axis=1).sum()
    limit = block * float(scipy.special.chdtri(3, tail))

    def cuts(slow: float) -> list[list[tuple[int, float]]]:
        return [
            _cuts(part, short, reach, least, slow * limit * own) if moves else []
            for part, moves, own in zip(parts, moving, noise, strict=True)
        ]

    found, before = cuts(1.0), len(even.samples)
    # levels that are too short hide how slow the noise is, and show it as they join
    while 0 < (count := sum(map(len, found))) < before:
        before = count
        rows = [[row for row, _ in at] for at in found]
        each = np.repeat(noise, [len(at) + 1 for at in rows], axis=0)
        cut = [np.split(*own) for own in zip(parts, rows, strict=True)]
        found = cuts(colour(even, list(chain(*cut)), each))
    kept, steps = [], []
    for rest, span, at in zip(rests, ticks, found, strict=True):
        levels = even.rows(_long(even, block, span, [row for row, _ in at]))
        kept.append(levels if at else rest[None])
        if at:
            angle = float(max(size for _, size in at) / gravity)
            whole, *pieces = ((int(a), int(b)) for a, b in (rest, *levels))
            steps.append(Step(whole, tuple(pieces), angle))
    return np.concatenate(kept), steps


def _long(even: EvenLog, margin: int, span: Intervals, at: list[int]) -> Intervals:
    # levels of a rest that last long enough, without a margin on both sides of a step
    edges = span[0] + np.array([0, *at, span[1] - span[0]])
    levels = np.stack([edges[:-1], edges[1:]], axis=1)
    levels[1:, 0] += margin
    levels[:-1, 1] -= margin
    kept: Intervals = levels[np.ptp(levels, axis=1) >= min(even.minimum, np.ptp(span))]
    return kept


def _noise(steps: Array) -> Array:
    # variance of the mean of a block by such differences, without a slope
    own = steps - np.median(steps, axis=0)
    return np.median(own**2, axis=0) / (2.0 * MEDIAN)


def _range(part: Array, size: int) -> float:
    # of the means of all windows of so many ticks
    total = np.cumsum(np.pad(part, ((1, 0), (0, 0))), axis=0)
    return float(np.linalg.norm(np.ptp(total[size:] - total[:-size], axis=0))) / size


def _cuts(
    part: Array, short: int, reach: int, least: float, square: Array, first: int = 0
) -> list[tuple[int, float]]:
    # (D3): where, and how far apart; square: c^2 times the variance of a row's noise
    stop = len(part)
    at = np.arange(short, stop - short + 1)
    if not len(at):
        return []
    total = np.cumsum(np.pad(part - part[0], ((1, 0), (0, 0))), axis=0)
    before, after = np.minimum(at, reach), np.minimum(stop - at, reach)
    step = (total[at + after] - total[at]) / after[:, None]
    step -= (total[at] - total[at - before]) / before[:, None]
    size = np.linalg.norm(step, axis=1)
    chance = np.sqrt(step**2 @ square * (1.0 / before + 1.0 / after))
    over = size - least - chance / np.where(size > 0.0, size, 1.0)
    best = int(np.argmax(over))
    if not over[best] > 0.0:
        return []
    row, common = int(at[best]), (short, reach, least, square)
    return [
        *_cuts(part[:row], *common, first),
        (first + row, float(size[best])),
        *_cuts(part[row:], *common, first + row),
    ]


def ticks_of(even: EvenLog, rests: Intervals) -> Intervals:
    """Ticks that rests of rows cover."""
    return np.stack([even.tick[rests[:, 0]], even.tick[rests[:, 1] - 1] + 1], axis=1)


def block_size(even: EvenLog) -> int:
    """Number of ticks in a block."""
    return max(1, round(BLOCK * even.rate))


def block_differences(even: EvenLog, parts: list[Array]) -> list[Array]:
    """Differences of the means of successive blocks of each part."""
    return [np.diff(_block_means(part, block_size(even)), axis=0) for part in parts]


def colour(even: EvenLog, parts: list[Array], noise: Float[Array, "m 3"]) -> float:
    """Variance of longer means relative to white noise of the blocks; at least 1."""
    block = block_size(even)
    size, ratio = round(WIDE * even.rate / block), []
    for part, square in zip(parts, noise, strict=True):
        wide = _block_means(_block_means(part, block), size)
        if len(wide) > 1 and (square > 0.0).all():
            ratio.append(np.mean(wide.var(axis=0, ddof=1) / (square / size)))
    return max(1.0, float(np.median(ratio))) if ratio else 1.0


def _block_means(part: Array, size: int) -> Array:
    count = len(part) // size
    return part[: count * size].reshape(count, size, 3).mean(axis=1)
