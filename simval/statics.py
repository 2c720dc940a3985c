r"""Static intervals of an inertial log, by windowed variance magnitude.

The method of Tedaldi, Pretto and Menegatti (IMU-TK): a sample is static when the
variance of the readings in the window centred on it is below a multiple of the
variance of a known rest,

.. math:: \varsigma_k = \Vert (\mathrm{var}_x, \mathrm{var}_y, \mathrm{var}_z)\Vert
   _{|i-k| \le h} < m\, \varsigma_{rest}.  \tag{D1}

The window is :math:`w = 2h + 1` samples, so each interval ends about `h` samples
before the motion does anything in its window. All is relative to the rest's own
variance: raw counts and SI units give the same intervals.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, finite_array, positive_number
from simval.errors import InputError, RefusedError

Intervals = NDArray[np.intp]
WINDOW = 101  # samples; one second at 100 Hz
MINIMUM = 100  # samples
FLOOR_QUANTILE = 0.1  # of the windowed variance: the noise floor of the log
FLOOR_MULTIPLE = 3.0  # a window above this many floors has moved


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rest:
    """The initial rest, whose variance scales the threshold.

    Attributes
    ----------
    start, stop : int
        Samples ``start <= k < stop``.
    variance : float
        Variance magnitude (D1) of all its samples, unit of the readings squared.
    found : bool
        Whether the program found it by itself.
    """

    start: int
    stop: int
    variance: float
    found: bool


def variance_magnitude(samples: Array, window: int = WINDOW) -> Array:
    """Variance magnitude of the window centred on each sample, eq. (D1).

    Parameters
    ----------
    samples : Array
        Readings, (n, 3), any unit.
    window : int
        Samples in a window, odd, 3 or more.

    Returns
    -------
    Array
        (n,), unit of the readings squared; infinite within half a window of either
        end, where there is no full window, so that nothing there is static.

    Raises
    ------
    InputError
        If the window is not odd or does not fit into the log.

    Notes
    -----
    Each window spans at most two blocks of `window` samples. Sums run from the blocks'
    ends over data centred per block, and the two parts are merged (Chan, Golub and
    LeVeque 1983): no sum is longer than a window, so a rest late in a long log of
    large counts loses no digits.
    """
    samples = _checked_samples(samples, window)
    n, half = len(samples), window // 2
    blocks = -(-n // window)
    padded = np.concatenate([samples, np.repeat(samples[-1:], blocks * window - n, 0)])
    cube = padded.reshape(blocks, window, 3)
    centre = cube.mean(axis=1, keepdims=True)
    cube = cube - centre
    mean_before, spread_before = _running(cube)
    mean_after, spread_after = _running(cube[:, ::-1])
    # a window that starts at offset o > 0 has window - o samples in its first block
    centres = centre[:, 0]
    tail_mean = (mean_after[:, ::-1] + centres[:, None]).reshape(-1, 3)
    tail_spread = spread_after[:, ::-1].reshape(-1, 3)
    head_mean = (mean_before + centres[:, None]).reshape(-1, 3)
    head_spread = spread_before.reshape(-1, 3)
    start = np.arange(n - window + 1)
    in_head = start % window  # samples in the second block
    last = start + window - 1
    merged = (
        tail_spread[start]
        + head_spread[last]
        + (in_head * (window - in_head) / window)[:, None]
        * (head_mean[last] - tail_mean[start]) ** 2
    )
    whole = in_head == 0
    merged[whole] = tail_spread[start[whole]]
    result = np.full(n, np.inf)
    result[half : n - half] = np.linalg.norm(merged / (window - 1), axis=1)
    return result


def _running(cube: Array) -> tuple[Array, Array]:
    # running mean and sum of squared deviations along axis 1
    count = np.arange(1, cube.shape[1] + 1)[:, None]
    total = np.cumsum(cube, axis=1)
    spread = np.cumsum(cube * cube, axis=1) - total * total / count
    return total / count, np.maximum(spread, 0.0)


def _checked_samples(samples: Array, window: int) -> Array:
    samples = finite_array("samples", samples, (None, 3))
    if not (window >= 3 and window % 2 == 1):
        msg = f"`window` is {window}; it must be an odd number of samples, 3 or more"
        raise InputError(msg)
    if not (samples.ndim == 2 and len(samples) >= window):
        msg = (
            f"`samples` has shape {samples.shape}; one log of at least one window "
            f"({window} rows of 3) is needed: record longer or shorten the window"
        )
        raise InputError(msg)
    return samples


def initial_rest(
    samples: Array,
    count: int | None = None,
    window: int = WINDOW,
    minimum: int = MINIMUM,
    spread: Array | None = None,
) -> Rest:
    """Return the initial rest: the first `count` samples, or the first rest found.

    Without `count` the noise floor of the log is the lowest tenth of its windowed
    variances, and the rest is the first run of at least `minimum` samples below three
    floors. The log then needs rests in more than a tenth of its windows, but need not
    begin at rest.

    Parameters
    ----------
    samples : Array
        Readings, (n, 3), any unit.
    count : int or None
        Samples at the start of the log known to be at rest; None finds them.
    window : int
        Samples in a window, odd.
    minimum : int
        Least number of samples of a rest that is found.
    spread : Array or None
        The samples' `variance_magnitude` where it is known already.

    Returns
    -------
    Rest
        Its samples and their variance magnitude.

    Raises
    ------
    InputError
        If `count` is shorter than a window or longer than the log.
    RefusedError
        If no rest is found, or its readings do not vary at all.
    """
    samples = _checked_samples(samples, window)
    if count is not None:
        if not window <= count <= len(samples):
            msg = (
                f"the initial rest is {count} samples; it must be between one window "
                f"({window}) and the whole log ({len(samples)})"
            )
            raise InputError(msg)
        start, stop = 0, count
    else:
        if spread is None:
            spread = variance_magnitude(samples, window)
        floor = float(np.quantile(spread[np.isfinite(spread)], FLOOR_QUANTILE))
        runs = _runs(spread < FLOOR_MULTIPLE * floor)
        runs = runs[runs[:, 1] - runs[:, 0] >= minimum]
        if len(runs) == 0:
            msg = (
                f"no initial rest found: no {minimum} samples in a row stay below "
                f"{FLOOR_MULTIPLE:g} noise floors ({floor:.3g}); state its length "
                "(--rest SECONDS), or record with rests"
            )
            raise RefusedError(msg)
        start, stop = int(runs[0, 0]), int(runs[0, 1])
    variance = float(np.linalg.norm(np.var(samples[start:stop], axis=0, ddof=1)))
    if not variance > 0.0:
        msg = (
            f"the initial rest (samples {start} to {stop - 1}) does not vary at all, "
            "so its noise sets no threshold; is the sensor stuck, or too coarse?"
        )
        raise RefusedError(msg)
    return Rest(start=start, stop=stop, variance=variance, found=count is None)


def static_intervals(
    samples: Array,
    threshold: float,
    window: int = WINDOW,
    minimum: int = MINIMUM,
    trim: int = 0,
) -> Intervals:
    """Intervals whose windowed variance magnitude stays below a threshold.

    Parameters
    ----------
    samples : Array
        Readings, (n, 3), any unit.
    threshold : float
        Limit of eq. (D1), unit of the readings squared: a multiple of a `Rest`'s.
    window : int
        Samples in a window, odd.
    minimum : int
        Least number of samples of an interval, after trimming.
    trim : int
        Samples cut off at both ends of each interval: the slow start of a motion is
        still below the threshold.

    Returns
    -------
    Intervals
        (m, 2) samples ``start <= k < stop`` in order of time; m can be 0.
    """
    threshold = positive_number("threshold", threshold, "(reading unit)^2")
    return intervals_below(
        variance_magnitude(samples, window), threshold, minimum=minimum, trim=trim
    )


def intervals_below(
    spread: Array, threshold: float, minimum: int = MINIMUM, trim: int = 0
) -> Intervals:
    """Intervals below a threshold, from a variance magnitude already computed.

    Parameters
    ----------
    spread : Array
        From `variance_magnitude`, (n,).
    threshold : float
        Limit, unit of the readings squared.
    minimum : int
        Least number of samples of an interval, after trimming.
    trim : int
        Samples cut off at both ends.

    Returns
    -------
    Intervals
        (m, 2) samples ``start <= k < stop`` in order of time; m can be 0.

    Raises
    ------
    InputError
        If `minimum` is below 1 or `trim` below 0.
    """
    if not (minimum >= 1 and trim >= 0):
        msg = f"`minimum` is {minimum} and `trim` {trim}; at least 1 and 0 are needed"
        raise InputError(msg)
    runs = _runs(spread < threshold) + np.array([trim, -trim])
    kept: Intervals = runs[runs[:, 1] - runs[:, 0] >= minimum]
    return kept


def _runs(flag: NDArray[np.bool_]) -> Intervals:
    # runs of True as [start, stop) rows, (m, 2)
    edges = np.diff(np.concatenate([[False], flag, [False]]).astype(np.int8))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return np.stack([starts, stops], axis=1)


def interval_counts(intervals: Intervals) -> Intervals:
    """Number of samples of each interval.

    Parameters
    ----------
    intervals : Intervals
        [start, stop) rows, (m, 2).

    Returns
    -------
    Intervals
        (m,).
    """
    return np.asarray(intervals[:, 1] - intervals[:, 0])


def interval_means(samples: Array, intervals: Intervals) -> Array:
    """Mean reading of each interval.

    Parameters
    ----------
    samples : Array
        Readings, (n, 3).
    intervals : Intervals
        [start, stop) rows, (m, 2).

    Returns
    -------
    Array
        (m, 3), unit of the readings.
    """
    means = [samples[start:stop].mean(axis=0) for start, stop in intervals]
    return np.array(means).reshape(-1, 3)


def first_samples(samples: Array, intervals: Intervals, count: int) -> Array:
    """First readings of each interval, as IMU-TK takes them.

    Parameters
    ----------
    samples : Array
        Readings, (n, 3).
    intervals : Intervals
        [start, stop) rows, (m, 2), each of at least `count` samples.
    count : int
        Readings to take from each, 1 or more.

    Returns
    -------
    Array
        (m, count, 3), unit of the readings.

    Raises
    ------
    InputError
        If an interval is shorter.
    """
    shortest = int(interval_counts(intervals).min(initial=count))
    if not 1 <= count <= shortest:
        msg = f"`count` is {count}; it must be from 1 to the shortest's {shortest}"
        raise InputError(msg)
    return np.asarray(samples)[intervals[:, :1] + np.arange(count)]
