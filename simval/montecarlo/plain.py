r"""Seeded trials of a function: mean and covariance of its errors, with their errors.

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

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, reduce

import numpy as np
from numpy.typing import NDArray

from simval.arguments import function, instance, whole_number
from simval.arrays import Array, physical_array, shaped_array
from simval.errors import InputError
from simval.moments import Moments
from simval.shapes import Float
from simval.streams import Streams

GROUP = 16
"""Blocks whose batch means are summed at once; part of the promise of equal bits."""

Sampler = Callable[[np.random.Generator, int], Array]
"""``sampler(rng, count)`` returns the errors of `count` trials, (p, count)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sums:
    """Batch means of the features, merged into count, mean and scatter.

    Attributes
    ----------
    batches : int
        Number of batches.
    batch : int
        Samples in a batch.
    mean : Array
        Mean of the batch means of the features, (m,) with m = p (p + 3) / 2.
    scatter : Array
        Sum of the outer products of their deviations, (m, m).
    """

    batches: int
    batch: int
    mean: Float[Array, " m"]
    scatter: Float[Array, "m m"]

    @property
    def size(self) -> int:
        """Length p of an error."""
        return round((np.sqrt(9 + 8 * len(self.mean)) - 3) / 2)  # m = p (p + 3) / 2

    @property
    def samples(self) -> int:
        """Number of samples behind the sums."""
        return self.batches * self.batch


def merged(first: Sums, second: Sums) -> Sums:
    """Merge two sums with batches of the same size (Chan, Golub and LeVeque)."""
    total = first.batches + second.batches
    step = second.mean - first.mean
    spread = first.batches * second.batches / total * np.outer(step, step)
    return replace(
        first,
        batches=total,
        mean=first.mean + step * (second.batches / total),
        scatter=first.scatter + second.scatter + spread,
    )


