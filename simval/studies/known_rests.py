r"""Rests that are known to the sample: where a detector must put their edges.

A signal without chance: at rest every axis alternates between its level and :math:`\pm
a`, in between it alternates by far more. A window of w samples, odd, then has the
variance :math:`a^2 (w+1)/w` on each axis wherever it lies within a rest, and far more
where it holds one sample of a move. So a rest of samples [p, q) is found as [p + h + t,
q - h - t), with h = (w-1)/2 and t what is trimmed, and the mean of an even number of
samples is its level.

The first rest, of n samples, makes the threshold :math:`m a^2 n/(n-1)`. Two more are
made for the threshold itself, `NEAR` below it and above it: the former is found, the
latter is not. All of it is arithmetic: nothing but rounding may differ.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.results import Row, exact
from simval.shapes import Float, Int
from simval.statistics import COUNT_OFF, EDGE_OFF, KNOWN_RESTS, KNOWN_SCENE, MEAN_OFF

NEAR = 1e-3
"""Of the threshold. The variance by n and by n - 1 differs by 2 % in a window of 51
samples, and by 0.2 % in a rest of 500."""
MOVE = 1e3
"""Of the deviation at the threshold: one sample of it in a window is far above."""
MULTIPLIERS = (2.0, 1e4)
"""A rest is to be found at any threshold between these."""
ROUNDED = 1e-9
"""Of the amplitude: levels of a hundred amplitudes, summed by the hundred."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownRests:
    """A signal and what is to be found in it."""

    samples: Float[Array, "n 3"]
    intervals: Int[Array, "m 2"]
    means: Float[Array, "m 3"]


def known_rests(multiplier: float, window: int, trim: int) -> KnownRests:
    """The signal for a detector with these settings."""
    half, move = window // 2, window + 9
    first = 2 * (half + trim) + 10 * window  # even, like all of them
    length = first - 6 * window
    scale = (first - 2 * half) / (first - 2 * half - 1) / ((window + 1) / window)
    near = np.sqrt(multiplier * scale * (1.0 + NEAR * np.array([-1.0, 1.0])))
    amplitudes = [1.0, 1.0, float(near[0]), float(near[1]), 1.0]
    levels = 25.0 * np.array(
        [[0, 0, 4], [3, -1, 2], [-2, 3, 1], [1, 1, 1], [-4, 0, 1]], dtype=float
    )
    parts, intervals, means, at = [], [], [], 0
    for k, (amplitude, level) in enumerate(zip(amplitudes, levels, strict=True)):
        count = first if k == 0 else length + 2 * k
        parts += [level + _alternating(count, amplitude)]
        if k != 3:  # which is above the threshold
            intervals.append([at + half + trim, at + count - half - trim])
            means.append(level)
        parts += [_alternating(move, MOVE * float(near[1]))]
        at += count + move
    samples = np.concatenate(parts)
    return KnownRests(
        samples=samples, intervals=np.array(intervals), means=np.array(means)
    )


def known_rest_rows(
    detect: Callable[..., Any],
    means: Callable[..., Array],
    counts: Callable[..., Any],
    settings: tuple[float, int, int],
) -> tuple[Row, ...]:
    """Rows of a detector, and of the means and counts of what it finds."""
    if not MULTIPLIERS[0] <= settings[0] <= MULTIPLIERS[1]:
        return ()
    known = known_rests(*settings)
    found = np.asarray(detect(known.samples, *settings)[0])
    rows = exact(KNOWN_RESTS(), len(found), len(known.intervals), KNOWN_SCENE, 0.0)
    if found.shape != known.intervals.shape:
        return rows
    edges = np.abs(found - known.intervals).max()
    off = np.abs(means(known.samples, known.intervals) - known.means).max()
    more = np.abs(counts(known.intervals) - np.diff(known.intervals)[:, 0]).max()
    return (
        *rows,
        *exact(EDGE_OFF(), edges, 0.0, KNOWN_SCENE, 0.0),
        *exact(MEAN_OFF(), off, 0.0, KNOWN_SCENE, ROUNDED),
        *exact(COUNT_OFF(), more, 0.0, KNOWN_SCENE, 0.0),
    )


def _alternating(count: int, amplitude: float) -> Float[Array, "n 3"]:
    sign = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    return np.repeat(amplitude * sign[:, None], 3, axis=1)
