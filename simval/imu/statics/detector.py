"""The initial rest and the static intervals of a log, see `simval.imu.statics`."""

from dataclasses import dataclass

import numpy as np

from simval.arguments import whole_number
from simval.arrays import Array, real_number, shaped_array
from simval.errors import InputError, RefusedError
from simval.imu.statics.intervals import Intervals, runs_of
from simval.imu.statics.variance import WINDOW, checked_samples, variance_magnitude
from simval.shapes import Float
from simval.text import shown

MINIMUM = 100  # samples
FLOOR_QUANTILE = 0.1
"""Of the windowed variances: the noise floor of the log. The log needs rests in more of
its windows than that, and a share of few windows would be a chance minimum. Any from
0.01 to 0.2 leaves the rests as they are (`test_the_noise_floor_decides_little`,
test_rests.py); 0.5 loses those of a log that rests a fifth of its time."""

FLOOR_MULTIPLE = 3.0
"""Floors above which a window has moved. Windows of white noise vary by 8 % at 101
samples, sqrt(2/300). Any from 1.2 to 10 leaves the rests as they are (the same test),
for it chooses the rest that scales the threshold, and not the threshold."""


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
        Whether it was found, and not stated.
    """

    start: int
    stop: int
    variance: float
    found: bool


def initial_rest(
    samples: Float[Array, "n 3"],
    count: int | None = None,
    window: int = WINDOW,
    minimum: int = MINIMUM,
    spread: Array | None = None,
    rate: float | None = None,
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
    rate : float or None
        Samples per second, Hz, for a message in seconds.

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
    samples = checked_samples(samples, window)
    minimum = whole_number("minimum", minimum, 1)
    if count is None:
        if spread is None:
            spread = variance_magnitude(samples, window)
        least = max(minimum, 2)  # one sample has no variance
        start, stop = _first_rest(spread, least, rate)
    else:
        start, stop = 0, whole_number("count", count, 1)
        if not window <= stop <= len(samples):
            msg = (
                f"the initial rest is {stop} samples; it must be between one window "
                f"({window}) and the whole log ({len(samples)})"
            )
            raise InputError(msg)
    variance = float(np.linalg.norm(np.var(samples[start:stop], axis=0, ddof=1)))
    if not variance > 0.0:
        msg = (
            f"the initial rest (samples {start} to {stop - 1}) does not vary at all, "
            "so its noise sets no threshold; is the sensor stuck, or too coarse?"
        )
        raise RefusedError(msg)
    return Rest(start=start, stop=stop, variance=variance, found=count is None)


def _first_rest(spread: Array, minimum: int, rate: float | None) -> tuple[int, int]:
    floor = float(np.quantile(spread[np.isfinite(spread)], FLOOR_QUANTILE))
    if not floor > 0.0:
        msg = (
            "no initial rest found: the stillest rows do not vary at all, so noise "
            "sets no threshold: it is far below one step of the converter, or the "
            "sensor is stuck; record with a narrower range or a finer resolution"
        )
        raise RefusedError(msg)
    runs = runs_of(spread < FLOOR_MULTIPLE * floor)
    runs = runs[np.ptp(runs, axis=1) >= minimum]
    if len(runs) == 0:
        long = f"{minimum} samples" if rate is None else f"{minimum / rate:.3g} s"
        msg = (
            f"no initial rest found: no {long} in a row stay below "
            f"{FLOOR_MULTIPLE:g} noise floors ({floor:.3g}); state its length "
            "(--rest SECONDS), or record with rests"
        )
        raise RefusedError(msg)
    return int(runs[0, 0]), int(runs[0, 1])


def intervals_below(
    spread: Float[Array, " n"], threshold: float, minimum: int = MINIMUM, trim: int = 0
) -> Intervals:
    """Intervals whose windowed variance magnitude stays below a threshold.

    Parameters
    ----------
    spread : Array
        From `variance_magnitude`, (n,).
    threshold : float
        Limit of eq. (D1), unit of the readings squared: a multiple of a `Rest`'s.
    minimum : int
        Least number of samples of an interval, after trimming.
    trim : int
        Samples cut off at both ends of each interval: the slow start of a motion is
        still below the threshold.

    Returns
    -------
    Intervals
        (m, 2) samples ``start <= k < stop`` in order of time; m can be 0.

    Raises
    ------
    InputError
        If `minimum` is below 1 or `trim` below 0.
    """
    minimum, trim = whole_number("minimum", minimum, 1), whole_number("trim", trim, 0)
    if not real_number("threshold", threshold, "(reading unit)^2") > 0.0:
        msg = f"`threshold` is {shown(threshold)}; it must be above 0"
        raise InputError(msg)
    spread = shaped_array("spread", spread, (None,))
    if spread.ndim != 1:
        msg = f"`spread` has shape {spread.shape}; give that of one log, (n,)"
        raise InputError(msg)
    runs = runs_of(spread < threshold) + np.array([trim, -trim])
    kept: Intervals = runs[runs[:, 1] - runs[:, 0] >= minimum]
    return kept
