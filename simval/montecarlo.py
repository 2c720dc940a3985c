r"""Seeded trials of a callable: streaming mean and covariance with standard errors.

A sample is a p-vector error :math:`e`. The features of a sample are
:math:`m = (e, \mathrm{vech}\, ee^T)`; they are averaged over batches of consecutive
samples, and the covariance of the batch means gives the standard error of everything
linear in the features, with no assumption on the distribution of :math:`e`:

.. math:: \mathrm{SE}^2(\bar m) = \frac{1}{n_b (n_b - 1)} \sum_b (m_b - \bar m)^2.
   \tag{M1}

The covariance :math:`C = \overline{ee^T} - \bar e \bar e^T` is linearised about the
mean for its standard error; what is left out is smaller by :math:`1/\sqrt{n}`.

Work is cut into blocks of fixed size. Each block has its own stream and leaves sums;
the sums are merged in the order of the blocks, so the bits do not depend on how many
workers computed them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.moments import Moments
from simval.streams import Streams

Sampler = Callable[[np.random.Generator, int], Array]
"""``sampler(rng, count)`` returns the errors of `count` trials, (p, count)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sums:
    """Merged batch means of the features: count, mean and scatter.

    Attributes
    ----------
    batches : int
        Number of batches.
    mean : Array
        Mean of the batch means of the features, (m,).
    scatter : Array
        Sum of the outer products of their deviations, (m, m).
    """

    batches: int
    mean: Array
    scatter: Array

    def merged(self, other: "Sums") -> "Sums":
        """These sums and another's together (Chan, Golub and LeVeque's update).

        Parameters
        ----------
        other : Sums
            Sums of other batches.

        Returns
        -------
        Sums
            Of all batches.
        """
        total = self.batches + other.batches
        step = other.mean - self.mean
        weight = self.batches * other.batches / total
        return Sums(
            batches=total,
            mean=self.mean + step * (other.batches / total),
            scatter=self.scatter + other.scatter + weight * np.outer(step, step),
        )


def sums_of(errors: Array, batch: int) -> Sums:
    """Sums of one block of errors.

    Parameters
    ----------
    errors : Array
        Errors, (p, n), n a multiple of `batch`.
    batch : int
        Samples in a batch.

    Returns
    -------
    Sums
        Of n / batch batches.
    """
    p, n = errors.shape
    grouped = errors.reshape(p, n // batch, batch).transpose(1, 0, 2)
    second = grouped @ grouped.transpose(0, 2, 1) / batch  # (n / batch, p, p)
    rows, columns = np.triu_indices(p)
    means = np.concatenate([grouped.mean(axis=2), second[:, rows, columns]], axis=1)
    mean = means.mean(axis=0)
    deviation = means - mean
    return Sums(batches=len(means), mean=mean, scatter=deviation.T @ deviation)


def moments_of(sums: Sums, batch: int) -> Moments:
    """Bias and covariance of the errors, with standard errors, from their sums.

    Parameters
    ----------
    sums : Sums
        Of two batches or more.
    batch : int
        Samples in a batch.

    Returns
    -------
    Moments
        With `samples` and both standard errors.

    Raises
    ------
    InputError
        If there are fewer than two batches, of which no standard error exists.
    """
    if not sums.batches >= 2:
        msg = f"{sums.batches} batch of samples has no standard error; use 2 or more"
        raise InputError(msg)
    features = len(sums.mean)
    p = round((np.sqrt(9 + 8 * features) - 3) / 2)  # features = p (p + 3) / 2
    rows, columns = np.triu_indices(p)
    bias = sums.mean[:p]
    samples = sums.batches * batch
    # C_ij = m_ij - b_i b_j, so dC_ij = dm_ij - b_j db_i - b_i db_j
    slope = np.zeros((len(rows), features))
    pairs = np.arange(len(rows))
    slope[pairs, p + pairs] = 1.0
    np.add.at(slope, (pairs, rows), -bias[columns])
    np.add.at(slope, (pairs, columns), -bias[rows])
    variance = sums.scatter / (sums.batches * (sums.batches - 1))
    spread = np.einsum("kf,fg,kg->k", slope, variance, slope)
    upper = (sums.mean[p:] - bias[rows] * bias[columns]) * samples / (samples - 1)
    return Moments(
        bias=bias,
        covariance=_symmetric(upper, p),
        samples=samples,
        bias_error=np.sqrt(np.diagonal(variance)[:p]),
        covariance_error=_symmetric(np.sqrt(np.maximum(spread, 0.0)), p),
    )


def simulate(
    sampler: Sampler, streams: Streams, *, samples: int, block: int, batch: int
) -> Moments:
    """Run seeded trials block by block and return the moments of their errors.

    Parameters
    ----------
    sampler : callable
        ``sampler(rng, count)`` returns the errors of `count` trials, (p, count).
    streams : Streams
        The cell's random streams.
    samples : int
        How many trials; rounded up to whole blocks.
    block : int
        Trials in a block; part of the promise of equal bits.
    batch : int
        Trials in a batch of eq. (M1); divides `block`. 1 gives the usual standard
        errors; a larger one costs less per sample and needs many batches.

    Returns
    -------
    Moments
        Bias and covariance of the errors, with standard errors.

    Raises
    ------
    InputError
        If `batch` does not divide `block`, or an error of a trial is not finite.
    """
    if block % batch or samples < 1:
        msg = (
            f"`samples`={samples}, `block`={block}, `batch`={batch}: samples must be "
            "positive and batch must divide block"
        )
        raise InputError(msg)
    total: Sums | None = None
    for number in range(-(-samples // block)):
        errors = sampler(streams.block(number), block)
        sums = sums_of(errors, batch)
        if not np.isfinite(sums.mean).all():
            bad = int(np.count_nonzero(~np.isfinite(errors).all(axis=0)))
            msg = (
                f"{bad} of {block} trials in block {number} gave a non-finite error; "
                "the estimator must return finite values on every trial"
            )
            raise InputError(msg)
        total = sums if total is None else total.merged(sums)
    assert total is not None  # samples >= 1
    return moments_of(total, batch)


def _symmetric(upper: Array, p: int) -> Array:
    full = np.zeros((p, p))
    rows, columns = np.triu_indices(p)
    full[rows, columns] = upper
    full[columns, rows] = upper
    return full
