r"""Errors of a filter against the truth: in all, of heading, of inclination.

In the world, the error is the quaternion :math:`d = \hat q * q^*` with vector part
(x, y, z), z up, and scalar s. Heading is the turn about the vertical that is nearest to
it, inclination what is left:

.. math:: \psi = 2 \arctan(z / s), \quad
   \iota = 2 \arctan\frac{\sqrt{x^2 + y^2}}{\sqrt{s^2 + z^2}}, \quad
   \cos\tfrac{\theta}{2} = \cos\tfrac{\psi}{2} \cos\tfrac{\iota}{2}. \tag{R4}
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array, frozen
from simval.consistency import heading_and_inclination, rotation_error
from simval.recorded.blocks import mean_with_error
from simval.shapes import Bool, Float

SETTLED: Final = 2.0
"""Times the RMS error of the last half of the log: below, a filter has converged."""

WINDOW: Final = 10.0
"""s, of the RMS that is compared: as long as a rest or a move of a recording."""

FEWEST: Final = 30  # rows of which an RMS is given


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Errors:
    """Errors at the rows that have truth."""

    time: Float[Array, " k"]  # s
    body: Float[Array, "k 3"]  # rotation vector from truth to estimate, body axes, rad
    total: Float[Array, " k"]  # rad, 0 to pi
    heading: Float[Array, " k"]  # rad, positive from north to west
    inclination: Float[Array, " k"]  # rad, 0 to pi
    rest: Bool[np.ndarray, " k"]

    def __post_init__(self) -> None:
        for name in ("time", "body", "total", "heading", "inclination"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Rms:
    """RMS of an error with its standard error, rad; NaN of too few rows."""

    value: float
    sd: float
    rows: int


def errors_of(
    time: Float[Array, " k"],
    truth: Float[Array, "k 4"],
    estimate: Float[Array, "k 4"],
    rest: Bool[np.ndarray, " k"],
) -> Errors:
    """Errors of estimated attitudes by eq. (R4)."""
    heading, inclination = heading_and_inclination(estimate, truth)
    body = rotation_error(estimate, truth)
    return Errors(
        time=time,
        body=body,
        total=np.linalg.norm(body, axis=1),
        heading=heading,
        inclination=inclination,
        rest=rest,
    )


def rms(values: Float[Array, " k"]) -> Rms:
    """RMS with the standard error of correlated rows, by blocks."""
    if len(values) < FEWEST:
        return Rms(value=np.nan, sd=np.nan, rows=len(values))
    mean, covariance, _ = mean_with_error(values[:, None] ** 2)
    value = float(np.sqrt(mean[0]))
    sd = float(np.sqrt(covariance[0, 0])) / (2.0 * value) if value > 0.0 else 0.0
    return Rms(value=value, sd=sd, rows=len(values))


def table(errors: Errors) -> dict[str, dict[str, Rms]]:
    """RMS of each error, over all rows, at rest and moving."""
    parts = {
        "all": np.ones(len(errors.time), dtype=bool),
        "rest": errors.rest,
        "moving": ~errors.rest,
    }
    return {
        part: {
            name: rms(getattr(errors, name)[rows])
            for name in ("total", "heading", "inclination")
        }
        for part, rows in parts.items()
    }


def convergence(errors: Errors) -> float:
    """Seconds until the RMS of the following `WINDOW` is below `SETTLED`; NaN never.

    In whole seconds, against the RMS of the last half.
    """
    time = errors.time - errors.time[0]
    squares = errors.total**2
    limit = SETTLED**2 * float(squares[time >= 0.5 * time[-1]].mean())
    sums = np.concatenate([[0.0], np.cumsum(squares)])
    begins = np.arange(0.0, max(time[-1] - WINDOW, 0.0) + 1.0)
    first, last = np.searchsorted(time, begins), np.searchsorted(time, begins + WINDOW)
    counts = np.maximum(last - first, 1)
    below = ((sums[last] - sums[first]) / counts <= limit) & (last > first)
    return float(begins[np.argmax(below)]) if below.any() else np.nan
