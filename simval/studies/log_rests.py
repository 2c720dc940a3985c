"""The rests of a log, and what the checks of its health need of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.logs import Log
from simval.statics import Intervals, interval_means


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rests:
    """The rests of a log, and what the checks need of them.

    Attributes
    ----------
    log : Log
        The recording.
    intervals : Intervals
        Samples start <= k < stop of each rest, (m, 2).
    means : Array
        Mean reading of each, raw units.
    noise : Array
        Median standard deviation within a rest, each axis, raw units.
    same : Array
        Median share of readings equal to the one before, each axis; small
        where the noise is a step of the converter or more.
    same_rows : float
        Share of rows equal to the one before that nine rests of ten stay below.
    """

    log: Log
    intervals: Intervals
    means: Float[Array, "m 3"]
    noise: Float[Array, "3"]
    same: Float[Array, "3"]
    same_rows: float

    def span(self, rest: int) -> str:
        """Say when a rest was."""
        start, stop = self.intervals[rest]
        return self.rows(int(start), int(stop))

    def rows(self, start: int, stop: int) -> str:
        """Say when rows were."""
        time = self.log.time
        return f"from {time[start]:.2f} s to {time[stop - 1]:.2f} s"


def rests_of(log: Log, intervals: Intervals) -> Rests:
    """Gather what the checks need."""
    samples = log.accelerometer
    parts = [samples[start:stop] for start, stop in intervals]
    spread = np.array([part.std(axis=0) for part in parts]).reshape(-1, 3)
    equal = [np.diff(part, axis=0) == 0.0 for part in parts]
    same = np.array([part.mean(axis=0) for part in equal]).reshape(-1, 3)
    rows = np.array([part.all(axis=1).mean() for part in equal])
    return Rests(
        log=log,
        intervals=intervals,
        means=interval_means(samples, intervals),
        noise=np.median(spread, axis=0) if parts else np.full(3, np.nan),
        same=np.median(same, axis=0) if parts else np.ones(3),
        same_rows=float(np.quantile(rows, 0.9)) if parts else 1.0,
    )
