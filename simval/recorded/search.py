"""Where on the truth's clock a log lies: by the size of the rate, in whatever axes.

Both are brought to an even clock and correlated at every shift that leaves enough
overlap, with holes left out (Pearson's coefficient of what both have at that shift).
"""

from typing import Final

import numpy as np
import scipy

from simval.arrays import Array
from simval.errors import RefusedError
from simval.recorded.attitudes import Attitudes, turned
from simval.recorded.turns import STRETCH
from simval.shapes import Float

OVERLAP: Final = 0.3
"""Least share of the shorter recording that the other one must cover: with less, two
short pieces that happen to look alike win."""

SECONDS: Final = 4.0  # s; least overlap, as of the fit
APART: Final = 1.0  # s; maxima nearer than this are one
MOST: Final = 3  # maxima that are tried by a fit
LONGEST: Final = 1 << 20  # ticks of an even clock: 29 hours


def likely_offsets(
    time: Float[Array, " n"], gyro: Float[Array, "n 3"], attitudes: Attitudes
) -> list[float]:
    """Offsets of the truth's clock against the log's, s, the likeliest first.

    Raises
    ------
    RefusedError
        If nothing moves, or either is too long or too short.
    """
    log, truth = _log_rate(time, gyro), _truth_rate(attitudes)
    if max(len(log), len(truth)) > LONGEST:
        msg = (
            f"log and truth last {len(log) * STRETCH:.6g} s and "
            f"{len(truth) * STRETCH:.6g} s; cut them to {LONGEST * STRETCH:.0f} s"
        )
        raise RefusedError(msg)
    correlation = _correlation(truth, log)
    if not np.isfinite(correlation).any():
        msg = (
            "truth and gyroscope do not move together for "
            f"{SECONDS:g} s at any shift of their clocks; give the truth of this log, "
            "recorded while the sensor turned"
        )
        raise RefusedError(msg)
    found: list[float] = []
    apart = max(1, round(APART / STRETCH))
    for _ in range(MOST):
        best = int(np.nanargmax(correlation))
        shift = best - (len(log) - 1)
        found.append(shift * STRETCH + float(attitudes.time[0] - time[0]))
        correlation[max(0, best - apart) : best + apart + 1] = np.nan
        if not np.isfinite(correlation).any():
            break
    return found


def _log_rate(
    time: Float[Array, " n"], gyro: Float[Array, "n 3"]
) -> Float[Array, " t"]:
    # about the median, which is the bias of a sensor that rests, and of counts
    centred = gyro - np.median(gyro, axis=0)
    sums = np.cumsum(centred[1:] * np.diff(time)[:, None], axis=0)
    ticks = np.arange(time[0], time[-1], STRETCH)
    at = np.column_stack([np.interp(ticks, time[1:], sums[:, k]) for k in range(3)])
    return np.linalg.norm(np.diff(at, axis=0), axis=1)


def _truth_rate(attitudes: Attitudes) -> Float[Array, " t"]:
    ticks = np.arange(attitudes.time[0], attitudes.time[-1], STRETCH)
    q = attitudes.at(ticks)
    return np.linalg.norm(turned(q[:-1], q[1:]), axis=1)


def _correlation(a: Float[Array, " n"], b: Float[Array, " m"]) -> Float[Array, " k"]:
    # Pearson's coefficient of a[s + j] with b[j] for s from -(m - 1) on; NaN where they
    # share too little, or one does not vary
    def sums(x: Array, y: Array) -> Array:
        return scipy.signal.fftconvolve(x, y[::-1])

    mask_a, mask_b = np.isfinite(a).astype(float), np.isfinite(b).astype(float)
    a, b = np.where(mask_a > 0.0, a, 0.0), np.where(mask_b > 0.0, b, 0.0)
    a, b = a / max(a.max(initial=0.0), 1e-300), b / max(b.max(initial=0.0), 1e-300)
    count = np.maximum(np.round(sums(mask_a, mask_b)), 1.0)
    mean_a, mean_b = sums(a, mask_b) / count, sums(mask_a, b) / count
    var_a = sums(a * a, mask_b) / count - mean_a**2
    var_b = sums(mask_a, b * b) / count - mean_b**2
    both = sums(a, b) / count - mean_a * mean_b
    least = max(OVERLAP * min(mask_a.sum(), mask_b.sum()), SECONDS / STRETCH)
    usable = (count >= least) & (var_a > 1e-9) & (var_b > 1e-9)
    return np.where(
        usable, both / np.sqrt(np.where(usable, var_a * var_b, 1.0)), np.nan
    )
