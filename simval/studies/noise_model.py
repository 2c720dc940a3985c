r"""Noise model: whether theory knows how well N, B and K of a sensor are measured.

Each trial draws a signal at rest with white noise, flicker and a random walk, and fits
them (`simval.noise`). The Allan variances are set beside the diagonal of (V4); the
estimates of the squares, before their signs are asked for, beside the covariance of
generalised least squares with (V4) at the truth, and N squared beside Whittle's bound;
the intervals beside their rate.

Theory's covariance is of first order: the weights are known there and estimated here.
What that leaves is stated as it was measured, at the defaults: mean square errors of
0.99, 1.04 and 1.14 times the predicted ones (N, B, K; 4 008 signals of 4 096 rows) and
of 1.00, 1.01 and 1.07 times (6 000 of 16 384 rows), with standard errors of 0.02 to
0.04; intervals that cover 95.1, 93.3 and 96.0 % (the same 6 000; 0.3 %).
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from simval.arrays import Array
from simval.montecarlo import moments_of, simulate
from simval.noise import (
    allan_covariance,
    allan_law,
    allan_variance,
    averaging_counts,
    covariance_forms,
)
from simval.noise.squares import RIDGE, Problem, ends, fitted
from simval.results import Outcome, plain
from simval.sensor import NoiseModel
from simval.shapes import Float
from simval.statistics import (
    ALLAN_ERROR,
    CLOSED_FORM,
    COVERAGE,
    LEAST_SQUARES,
    NORMAL,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
)
from simval.streams import Streams
from simval.studies.study import Cost, StudyParameters
from simval.theory.noise_bound import noise_bound

TITLE = "Noise model: are N, B and K at the bound, and do their intervals hold?"
SECTION = None

BLOCK = 24  # trials; part of the promise of equal bits
RATE = 100.0  # Hz
WHITE = 1.0  # per root Hz; the others are shares of it, the unit cancels
REMAINDERS = (0.03, 0.08, 0.2)  # of N, B and K squared: as measured, see above
LAGS = 1e-3  # of (V4): what its quadrature leaves, `simval.noise.covariance.NODES`
RATE_OF_INTERVALS = 0.95
COVERED = 0.02
SHORTEST = 4  # rows to an average from which samples follow the laws of averages
KINDS = ("N", "B", "K")


class Parameters(StudyParameters):
    """One cell: a signal's length, and its flicker and walk beside white noise."""

    rows: Annotated[int, Field(ge=4096, le=1_000_000)] = Field(
        default=16_384, description="Rows of a signal, at 100 Hz."
    )
    flicker: Annotated[float, Field(gt=0.0, le=10.0)] = Field(
        default=0.5, description="Flicker B over white noise N, root Hz."
    )
    walk: Annotated[float, Field(gt=0.0, le=10.0)] = Field(
        default=0.3, description="Random walk K over white noise N, Hz."
    )
    intervals: bool = Field(
        default=True, description="Whether the intervals are made and counted, too."
    )
    trials: Annotated[int, Field(ge=256)] = Field(
        default=480, description="Signals; rounded up to whole blocks of 24."
    )

    def cost(self) -> Cost:
        """Cost of a cell: a fit with its intervals, and a draw, for each signal."""
        fit = 0.02 if self.intervals else 0.005
        return Cost(0.2 + self.trials * (fit + 4e-7 * self.rows), 40)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell."""
    counts = averaging_counts(parameters.rows)
    law = allan_law(counts)[:, :3]
    forms = covariance_forms(counts, parameters.rows)[..., :3, :3]
    flicker, walk = parameters.flicker * WHITE, parameters.walk * WHITE
    truth = np.array([WHITE**2 * RATE, flicker**2, walk**2 / RATE])
    covariance = allan_covariance(forms, truth)
    predicted = _predicted(law, covariance)
    bound = noise_bound(parameters.rows, RATE, white=WHITE, flicker=flicker, walk=walk)[
        0, 0
    ]
    bound *= RATE**2
    model = NoiseModel(
        white_raw_per_sqrt_hz=WHITE, flicker_raw=flicker, walk_raw_per_sqrt_s=walk
    )
    long = counts >= SHORTEST

    def errors(rng: np.random.Generator, count: int) -> Array:
        columns = []
        for _ in range(count // 3):
            signals = allan_variance(model.draw(parameters.rows, RATE, rng), counts)
            for variances in signals.T:
                problem = Problem(variances, law, forms)
                found = fitted(problem)
                square = (found.free - truth) ** 2
                allan = (variances - law @ truth) ** 2 / np.diagonal(covariance)
                parts = [square / predicted, [square[0] / bound], allan[long]]
                if parameters.intervals:
                    low, high = ends(problem, found)
                    parts.append((low <= truth) & (truth <= high))
                columns.append(np.concatenate(parts))
        return np.array(columns).T

    sums = simulate(errors, streams, samples=parameters.trials, block=BLOCK, batch=1)
    measured = moments_of(sums)
    value, error, n = measured.bias, measured.bias_error, sums.samples
    allan = ALLAN_ERROR.each(f"{m}" for m in counts[long])
    last = 4 + len(allan)
    # that of the predicted law, a mean square of `freedom` squares, whose excess is
    # 12/freedom: the error seen is the smaller the more large squares chance left out
    freedom = 2.0 * (law @ truth)[long] ** 2 / np.diagonal(covariance)[long]
    allan_error = np.sqrt((2.0 + 12.0 / freedom) / n)
    rows = (
        *plain(SQUARED_ERROR.each(f"{k}^2" for k in KINDS), value[:3], error[:3], n,
               1.0, LEAST_SQUARES, REMAINDERS),
        *plain(VARIANCE_OVER_BOUND("N^2"), value[3], error[3], n,
               predicted[0] / bound, LEAST_SQUARES, REMAINDERS[0]),
        *plain(allan, value[4:last], allan_error, n, 1.0, CLOSED_FORM, LAGS),
    )  # fmt: skip
    if parameters.intervals:
        spread = np.sqrt(RATE_OF_INTERVALS * (1.0 - RATE_OF_INTERVALS) / n)
        rows += plain(
            COVERAGE.each(KINDS), value[last:], spread, n,
            RATE_OF_INTERVALS, NORMAL, COVERED,
        )  # fmt: skip
    return Outcome(rows=rows)


def _predicted(
    law: Float[Array, "m 3"], covariance: Float[Array, "m m"]
) -> Float[Array, "3"]:
    # variances of generalised least squares with weights known
    scale = np.sqrt(np.diagonal(covariance))
    factor = np.linalg.cholesky(
        covariance / np.multiply.outer(scale, scale) + RIDGE * np.eye(len(scale))
    )
    rows = np.linalg.solve(factor, law / scale[:, None])
    size = np.linalg.norm(rows, axis=0)
    root = np.linalg.pinv(rows / size) / size[:, None]
    return np.asarray(np.sum(root * root, axis=1))
