r"""Assumptions of every study: streams are independent, variances unbiased.

Streams: blocks of neighbouring numbers, of this seed and of another, of this cell and
of one that differs in a bit of its key, must be as independent as they are named. Their
mean square and their strongest correlation are judged by `simval.studies.trials`.

Variances: over all k^n samples of n values, drawn with replacement from k given ones,
the mean of an unbiased variance is the population's own, whatever the values are:

.. math:: \frac{1}{k^n} \sum s^2 = \frac1k \sum_j (v_j - \bar v)^2.  \tag{R3}

So each routine that estimates a variance, or the standard error of a mean, is given all
of them: n in the place of n - 1 makes it :math:`1 - 1/n`. Nothing is left to chance.
"""

from collections.abc import Callable
from itertools import product

import numpy as np

from simval.arrays import Array
from simval.consistency import mean_of_trials
from simval.imu.statics import initial_rest, variance_magnitude
from simval.montecarlo import Sums, moments_of, simulate
from simval.results import Outcome, Rows, exact
from simval.shapes import Float
from simval.statistics import ENUMERATED, UNBIASED_VARIANCE
from simval.streams import Streams
from simval.studies.response import reduced_mean
from simval.studies.study import Cost, StudyParameters, ranged
from simval.studies.trials import Drawn, drawn_rows, mean_of

TITLE = "Sampling: independent streams, and variances by n - 1"
SECTION = None

VALUES = np.array([-1.0, 0.25, 2.0])
"""Any three that are not equal; of dyadic numbers, so that sums do not round."""
SAMPLES = 3
ROUNDED = 1e-12
"""Of sums of 27 variances."""


class Parameters(StudyParameters):
    """One cell: how many streams of each kind, and how long they are."""

    blocks: int = ranged(32, "Neighbouring blocks of each stream.", 2, 256)
    numbers: int = ranged(8192, "Numbers of each block.", 1024, 1_000_000)

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.05 + 1.5e-7 * self.blocks * self.numbers, 11)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Draw the streams, and estimate the variances of all samples."""
    kinds = {
        "this cell": streams,
        "another seed": Streams(streams.seed + 1, streams.key),
        "another cell": Streams(streams.seed, (*streams.key[:-1], streams.key[-1] ^ 1)),
    }
    blocks = [
        {
            name: Drawn.of(each.block(k).standard_normal(parameters.numbers))
            for name, each in kinds.items()
        }
        for k in range(parameters.blocks)
    ]
    return Outcome(rows=(*drawn_rows(blocks), *_variance_rows()))


def _variance_rows() -> Rows:
    """Mean of each estimated variance over all samples, against the true one."""
    every = np.array(list(product(VALUES, repeat=SAMPLES)))
    true = np.var(VALUES)
    names, means = [], []
    for name, (variance, share) in _ROUTINES.items():
        names.append(name)
        means.append(np.mean([variance(values) for values in every]) / (share * true))
    return exact(UNBIASED_VARIANCE.each(names), means, 1.0, ENUMERATED, ROUNDED)


def _sums(values: Float[Array, " n"]) -> Sums:
    # batches of one sample each, from given numbers and not from a stream
    return simulate(
        lambda rng, count: values[None], Streams(0, (0,)), samples=len(values),
        block=len(values), batch=1,
    )  # fmt: skip


def _alone(values: Float[Array, " n"]) -> Float[Array, "n 3"]:
    return values[:, None] * np.array([1.0, 0.0, 0.0])


_Routine = Callable[[Float[Array, " n"]], float]
_OF_MEAN = 1.0 / SAMPLES  # of the variance, that of a mean
_ROUTINES: dict[str, tuple[_Routine, float]] = {
    "moments": (lambda v: float(moments_of(_sums(v)).covariance[0, 0]), 1.0),
    "error of moments": (
        lambda v: float(moments_of(_sums(v)).bias_error[0]) ** 2, _OF_MEAN,
    ),
    "error of trials": (lambda v: mean_of(v)[1] ** 2, _OF_MEAN),
    "error of rows": (lambda v: mean_of_trials(v[:, None])[1] ** 2, _OF_MEAN),
    "error of a reduced mean": (
        lambda v: float(reduced_mean(v, np.zeros_like(v), 0.0)[1]) ** 2, _OF_MEAN,
    ),
    "window": (lambda v: float(variance_magnitude(_alone(v), SAMPLES)[1]), 1.0),
    "initial rest": (
        lambda v: _rest(v), 1.0,
    ),
}  # fmt: skip


def _rest(values: Float[Array, " n"]) -> float:
    # a rest that does not vary is refused: its variance is 0
    if np.ptp(values) == 0.0:
        return 0.0
    return initial_rest(_alone(values), count=len(values), window=SAMPLES).variance
