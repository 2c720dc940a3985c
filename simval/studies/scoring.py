"""What a simulation knows to be at rest, and how well a detector finds it.

A row is still where the true specific force has the length g within `STILL_FORCE` and
the body turns at less than `STILL_RATE`.
An interval is impure if one of its rows is not still.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.calibrate import calibrate
from simval.errors import RefusedError
from simval.poses import PARAMETERS
from simval.scene import Trajectory
from simval.sensor import AccelerometerModel
from simval.shapes import Float
from simval.statics import (
    Intervals,
    initial_rest,
    interval_counts,
    interval_means,
    intervals_below,
    variance_magnitude,
)
from simval.statistics import (
    IMPURE,
    INTERVALS,
    OUTSIDE,
    PRECISION,
    RECALL,
    RESTS_FOUND,
    Family,
)

RATE = 100.0  # Hz, of the log that is made from a trajectory
# A tenth of the noise that a second leaves in a mean at 0.01 m/s^2 a sample, so 1 % of
# its variance. Half or twice both limits moves 0.7 % of the rests' rows of gimbal and
# die at the most, 5 % of the shaker's, where a few rests creep.
STILL_FORCE = 1e-4  # m/s^2
STILL_RATE = 1e-4  # rad/s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tumble:
    """A trajectory at the rate of a log, and what is still in it."""

    time: Float[Array, " n"]  # seconds
    force: Float[Array, "n 3"]  # true specific force, sensor axes, m/s^2
    still: NDArray[np.bool_]  # rows at rest, (n,)
    hold: NDArray[np.intp]  # planned rest of each row, -1 for none, (n,)
    g: float  # length of gravity, m/s^2


def thinned(trajectory: Trajectory) -> Tumble:
    """Thin a trajectory to the rate of a log."""
    every = slice(None, None, max(round(trajectory.rate / RATE), 1))
    force = trajectory.specific_force[every]
    rate = np.linalg.norm(trajectory.angular_velocity[every], axis=1)
    off = np.abs(np.linalg.norm(force, axis=1) - trajectory.g)
    return Tumble(
        time=trajectory.time[every],
        force=force,
        still=(off <= STILL_FORCE) & (rate <= STILL_RATE),
        hold=trajectory.hold[every],
        g=trajectory.g,
    )


def score(
    intervals: Intervals, still: NDArray[np.bool_], hold: NDArray[np.intp]
) -> dict[Family, float]:
    """Compare intervals with the truth."""
    covered = np.zeros(len(still), bool)
    for start, stop in intervals:
        covered[start:stop] = True
    rests = np.unique(hold[hold >= 0])
    touched = np.unique(hold[covered & (hold >= 0)])
    outside = _count(hold >= 0, intervals) == 0
    return {
        PRECISION: float(still[covered].mean()) if covered.any() else 0.0,
        RECALL: float(covered[hold >= 0].mean()) if len(rests) else 0.0,
        RESTS_FOUND: len(touched) / max(len(rests), 1),
        INTERVALS: float(len(intervals)),
        IMPURE: float(np.sum(~pure(intervals, still))),
        OUTSIDE: float(np.sum(outside)),
    }


def pure(intervals: Intervals, still: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which intervals hold still rows only."""
    return _count(still, intervals) == interval_counts(intervals)


def _count(rows: NDArray[np.bool_], intervals: Intervals) -> NDArray[np.intp]:
    # how many of these rows are in each interval
    before = np.concatenate([[0], np.cumsum(rows)])
    return np.asarray(before[intervals[:, 1]] - before[intervals[:, 0]])


def detect(
    raw: Float[Array, "n 3"], multiplier: float, window: int, trim: int
) -> tuple[Intervals, Float[Array, " n"], float]:
    """Find the static intervals of a log as for a user's log."""
    minimum = window // 2
    spread = variance_magnitude(raw, window)
    rest = initial_rest(raw, None, window, minimum, spread)
    threshold = multiplier * rest.variance
    return intervals_below(spread, threshold, minimum, trim), spread, threshold


def normalized_square(
    raw: Float[Array, "n 3"], intervals: Intervals, sensor: AccelerometerModel, g: float
) -> float:
    """Normalised squared error of a calibration from some intervals."""
    if len(intervals) < PARAMETERS:
        return float("nan")
    try:
        fit = calibrate(
            interval_means(raw, intervals),
            g=g,
            noise_std=sensor.noise_std / np.sqrt(interval_counts(intervals)),
        ).require_converged()
    except RefusedError:
        return float("nan")
    error = fit.parameters - sensor.parameters
    return float(error @ np.linalg.solve(fit.covariance, error))


def mean_of(values: Float[Array, " n"] | list[float]) -> tuple[float, float, int]:
    """Mean of some trials, its standard error, and their number."""
    error = float(np.std(values, ddof=1)) / float(np.sqrt(len(values)))
    return float(np.mean(values)), error, len(values)
