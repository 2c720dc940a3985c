r"""Bias and efficiency of each residual of a calibration.

Every residual is biased at second order in the noise, and the bias does not fall
with more poses. For an ideal sensor and many poses the relative bias of the scale,
in units of :math:`\sigma^2/g^2`, is the ladder -3.5 (squared), -2 (norm), -1.5
(weighted), +0.5 (Sampson), 0 (adjusted); with few poses, or unequal scales, theory
has its own number for each parameter.

Trials come in antithetic pairs, noise and its negative: the mean of a pair has the
bias but not the first-order error. The first and second order of each trial are control
variates (`simval.studies.response`), so a bias of a thousandth of a standard deviation
is measured. Such rows are ``control`` rows; the spread of the
single trials stands beside them as ``plain`` rows, with the Cramer-Rao bound and the
efficiency.

Both predictions are allowed the remainder that theory states for them, and rounding:
that of the poses' condition, in the units of the sensor's scales.
"""

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Figure, Listing, of_calibration, predictor
from simval.imu.calibrate import calibrate
from simval.imu.sensor import AccelerometerModel
from simval.moments import deviations
from simval.montecarlo import moments_of
from simval.poses import fibonacci_sphere, observability
from simval.results import Outcome, Rows, beyond, control, plain, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.calibration import (
    UNITS,
    G,
    expanded,
    response_rows,
    rounding_of,
)
from simval.studies.response import Expanded, Reduced, beside, reduced_mean, stated
from simval.studies.study import (
    LEAST_NOISE,
    Cost,
    StudyParameters,
    described,
    ranged,
    refusing,
)
from simval.studies.trials import Block, correlation_row, noise_row, trials_of
from simval.theory.calibration import CalibrationMoments, calibration_moments
from simval.vocabulary import Residual

TITLE = "Bias ladder: bias, spread and efficiency of each calibration residual"
SECTION = "ladder"

BLOCK = 256  # trials; part of the promise of equal bits
# of many poses of an ideal sensor: `test_the_ladder`, test_theory_calibration_page.py
RUNGS = {"squared": -3.5, "norm": -2.0, "weighted": -1.5, "sampson": 0.5, "adjusted": 0}


class Parameters(StudyParameters):
    """One cell: a residual, a noise level, a pose count and a spread of scales."""

    residual: Residual = described("squared", "What the calibration minimises.")
    noise_std: float = ranged(
        0.1, "Noise of each axis of a pose mean, m/s^2.", LEAST_NOISE, 1.0
    )
    poses: int = ranged(100, "Poses, spread evenly over the sphere.", 10, 1000)
    scale_spread: float = ranged(
        0.0, "Scales of x, y, z are 1 less, 1, 1 plus this.", 0.0, 0.99
    )
    trials: int = ranged(
        4096, "Antithetic pairs; rounded up to blocks of 256.", 2 * BLOCK
    )

    def cost(self) -> Cost:
        """Cost of a cell: the fits of each pair."""
        passes = 1.0 if self.residual in ("squared", "adjusted") else 5.0
        return Cost(self.trials * (2.4e-5 + passes * 4.8e-7 * self.poses), 30)


def true_sensor(scale_spread: float) -> AccelerometerModel:
    """A sensor that is ideal except for its scales."""
    scale = np.array([1.0 - scale_spread, 1.0, 1.0 + scale_spread])
    return AccelerometerModel(T=np.eye(3), K=scale, B=np.zeros(3))


