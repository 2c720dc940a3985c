"""Calibration over temperature: terms in temperature, against the bound.

Each rest has its own temperature, over a span, in an order that no axis follows. Each
trial fits the nine parameters and a linear term of each bias and scale, as `simval
calibrate` does once the evidence has chosen them (`simval.imu.calibrate.thermal`), and
again without terms. Theory knows the rows at the truth only (`simval.theory.thermal`):
its bound is the covariance of first order as well, since the rows are weighted by
their noise, and it is allowed the same remainder as that of a calibration without
terms. What is ``left`` is the error of the specific force over the span, and without
terms the price of ignoring temperature.
"""

import numpy as np
import scipy

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Figure, entries
from simval.imu.calibrate import calibrate
from simval.imu.calibrate.gauss_newton import minimize
from simval.imu.calibrate.thermal import law, names_of, thermal_problem
from simval.imu.sensor import forms
from simval.moments import deviations
from simval.montecarlo import moments_of
from simval.poses import PARAMETERS, fibonacci_sphere
from simval.results import Outcome, plain, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.calibration import G, true_sensor
from simval.studies.coverage import FREEDOM, LEVEL
from simval.studies.study import LEAST_NOISE, Cost, StudyParameters, ranged, refusing
from simval.studies.trials import (
    Block,
    drawn_rows,
    mean_of,
    share_error,
    trials_of,
)
from simval.theory.calibration import VARIANCE_NEXT
from simval.theory.coverage import interval_coverage
from simval.theory.thermal import thermal_equations

TITLE = "Temperature: are bias and scale in it at the bound, and what does it cost?"
SECTION = "calibration"

BLOCK = 64  # trials; part of the promise of equal bits
TRUE = np.array([[2e-3, -1e-3, 1.5e-3], [1e-4, -5e-5, 2e-4]])
"""Of bias, m/s^2/K, and scale, 1/K: of a consumer's part, as of a data sheet."""
LINEAR = (("bias", 1), ("scale", 1))
STEPS = 60
NAMES = (*forms.names("triangular"), *names_of(LINEAR))
UNITS = ("1",) * 6 + ("m/s²",) * 3 + ("m/s²/K",) * 3 + ("1/K",) * 3


class Parameters(StudyParameters):
    """One cell: rests, the span of their temperatures, and their noise."""

    poses: int = ranged(30, "Rests, spread evenly over the sphere.", 20, 200)
    temperature_span: float = ranged(
        30.0, "Greatest less least temperature, K.", 2.0, 150.0
    )
    noise_std: float = ranged(
        0.003, "Noise of each axis of a pose mean, m/s^2.", LEAST_NOISE, 0.03
    )
    trials: int = ranged(2048, "Trials; rounded up to whole blocks of 64.", 2 * BLOCK)

    def cost(self) -> Cost:
        """Cost of a cell: two fits for each trial."""
        return Cost(self.trials * (5e-5 + 3e-6 * self.poses), 50)


def offsets(poses: int, span: float) -> Float[Array, " n"]:
    """Temperature of each rest about the mean, in an order unrelated to the poses."""
    order = np.random.default_rng(poses).permutation(poses)
    return span * (order / (poses - 1) - 0.5)


