r"""Errors of a filter against the truth, with error bars and verdicts.

**Error bars** of a fit whose residuals are correlated leave out one block at a time.
The rows are cut into blocks of time with equal shares of the information. Residuals
within a block may be correlated in any way; between blocks they are taken as
independent. At the solution, where residuals r with derivatives J are orthogonal to
instruments Z (J itself in least squares), and :math:`H_b, g_b` are a block's share of
Z'J and Z'r,

.. math:: \delta_b = (H - H_b)^{-1} g_b, \quad
   \mathrm{cov} = \tfrac{B - 1}{B} \sum_b (\delta_b - \bar\delta)(\delta_b -
   \bar\delta)'. \tag{R2}

What all blocks have in common, as a constant error of the model, does not show in it.

**Errors** in all, of heading, of inclination: in the world, the error is the quaternion
:math:`d = \hat q * q^*` with vector part (x, y, z), z up, and scalar s. Heading is the
turn about the vertical that is nearest to it, inclination what is left:

.. math:: \psi = 2 \arctan(z / s), \quad
   \iota = 2 \arctan\frac{\sqrt{x^2 + y^2}}{\sqrt{s^2 + z^2}}, \quad
   \cos\tfrac{\theta}{2} = \cos\tfrac{\psi}{2} \cos\tfrac{\iota}{2}. \tag{R4}

**Verdicts** on a covariance: NEES, NIS, whiteness. The normalised squared error of one
recording is correlated over its whole length, so its mean is judged by blocks,
:math:`e' P^{-1} e` with P the filter's covariance and the truth's own: its noise, and
the error bars of its axes and world. Blocks are as many of `COUNTS` as leave their
means uncorrelated; Student's t then gives the interval. A recording can only show a
mean that is off by its own scatter or more. A free heading drifts once in a log, and is
judged as one error.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import scipy

from simval.arrays import Array, ReadOnly
from simval.consistency import (
    heading_and_inclination,
    normalised_squares,
    rotation_error,
)
from simval.shapes import Bool, Float, Int

BLOCKS: Final = 24
"""As many as Student's t with one less is 4 % wider than the normal; more are shorter,
and their neighbours are no longer independent."""

COVERAGE: Final = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A number with its standard deviation."""

    value: float
    sd: float
    dof: int  # of its standard deviation

    @property
    def half(self) -> float:
        """Half width of the 95 % interval, by Student's t."""
        return self.sd * quantile(self.dof)


def quantile(dof: int, coverage: float = COVERAGE) -> float:
    """Two-sided quantile of Student's t."""
    return float(scipy.special.stdtrit(dof, 0.5 + 0.5 * coverage))


def block_of(
    weight: Float[Array, " m"], blocks: int = BLOCKS
) -> tuple[Int[np.ndarray, " m"], int]:
    """Cut rows into blocks of equal weight; the block of each, and their number."""
    share = np.cumsum(weight) / np.sum(weight)
    found = np.minimum((share * blocks * (1.0 - 1e-12)).astype(int), blocks - 1)
    _, number = np.unique(found, return_inverse=True)
    return number, int(number[-1]) + 1


def jackknife(
    instruments: Float[Array, "m k p"],
    rows: Float[Array, "m k p"],
    residuals: Float[Array, "m k"],
    block: Int[np.ndarray, " m"],
) -> Float[Array, "p p"]:
    """Covariance of a least-squares solution by the jackknife, eq. (R2)."""
    count, p = int(block.max()) + 1, rows.shape[-1]
    each_H = np.einsum("mkp,mkq->mpq", instruments, rows)
    each_g = np.einsum("mkp,mk->mp", instruments, residuals)
    H, g = np.zeros((count, p, p)), np.zeros((count, p))
    np.add.at(H, block, each_H)
    np.add.at(g, block, each_g)
    moved = np.linalg.solve(H.sum(axis=0) - H, g[..., None])[..., 0]
    off = moved - moved.mean(axis=0)
    return (count - 1) / count * off.T @ off


