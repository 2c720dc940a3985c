r"""Whether a covariance is true, from one recording: NEES, NIS, whiteness.

The normalised squared error of one recording is correlated over its whole length, so
its mean is judged by blocks, :math:`e' P^{-1} e` with P the filter's covariance and the
truth's own: its noise, and the error bars of its axes and world. Blocks are as many of
`COUNTS` as leave their means uncorrelated; Student's t then gives the interval. A
recording can only show a mean that is off by its own scatter or more.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from simval.arrays import Array
from simval.consistency import normalised_squares
from simval.recorded.blocks import quantile
from simval.shapes import Float

COUNTS: Final = (24, 12, 6)
"""Blocks that are tried, most first."""

ALPHA: Final = 0.01
"""False-alarm rate of a verdict, both sides together; measured in
tests/test_recorded_consistency.py for errors that last up to a twentieth of the log."""

Verdict = Literal["consistent", "overconfident", "underconfident", "not judged"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Consistency:
    """A mean normalised square, what it should be, and a verdict."""

    mean: float
    expected: float
    low: float  # of the interval at `ALPHA`
    high: float
    blocks: int
    verdict: Verdict


def normalised(
    errors: Float[Array, "k m"], covariance: Float[Array, "k m m"]
) -> Float[Array, " k"]:
    """Squares e' P^-1 e; NaN where P is not positive."""
    good = np.linalg.eigvalsh(covariance)[:, 0] > 0.0
    filled = np.where(good[:, None, None], covariance, np.eye(errors.shape[1]))
    return np.where(good, normalised_squares(errors, filled), np.nan)


def judged(values: Float[Array, " k"], expected: float) -> Consistency:
    """Judge the mean of correlated squares.

    Overconfident is a mean above what it should be: errors beyond the covariance.
    """
    values = values[np.isfinite(values)]
    if len(values) < 10 * COUNTS[-1]:
        return Consistency(
            mean=float(values.mean()) if len(values) else np.nan,
            expected=expected,
            low=np.nan,
            high=np.nan,
            blocks=0,
            verdict="not judged",
        )
    means = _blocks(values)
    # of the logarithm: the means of few independent squares are skewed
    logs = np.log(np.maximum(means, 1e-12 * expected))
    mean = float(means.mean())
    spread = float(logs.std(ddof=1)) / np.sqrt(len(means))
    width = spread * quantile(len(means) - 1, 1.0 - ALPHA)
    low, high = mean * np.exp(-width), mean * np.exp(width)
    verdict: Verdict = "consistent"
    if low > expected:
        verdict = "overconfident"
    elif high < expected:
        verdict = "underconfident"
    return Consistency(
        mean=mean,
        expected=expected,
        low=low,
        high=high,
        blocks=len(means),
        verdict=verdict,
    )


def _blocks(values: Float[Array, " k"]) -> Float[Array, " b"]:
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
    """Correlation of each whitened innovation with the next one; white noise has 0."""
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, innovation[..., None])[..., 0]
    square = np.sum(white**2, axis=0)
    both = np.sum(white[1:] * white[:-1], axis=0)
    return np.where(square > 0.0, both / np.where(square > 0.0, square, 1.0), 0.0)