@refusing("lower `noise_std` or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell."""
    sensor, count = true_sensor(0.0), parameters.poses
    tau = offsets(count, parameters.temperature_span)
    powers, sigma = np.stack([tau, tau * tau], axis=-1), parameters.noise_std
    directions = fibonacci_sphere(count)
    force = np.linalg.solve(sensor.matrix, G * directions.T).T
    clean = sensor.B + np.outer(tau, TRUE[0]) + force / (1.0 + np.outer(tau, TRUE[1]))
    truth = np.concatenate([sensor.parameters, TRUE.ravel()])
    theory = thermal_equations(sensor, directions, tau, TRUE, sigma, g=G)
    predicted = deviations(theory.bound)
    dof = count - truth.size
    quantile = scipy.special.stdtrit(dof, 0.5 + LEVEL / 2.0)
    std = np.full(count, sigma)

    def trial(rng: np.random.Generator) -> Block:
        noise = rng.standard_normal((BLOCK, *clean.shape))
        poses = clean + sigma * noise
        without = calibrate(poses, G, covariance=False).require_converged().parameters
        start = np.concatenate([without, np.zeros((BLOCK, TRUE.size))], axis=1)
        problem = thermal_problem(poses, powers, "triangular", G, std, LINEAR)
        found = minimize(problem, start, STEPS)
        error = found.theta - truth
        own, _ = found.here.covariance()
        half = quantile * np.sqrt(
            np.linalg.diagonal(own) * (found.here.chi_square / dof)[:, None]
        )  # fmt: skip
        kept = {
            "error": error,
            "inside": 1.0 * (np.abs(error) <= half),
            "left": _left(found.theta, clean, powers, directions),
            "ignored": _left(start, clean, powers, directions),
        }
        return kept, {"pose means": noise}

    trials = trials_of(streams, parameters.trials, BLOCK, trial)
    measured = moments_of(trials.sums("error"))
    n = measured.samples
    sd, variance_error = measured.sd, np.diagonal(measured.covariance_error)
    remainder = VARIANCE_NEXT * (sigma * np.abs(sensor.matrix).max() / G) ** 2
    bias = np.abs(theory.bias) / predicted
    within, may = interval_coverage(LEVEL, bias, bias, (remainder + FREEDOM) / 2.0, dof)
    return Outcome(
        rows=(
            *plain(
                stat.SD.each(NAMES, UNITS), sd, variance_error / (2.0 * sd), n,
                predicted, stat.CRAMER_RAO, predicted * remainder / 2.0,
            ),
            *plain(
                stat.COVERAGE.each(NAMES), trials["inside"].mean(axis=0),
                share_error(within, n), n, within, stat.STUDENT, may,
            ),
            *unjudged(stat.LEFT("modelled"), *mean_of(trials["left"])),
            *unjudged(stat.LEFT("ignored"), *mean_of(trials["ignored"])),
            *drawn_rows(trials.noise),
        )
    )  # fmt: skip


def _left(
    theta: Float[Array, "t p"],
    clean: Float[Array, "n 3"],
    powers: Float[Array, "n 2"],
    directions: Float[Array, "n 3"],
) -> Float[Array, " t"]:
    # root mean square error of the specific force, of readings without noise
    values = theta[:, PARAMETERS:].reshape(len(theta), -1, 3)
    away, stretch = law(LINEAR, values, powers, clean - theta[:, None, 6:PARAMETERS])
    matrix = forms.matrix("triangular", theta[:, :PARAMETERS])
    off = (stretch * away) @ matrix.mT - G * directions
    return np.sqrt((off * off).sum(axis=-1).mean(axis=-1))


FIGURES = (
    Figure(
        name="thermal-left",
        asked="What does it cost to ignore temperature?",
        says="Error of the force over these spans: {each}.",
        rows=[stat.LEFT],
        along="temperature_span",
        lines=entries,
        compared=False,
        columns=2,
        caption=(
            "Root mean square error of the specific force over the poses and the span "
            "of temperatures, of a calibration with linear terms in temperature and "
            "of one without."
        ),
    ),
    Figure(
        name="thermal-sd",
        asked="Are parameters and terms as accurate as theory allows?",
        what="The spread of the coefficients",
        rows=stat.SD.each(NAMES),
        along="temperature_span",
        lines=entries,
        panels=lambda row: row.statistic.entries[0].partition("_")[0].replace("S", "T"),
        caption=(
            "Standard deviation of each parameter and of each linear "
            "coefficient, and the Cramér-Rao bound: a span of temperatures "
            "twice as wide halves the errors of the coefficients."
        ),
    ),
)
