r"""Loop over trials in blocks, which every sampling study uses; noise as drawn.

A study says what a block of trials draws and what is kept of it; `trials_of` runs the
blocks, each with its own stream, and holds what was kept in their order.

Beside it the study hands over the noise of each sensor in each block, in units of the
deviation that its parameters state: no estimator is in between. It is independent
standard normal, so

- the mean square of n such numbers is 1, with a standard error of :math:`\sqrt{2/n}`;
- two vectors x, y of m of them have a correlation r = x'y/|x||y| with
  :math:`r \sqrt{(m-1)/(1-r^2)}` Student's t of m - 1 degrees of freedom.  (R1)

The strongest correlation of any two, of two blocks or of two sensors, must stay below
what (R1) exceeds with probability `FALSE_ALARM` in any of the pairs. A stream that is
used twice has the correlation 1.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from simval import statistics as stat
from simval.arrays import Array, Mask, outer
from simval.imu.calibrate import FitResult, MagnetometerFit
from simval.montecarlo import Sums
from simval.montecarlo.plain import batch_means, finite_means, summed
from simval.results import Rows, limit, plain
from simval.shapes import Float
from simval.streams import Streams

KEPT = 1024
"""Numbers of a block that are compared: two blocks correlate by 0.03, and none of a
thousand by 0.25."""

FALSE_ALARM = 1e-9
"""Of a cell, over all of its pairs."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawn:
    """Statistics of one sensor's noise in a block."""

    square: float  # sum of squares
    count: int
    first: Float[Array, " m"]  # the first `KEPT`

    @classmethod
    def of(cls, noise: Array) -> "Drawn":
        """Statistics of noise that is in units of its standard deviation."""
        flat = np.ravel(noise)
        return cls(
            square=float(np.vdot(flat, flat)),
            count=flat.size,
            first=flat[:KEPT].copy(),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trials:
    """Results of blocks of trials."""

    block: int  # trials in a block
    kept: Mapping[str, Array]  # by name, (trials, ...)
    noise: Sequence[Mapping[str, Drawn]]  # of each sensor, by block

    def __getitem__(self, name: str) -> Array:
        return self.kept[name]

    def sums(self, name: str) -> Sums:
        """Sums of the features of some errors, as `simulate` makes them."""
        values, block = self.kept[name], self.block

        def means(number: int) -> Array:
            errors = values[number * block : (number + 1) * block].T
            return finite_means(batch_means(errors, 1), errors, number)

        return summed(means, len(values) // block, 1, 1)


Kept = Mapping[str, Array]
Block = tuple[Kept, Kept]
"""What is kept of each trial of a block, and the noise of each sensor."""
Trial = Callable[[np.random.Generator], Block]


def trials_of(streams: Streams, trials: int, block: int, trial: Trial) -> Trials:
    """Run trials in whole blocks."""
    kept: list[Kept] = []
    noise: list[Mapping[str, Drawn]] = []
    for number in range(-(-trials // block)):
        values, drawn = trial(streams.block(number))
        kept.append(values)
        noise.append({name: Drawn.of(each) for name, each in drawn.items()})
    whole = {name: np.concatenate([each[name] for each in kept]) for name in kept[0]}
    return Trials(block=block, kept=whole, noise=noise)


def stated_of(
    fit: FitResult | MagnetometerFit, truth: Float[Array, " p"], level: float
) -> tuple[Mask, Array]:
    """Coverage of each stated interval, and the NEES.

    These are normalised by the stated covariance, (trials,).
    """
    low, high = np.moveaxis(fit.confidence_intervals(level), -1, 0)
    scaled = fit.covariance / outer(fit.sd, fit.sd)
    ratio = (fit.parameters - truth) / fit.sd
    square = np.vecdot(ratio, np.linalg.solve(scaled, ratio[..., None])[..., 0])
    return (low <= truth) & (truth <= high), square


def root(square: Any, error: Any) -> tuple[Any, Any]:
    """Square root of a mean square, with its standard error."""
    rms = np.sqrt(square)
    return rms, error / (2.0 * rms)


def share_error(share: Any, n: int) -> Any:
    """Standard error of a share among n trials, from the predicted share.

    Of one that hardly ever or nearly always is, as if one trial in n were otherwise.
    """
    share = np.asarray(share)
    return np.sqrt(np.maximum(share * (1.0 - share), 1.0 / n) / n)


def mean_of(values: Float[Array, "t ..."]) -> tuple[Any, Any, int]:
    """Mean over trials, its standard error, and the number of trials."""
    n = len(values)
    return np.mean(values, axis=0), np.std(values, axis=0, ddof=1) / np.sqrt(n), n


def drawn_rows(blocks: Sequence[Mapping[str, Drawn]]) -> Rows:
    """Rows about the drawn noise, sensor by sensor."""
    rows: Rows = ()
    for name in blocks[0]:
        n = sum(block[name].count for block in blocks)
        square = sum(block[name].square for block in blocks) / n
        error = np.sqrt(2.0 / n)
        rows += plain(stat.NOISE_SQUARE(name), square, error, n, 1.0, stat.CHI_SQUARE)
    return rows + correlation_row(each.first for b in blocks for each in b.values())


def correlation_row(vectors: Iterable[Array]) -> Rows:
    """Strongest correlation between two vectors of noise, against chance."""
    given = [np.ravel(vector) for vector in vectors]
    m = min(len(vector) for vector in given)
    X = np.array([vector[:m] for vector in given])
    X /= np.maximum(np.linalg.norm(X, axis=1), np.finfo(float).tiny)[:, None]
    r = np.minimum(np.abs(X @ X.T), 1.0)  # of equal ones, rounding
    np.fill_diagonal(r, 0.0)
    most = strongest_by_chance(len(X), m)
    return limit(stat.STRONGEST_CORRELATION(), r.max(), most, stat.INDEPENDENT, n=m)


def strongest_by_chance(count: int, m: int) -> float:
    """Correlation that some pair exceeds with probability `FALSE_ALARM`."""
    pairs = max(count * (count - 1) // 2, 1)
    t = scipy.special.stdtrit(m - 1, FALSE_ALARM / (2.0 * pairs))
    return np.sqrt(t * t / (m - 1 + t * t))


def noise_row(x: Float[Array, "t d"]) -> Rows:
    """Mean square of the drawn noise, relative to the requested noise.

    It needs no estimator, and rests on d numbers a trial: so it tells a wrong generator
    from a wrong estimator, and before the estimator's own rows see it.
    """
    error = np.sqrt(2.0 / x.size)  # by the law, chi-square
    return plain(
        stat.NOISE_SQUARE(), np.mean(x * x), error, len(x), 1.0, stat.CHI_SQUARE
    )
