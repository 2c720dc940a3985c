r"""Coverage of the error bars that a calibration reports.

Each trial calibrates one noisy pose set and asks whether the reported 95 % interval
of each parameter holds the truth, and whether the truth lies within the reported 95 %
ellipsoid of all nine: the normalised squared error (NEES) against chi-square(9) with
a known sigma, against 9 F(9, N - 9) with a Type A covariance.

The laws are those of first order. The next one changes a reported variance by what
theory states (`simval.theory.calibration`), and Type A takes n - 9 degrees of freedom
where unequal scales make it a little more: 0.3 % of the variance for scales within 5 %.
A bias does not fall with more poses, as the error bars do, so the laws are those of an
error about the bias of second order (`simval.theory.coverage`).
"""

from typing import Literal, Self

import numpy as np
import scipy
from pydantic import model_validator

from simval import statistics as stat
from simval.imu.calibrate import calibrate
from simval.imu.sensor import names
from simval.montecarlo import moments_of
from simval.poses import fibonacci_sphere
from simval.results import Outcome, nees, plain, unjudged
from simval.streams import Streams
from simval.studies.calibration import G, response_rows, true_sensor
from simval.studies.study import (
    LEAST_NOISE,
    Cost,
    StudyParameters,
    described,
    ranged,
    refusing,
)
from simval.studies.trials import (
    Block,
    drawn_rows,
    mean_of,
    share_error,
    stated_of,
    trials_of,
)
from simval.theory.calibration import calibration_moments
from simval.theory.coverage import bias_square, ellipsoid_coverage, interval_coverage
from simval.vocabulary import Residual

TITLE = "Coverage: do the reported error bars of a calibration hold?"
SECTION = "statistics"

BLOCK = 512  # trials; part of the promise of equal bits
LEVEL = 0.95  # as of the intervals that a calibration states
FREEDOM = 0.003
"""Relative, of a Type A variance; measured for scales within 5 %, like those here."""


class Parameters(StudyParameters):
    """One cell: how the error bars are made, pose count and noise."""

    sigma: Literal["known", "type A"] = described(
        "type A", "Noise known, or taken from the residuals."
    )
    residual: Residual = described(
        "squared",
        "What the calibration minimises; adjusted needs a known sigma.",
    )
    poses: int = ranged(20, "Poses, spread evenly over the sphere.", 10, 1000)
    noise_std: float = ranged(
        0.01, "Noise of each axis of a pose mean, m/s^2.", LEAST_NOISE, 0.3
    )
    trials: int = ranged(
        10_240, "Trials; rounded up to whole blocks of 512.", 2 * BLOCK
    )

    @model_validator(mode="after")
    def _require_known(self) -> Self:
        """Check that the noise is known to a method that subtracts it."""
        if self.residual == "adjusted" and self.sigma != "known":
            msg = (
                f"`residual` is adjusted and `sigma` is {self.sigma}: it takes the "
                'noise out of the moments, so give sigma = "known", or another residual'
            )
            raise ValueError(msg)
        return self

    def cost(self) -> Cost:
        """Cost of a cell: one fit with its covariance for each trial."""
        return Cost(self.trials * (2.5e-5 + 2e-7 * self.poses), 12)


@refusing("lower `noise_std` or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell."""
    sensor = true_sensor(0.0)
    directions = fibonacci_sphere(parameters.poses)
    clean = sensor.distort(G * directions, np.random.default_rng(0))  # draws nothing
    known = parameters.sigma == "known"
    dof = parameters.poses - 9
    limit = nees_quantile(LEVEL, None if known else dof)
    predicted = calibration_moments(
        sensor, directions, G, parameters.noise_std, parameters.residual
    )

    def trial(rng: np.random.Generator) -> Block:
        noise = parameters.noise_std * rng.standard_normal((BLOCK, *clean.shape))
        fit = calibrate(
            clean + noise,
            G,
            residual=parameters.residual,
            noise_std=parameters.noise_std if known else None,
        ).require_converged()
        inside, squares = stated_of(fit, sensor.parameters, LEVEL)
        plain = np.abs(fit.parameters - sensor.parameters) <= 1.96 * fit.sd
        columns = [inside, squares[:, None] <= limit, plain.mean(axis=1)[:, None]]
        if known:
            columns.append(squares[:, None])
        stated = np.mean((fit.sd / predicted.sd) ** 2, axis=1)
        kept = {"of each": np.concatenate(columns, axis=1).astype(float)}
        return kept | {"stated": stated}, {"pose means": noise / parameters.noise_std}

    trials = trials_of(streams, parameters.trials, BLOCK, trial)
    measured = moments_of(trials.sums("of each"))
    n, covered = measured.samples, measured.bias
    relative = (predicted.variance_remainder + FREEDOM) / 2.0
    bias, left = predicted.bias, predicted.bias_remainder
    freedom = None if known else dof
    inside, may = interval_coverage(
        LEVEL, bias / predicted.sd, left / predicted.sd, relative, freedom
    )
    shift, off = bias_square(bias, left, predicted.covariance)
    whole, all_may = ellipsoid_coverage(LEVEL, 9, shift, off, relative, freedom)
    # that of the predicted fraction: the fraction seen is the larger the smaller
    # its own standard error, which makes chance look like a fault
    rows = (
        *plain(
            stat.COVERAGE.each(names("triangular")), covered[:9],
            share_error(inside, n), n,
            inside, stat.NORMAL if known else stat.STUDENT, may,
        ),
        *plain(
            stat.COVERAGE("ellipsoid"), covered[9], share_error(whole, n), n,
            whole, stat.CHI_SQUARE if known else stat.F_LAW, all_may,
        ),
        *unjudged(stat.COVERAGE_NORMAL(), covered[10], measured.bias_error[10], n),
    )  # fmt: skip
    if known:
        rows += nees(
            stat.NEES(), covered[11], measured.bias_error[11], n,
            9.0 + shift, stat.CHI_SQUARE, (9.0 + shift) * 2.0 * relative + off,
        )  # fmt: skip
    else:  # the variance of the residuals is unbiased
        rows += plain(
            stat.STATED_VARIANCE(), *mean_of(trials["stated"]),
            1.0, stat.FIRST_ORDER, 2.0 * relative,
        )  # fmt: skip
    rows += drawn_rows(trials.noise)
    rows += response_rows(sensor, G * directions, G, parameters.residual)
    return Outcome(rows=rows)


def nees_quantile(level: float, dof: int | None) -> float:
    """Value that the NEES exceeds with probability 1 - level."""
    if dof is None:
        return 2.0 * scipy.special.gammaincinv(4.5, level)
    return 9.0 * scipy.special.fdtri(9, dof, level)