def mean_with_error(
    values: Float[Array, "m k"], blocks: int = BLOCKS
) -> tuple[Float[Array, " k"], Float[Array, "k k"], int]:
    """Mean of correlated rows, its covariance from blocks, and degrees of freedom."""
    block, count = block_of(np.ones(len(values)), min(blocks, len(values)))
    mean = values.mean(axis=0)
    rows = np.broadcast_to(np.eye(values.shape[1]), (*values.shape, values.shape[1]))
    return mean, jackknife(rows, rows, mean - values, block), count - 1


SETTLED: Final = 2.0
"""Times the RMS error of the last half of the log: below, a filter has converged."""

WINDOW: Final = 10.0
"""s, of the RMS that is compared: as long as a rest or a move of a recording."""

FEWEST: Final = 30  # rows of which an RMS is given


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Errors(ReadOnly):
    """Errors at the rows that have a truth."""

    time: Float[Array, " k"]  # s
    body: Float[Array, "k 3"]  # rotation vector from truth to estimate, body axes, rad
    total: Float[Array, " k"]  # rad, 0 to pi
    heading: Float[Array, " k"]  # rad, positive from north to west
    inclination: Float[Array, " k"]  # rad, 0 to pi
    rest: Bool[np.ndarray, " k"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rms:
    """RMS of an error with its standard error, rad; NaN if the rows are too few."""

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
    """RMS with a standard error by blocks, as the rows are correlated."""
    if len(values) < FEWEST:
        return Rms(value=np.nan, sd=np.nan, rows=len(values))
    mean, covariance, _ = mean_with_error(values[:, None] ** 2)
    value = float(np.sqrt(mean[0]))
    sd = float(np.sqrt(covariance[0, 0])) / (2.0 * value) if value > 0.0 else 0.0
    return Rms(value=value, sd=sd, rows=len(values))


def differ(first: Errors, second: Errors, alpha: float) -> bool:
    """True if the RMS total errors of two filters differ beyond chance.

    By the difference of the squares in the rows that both have, which share what
    disturbed them, and blocks of time.
    """
    _, ours, theirs = np.intersect1d(first.time, second.time, return_indices=True)
    if len(ours) < FEWEST:
        return False
    squares = first.total[ours] ** 2 - second.total[theirs] ** 2
    mean, covariance, dof = mean_with_error(squares[:, None])
    width = quantile(dof, 1.0 - alpha) * float(np.sqrt(covariance[0, 0]))
    return bool(abs(mean[0]) > width)


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
    """Time after which the RMS in a window stays below `SETTLED`, s; NaN if never.

    In whole seconds, against the RMS of the last half; and until the next second alone
    is, which ten may hide.
    """
    time = errors.time - errors.time[0]
    squares = errors.total**2
    limit = SETTLED**2 * float(squares[time >= 0.5 * time[-1]].mean())
    sums = np.concatenate([[0.0], np.cumsum(squares)])
    begins = np.arange(0.0, max(time[-1] - WINDOW, 0.0) + 1.0)
    first = np.searchsorted(time, begins)
    below = np.ones_like(begins, dtype=bool)
    for window in (WINDOW, 1.0):
        last = np.searchsorted(time, begins + window)
        counts = np.maximum(last - first, 1)
        below &= ((sums[last] - sums[first]) / counts <= limit) & (last > first)
    return float(begins[np.argmax(below)]) if below.any() else np.nan


COUNTS: Final = (24, 12, 6)
"""Blocks that are tried, most first."""

ALPHA: Final = 0.01
"""False-alarm rate of a verdict, both sides together; measured in
test_recorded_errors.py for errors that last up to a twentieth of the log."""

Verdict = Literal[
    "consistent", "overconfident", "underconfident", "not judged", "not judged: rows"
]
"""The last where the log contradicts what the gyroscope's rows are taken as."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NormalisedSquare:
    """A mean normalised square, its expectation, and the verdict."""

    mean: float
    expected: float
    low: float  # of the interval at `ALPHA`
    high: float
    blocks: int
    verdict: Verdict
    told: float = 0.0  # relative sd of the expectation, as noise is not exactly known


def normalised(
    errors: Float[Array, "k m"], covariance: Float[Array, "k m m"]
) -> Float[Array, " k"]:
    """Squares e' P^-1 e; NaN where P is not positive definite."""
    good = np.linalg.eigvalsh(covariance)[:, 0] > 0.0
    filled = np.where(good[:, None, None], covariance, np.eye(errors.shape[1]))
    return np.where(good, normalised_squares(errors, filled), np.nan)


def judged(
    values: Float[Array, " k"], expected: float, told: float = 0.0
) -> NormalisedSquare:
    """Judge the mean of correlated normalised squares.

    Overconfident is a mean above what it should be: errors beyond the covariance. That
    may be off by itself, by a relative standard deviation `told`.
    """
    values = values[np.isfinite(values)]
    if len(values) < 10 * COUNTS[-1]:
        return NormalisedSquare(
            mean=float(values.mean()) if len(values) else np.nan,
            expected=expected,
            low=np.nan,
            high=np.nan,
            blocks=0,
            verdict="not judged",
            told=told,
        )
    means = _block_means(values)
    # of the logarithm: the means of few independent squares are skewed
    logs = np.log(np.maximum(means, 1e-12 * expected))
    mean = float(means.mean())
    spread = float(logs.std(ddof=1)) / np.sqrt(len(means))
    width = float(np.hypot(spread, told)) * quantile(len(means) - 1, 1.0 - ALPHA)
    low, high = mean * np.exp(-width), mean * np.exp(width)
    verdict: Verdict = "consistent"
    if low > expected:
        verdict = "overconfident"
    elif high < expected:
        verdict = "underconfident"
    return NormalisedSquare(
        mean=mean,
        expected=expected,
        low=low,
        high=high,
        blocks=len(means),
        verdict=verdict,
        told=told,
    )


def judged_once(values: Float[Array, " k"]) -> NormalisedSquare:
    """Judge a mean whose squares all have one cause, such as a growing drift.

    However they are correlated, it is taken for one square: chi-square of 1 degree of
    freedom, of which a recording shows a mean that is off eight times or more.
    """
    values = values[np.isfinite(values)]
    mean = float(values.mean()) if len(values) else np.nan
    least, most = scipy.special.chdtri(1.0, [1.0 - ALPHA / 2.0, ALPHA / 2.0])
    low, high = mean / most, mean / least
    verdict: Verdict = "consistent" if len(values) else "not judged"
    if low > 1.0:
        verdict = "overconfident"
    elif high < 1.0:
        verdict = "underconfident"
    return NormalisedSquare(
        mean=mean,
        expected=1.0,
        low=low,
        high=high,
        blocks=min(len(values), 1),
        verdict=verdict,
    )


def _block_means(values: Float[Array, " k"]) -> Float[Array, " b"]:
    for count in COUNTS:
        means = np.array([part.mean() for part in np.array_split(values, count)])
        off = means - means.mean()
        square = float(off @ off)
        lag = float(off[1:] @ off[:-1]) / square if square > 0.0 else 0.0
        if lag < 1.0 / np.sqrt(count):
            break
    return means


def whiteness(
    innovation: Float[Array, "k m"], covariance: Float[Array, "k m m"]
) -> Float[Array, " m"]:
    """Correlation of each whitened innovation with the next; 0 for white noise."""
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, innovation[..., None])[..., 0]
    square = np.sum(white**2, axis=0)
    both = np.sum(white[1:] * white[:-1], axis=0)
    return np.where(square > 0.0, both / np.where(square > 0.0, square, 1.0), 0.0)