def batch_means(errors: Float[Array, "p n"], batch: int) -> Array:
    """Means of the features over batches of consecutive samples."""
    batch = whole_number("batch", batch, 1)
    errors = shaped_array("the errors", errors, (None, None))
    if errors.ndim != 2 or errors.size == 0 or errors.shape[1] % batch:
        msg = (
            f"the errors have shape {errors.shape}; give (p, n), where n is a "
            f"multiple of the {batch} samples of a batch"
        )
        raise InputError(msg)
    p, n = errors.shape
    rows, columns = _upper(p)
    grouped = errors.reshape(p, -1, batch).transpose(1, 0, 2)
    means = np.empty((n // batch, p + len(rows)))
    with np.errstate(invalid="ignore", over="ignore"):  # NaN is judged by the caller
        means[:, :p] = np.add.reduceat(errors, np.arange(0, n, batch), axis=1).T
        means[:, p:] = (grouped @ grouped.transpose(0, 2, 1))[:, rows, columns]
    return means / batch


def sums_of(means: Float[Array, "batches m"], batch: int) -> Sums:
    """Sums of batch means, (batches, m)."""
    mean = means.mean(axis=0)
    deviation = means - mean
    scatter = deviation.T @ deviation
    return Sums(batches=len(means), batch=batch, mean=mean, scatter=scatter)


def simulate(
    sampler: Sampler,
    streams: Streams,
    *,
    samples: int,
    block: int,
    batch: int,
    threads: int = 1,
) -> Sums:
    """Run seeded trials block by block and return the sums of their errors.

    Parameters
    ----------
    sampler : callable
        ``sampler(rng, count)`` returns the errors of `count` trials, (p, count);
        with more than one thread it must not keep state.
    streams : Streams
        The cell's random streams.
    samples : int
        How many trials; rounded up to whole blocks.
    block : int
        Trials in a block; part of the promise of equal bits.
    batch : int
        Trials in a batch of eq. (M1); divides `block`. 1 gives the usual standard
        errors; a larger one costs less per sample and needs many batches.
    threads : int, default 1
        Threads that compute blocks; the bits do not depend on it.

    Returns
    -------
    Sums
        Of all trials; see `moments_of` and `mean_square`.

    Raises
    ------
    InputError
        If `batch` does not divide `block`, or an error of a trial is not finite.
    """
    function("sampler", sampler)
    instance("streams", streams, Streams)
    samples = whole_number("samples", samples, 1)
    block, batch = whole_number("block", block, 1), whole_number("batch", batch, 1)
    threads = whole_number("threads", threads, 1, 1024)
    if block % batch:
        msg = f"`batch` is {batch} and `block` {block}; batch must divide block"
        raise InputError(msg)

    def means(number: int) -> Array:
        errors = shaped_array(
            "the errors", sampler(streams.block(number), block), (None, block)
        )
        return finite_means(batch_means(errors, batch), errors, number)

    return summed(means, -(-samples // block), batch, threads)


def summed(
    means: Callable[[int], Array], blocks: int, batch: int, threads: int
) -> Sums:
    """Sums over blocks of batch means, the same for any number of threads."""
    groups = [range(k, min(k + GROUP, blocks)) for k in range(0, blocks, GROUP)]

    def work(group: range) -> Sums:
        return sums_of(np.concatenate([means(number) for number in group]), batch)

    if threads == 1:
        return reduce(merged, map(work, groups))
    with ThreadPoolExecutor(threads) as pool:
        return reduce(merged, _in_order(pool, work, groups, 4 * threads))


def finite_means(
    means: Float[Array, "batches m"], errors: Float[Array, "p n"], number: int
) -> Float[Array, "batches m"]:
    """Refuse a block with an error that is not finite."""
    if not np.isfinite(means).all():
        bad = int(np.count_nonzero(~np.isfinite(errors).all(axis=0)))
        msg = (
            f"{bad} of {errors.shape[1]} trials in block {number} gave a non-finite "
            "error; the estimator must return finite values on every trial"
        )
        raise InputError(msg)
    return means


def _in_order(
    pool: ThreadPoolExecutor,
    work: Callable[[range], Sums],
    groups: list[range],
    ahead: int,
) -> Iterator[Sums]:
    """Results in the order of the groups, of which few are computed ahead."""
    waiting: deque[Future[Sums]] = deque()
    for group in groups:
        waiting.append(pool.submit(work, group))
        if len(waiting) >= ahead:
            yield waiting.popleft().result()
    yield from (each.result() for each in waiting)


def moments_of(sums: Sums) -> Moments:
    """Bias and covariance of the errors, with standard errors, from their sums.

    Parameters
    ----------
    sums : Sums
        Of two batches or more.

    Returns
    -------
    Moments
        With `samples` and both standard errors.

    Raises
    ------
    InputError
        If there are fewer than two batches, of which no standard error exists.
    """
    variance = _variance(instance("sums", sums, Sums))
    p = sums.size
    rows, columns = _upper(p)
    bias = sums.mean[:p]
    # C_ij = m_ij - b_i b_j, so dC_ij = dm_ij - b_j db_i - b_i db_j
    unit = np.eye(p)
    along = bias[columns, None] * unit[rows] + bias[rows, None] * unit[columns]
    slope = np.hstack([-along, np.eye(len(rows))])
    spread = np.einsum("kf,fg,kg->k", slope, variance, slope)
    # E b b' of the means exceeds that of the truth by the variance of the mean; for
    # plain samples this is the usual n / (n - 1), for reduced ones it is not
    upper = sums.mean[p:] - bias[rows] * bias[columns] + variance[rows, columns]
    return Moments(
        bias=bias,
        covariance=_symmetric(upper, p),
        samples=sums.samples,
        bias_error=np.sqrt(np.diagonal(variance)[:p]),
        covariance_error=_symmetric(np.sqrt(np.maximum(spread, 0.0)), p),
    )


def mean_square(sums: Sums, weight: Float[Array, "p p"]) -> tuple[float, float]:
    """Mean of the weighted square ``e' W e`` and its standard error.

    With the inverse of a predicted covariance as the weight this is the mean
    normalised (estimation) error squared, NEES.

    Parameters
    ----------
    sums : Sums
        Of two batches or more.
    weight : Array
        Symmetric weight W, (p, p).

    Returns
    -------
    value, standard_error : float
        Both in the unit of the weighted square.

    Raises
    ------
    InputError
        If there are fewer than two batches.
    """
    instance("sums", sums, Sums)
    weight = physical_array("weight", weight, (sums.size, sums.size))
    # an inverse is symmetric up to rounding, eps times the condition: 1e-6 allows 4e9
    skew = np.max(np.abs(weight - weight.mT))
    if weight.ndim != 2 or not skew <= 1e-6 * np.max(np.abs(weight)):
        msg = f"`weight` has shape {weight.shape}; one symmetric matrix is needed"
        raise InputError(msg)
    rows, columns = _upper(sums.size)
    twice = np.where(rows == columns, 1.0, 2.0)
    direction = np.concatenate([np.zeros(sums.size), twice * weight[rows, columns]])
    variance = float(direction @ _variance(sums) @ direction)
    return float(direction @ sums.mean), float(np.sqrt(max(variance, 0.0)))


def along(sums: Sums, weight: Array) -> tuple[float, float]:
    """Weighted sum of the biases, or of the covariances, and its standard error.

    Parameters
    ----------
    sums : Sums
        Of two batches or more.
    weight : Array
        Weights of the biases, (p,), or symmetric ones of the covariances, (p, p).

    Returns
    -------
    value, standard_error : float
        Both in the unit of the weighted sum; the entries' own correlations are in it.

    Raises
    ------
    InputError
        If the weights do not fit, or if there are fewer than two batches.
    """
    moments = moments_of(sums)
    p, variance = sums.size, _variance(sums)
    rows, columns = _upper(p)
    weight = physical_array("weight", weight, ())
    if weight.shape not in ((p,), (p, p)):
        msg = f"`weight` has shape {weight.shape}; it must be ({p},) or ({p}, {p})"
        raise InputError(msg)
    if weight.ndim == 1:
        direction = np.concatenate([weight, np.zeros(len(rows))])
        value = float(weight @ moments.bias)
    else:  # of C = E ee' - bb', linearised as in `moments_of`
        twice = np.where(rows == columns, 1.0, 2.0) * weight[rows, columns]
        direction = np.concatenate([-2.0 * weight @ moments.bias, twice])
        value = float(np.sum(weight * moments.covariance))
    return value, float(np.sqrt(max(direction @ variance @ direction, 0.0)))


@cache
def _upper(p: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of each entry of an upper triangle, in reading order."""
    return np.triu_indices(p)


def _variance(sums: Sums) -> Float[Array, "m m"]:
    """Covariance of the mean of the features, eq. (M1)."""
    if not sums.batches >= 2:
        msg = f"{sums.batches} batch of samples has no standard error; use 2 or more"
        raise InputError(msg)
    return sums.scatter / (sums.batches * (sums.batches - 1))


def _symmetric(upper: Float[Array, " m"], p: int) -> Float[Array, "p p"]:
    full = np.zeros((p, p))
    rows, columns = _upper(p)
    full[rows, columns] = full[columns, rows] = upper
    return full