@refusing("lower `noise_std` or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell and compare it with theory."""
    sensor = true_sensor(parameters.scale_spread)
    directions = fibonacci_sphere(parameters.poses)
    clean = sensor.distort(G * directions, np.random.default_rng(0))  # draws nothing
    sigma, residual = parameters.noise_std, parameters.residual

    def trial(rng: np.random.Generator) -> Block:
        noise = sigma * rng.standard_normal((BLOCK, *clean.shape))
        both = np.concatenate([clean + noise, clean - noise])
        fit = calibrate(
            both, G, residual=residual, noise_std=sigma, covariance=False
        ).require_converged()
        plus, minus = np.split(fit.parameters - sensor.parameters, 2)
        return {"noise": noise, "error": plus, "mirrored": minus}, {}

    trials = trials_of(streams, parameters.trials, BLOCK, trial)
    noise, pairs = trials["noise"], np.stack([trials["error"], trials["mirrored"]])
    predicted = calibration_moments(
        sensor, directions, g=G, noise_std=sigma, residual=residual
    )
    known = expanded(sensor, directions, G, noise, sigma, residual)
    measured = moments_of(trials.sums("error"))
    sd, n = measured.sd, measured.samples
    sd_error = np.diagonal(measured.covariance_error) / (2.0 * sd)
    spread = (
        *plain(
            stat.SD.each(predicted.names, UNITS), sd, sd_error, n,
            predicted.sd, stat.FIRST_ORDER, predicted.sd_remainder,
        ),
        *plain(
            stat.EFFICIENCY.each(predicted.names),
            *_efficiency(sd, sd_error, predicted), n,
            predicted.efficiency, stat.FIRST_ORDER,
            predicted.efficiency * predicted.variance_remainder,
        ),
    )  # fmt: skip
    sharper = known.mirrored_sd(pairs)
    rounding = rounding_of(sensor, observability(directions).condition)
    left = predicted.bias_remainder + rounding
    bias = stated(known.mirrored_mean(pairs), predicted.bias, left, n)
    biases = (
        *_rung_rows(parameters, sensor, pairs, known, predicted, left),
        *control(
            stat.BIAS.each(predicted.names, UNITS), *bias, n,
            predicted.bias, stat.SECOND_ORDER, left,
        ),
    )  # fmt: skip
    off = predicted.variance_remainder
    why = f"a variance may be off by {off:.2g} of itself here, and theory holds up to 1"
    return Outcome(
        rows=(
            *noise_row(noise.reshape(n, -1) / sigma),
            *beyond(biases, why if off > 1.0 else ""),
            *spread,
            *beside(
                spread,
                (sharper, _efficiency(*sharper, predicted)),
                np.concatenate(
                    [rounding, 2.0 * predicted.efficiency * rounding / predicted.sd]
                ),
            ),
            *correlation_row(noise.reshape(n // BLOCK, -1)),
            *response_rows(sensor, G * directions, G, residual),
            *_scale_rows(pairs, known, predicted, left[3:6]),
        )
    )


def _efficiency(sd: Array, sd_error: Array, predicted: CalibrationMoments) -> Reduced:
    """Efficiencies from standard deviations."""
    efficiency = (deviations(predicted.cramer_rao) / sd) ** 2
    return efficiency, 2.0 * efficiency * sd_error / sd


def _rung_rows(
    parameters: Parameters,
    sensor: AccelerometerModel,
    pairs: Float[Array, "2 t 9"],
    known: Expanded,
    predicted: CalibrationMoments,
    left: Float[Array, "9"],
) -> Rows:
    """Mean relative bias of the scales, against theory."""
    unit = (parameters.noise_std / G) ** 2
    left_out = (left[3:6] / sensor.K).mean() / unit
    expected = (predicted.bias[3:6] / sensor.K).mean() / unit
    samples = pairs.shape[1]

    def rung(values: Float[Array, "t 9"]) -> Float[Array, " t"]:
        return (values[..., 3:6] / sensor.K).mean(axis=-1) / unit

    found = reduced_mean(
        rung(pairs.mean(axis=0)), rung(known.second), rung(known.mean_second)
    )
    found = stated(found, expected, left_out, samples)
    rows = control(
        stat.SCALE_BIAS(), *found, samples, expected, stat.SECOND_ORDER, left_out
    )
    if parameters.scale_spread == 0.0:  # the ladder is that of an ideal sensor
        many = RUNGS[parameters.residual]
        rows += unjudged(stat.SCALE_BIAS(), *found, samples, many, stat.MANY_POSES)
    return rows


def _scale_rows(
    pairs: Float[Array, "2 t 9"],
    known: Expanded,
    predicted: CalibrationMoments,
    left: Float[Array, "3"],
) -> Rows:
    """Bias of the three scales, projected on the predicted one."""
    n, bias = pairs.shape[1], predicted.bias[3:6]
    size = np.sqrt(np.mean(bias**2))
    if not size > 0.0:  # theory has none at this order
        return ()
    weight = bias / size / 3.0
    found = reduced_mean(
        pairs.mean(axis=0)[:, 3:6] @ weight,
        known.second[:, 3:6] @ weight,
        known.mean_second[3:6] @ weight,
    )
    rest = np.abs(weight) @ left
    return unjudged(
        stat.BIAS_ALONG("K"),
        *stated(found, size, rest, n),
        n,
        size,
        stat.SECOND_ORDER,
        rest,
    )


ALONG_NOISE = Figure(
    name="ladder-noise",
    rows=[stat.BIAS_ALONG],
    by=stat.SECOND_ORDER,
    along="noise_std",
    axis="noise of a pose mean, m/s²",
    lines="residual",
    unit=of_calibration,
    slope=2.0,
    caption="",
)
FIGURES = (
    Figure(
        name="ladder",
        asked="What does each residual of a calibration cost in bias?",
        what="The bias of K",
        says=(
            "The bias of the scale is greatest for {most_of}, {most}, and least for "
            "{least_of}, {least}."
        ),
        rows=[stat.SCALE_BIAS],
        claimed=stat.BIAS.each(("K_x", "K_y", "K_z")),
        by=stat.SECOND_ORDER,
        lines="residual",
        least=["noise_std"],
        ratio=False,
        value="relative bias of the scale",
        beside=[ALONG_NOISE],
        caption=(
            "Bias of the scale at the smallest noise of each residual, a panel for "
            "each sensor and number of poses; it does not fall with more poses. Then "
            "the bias of K along the predicted one, against the noise. Hollow "
            "triangles: upper limits."
        ),
    ),
    Listing(
        name="ladder",
        caption="Bias of the scale in units of σ²/g², by theory and for many poses",
        rows=[stat.SCALE_BIAS],
        keys={"theory": predictor},
        predicted=True,
    ),
)
