r"""Bias ladder and efficiency: what each residual of a calibration costs.

Every residual is biased at second order in the noise, and the bias does not fall
with more poses. For an ideal sensor and many poses the relative bias of the scale,
in units of :math:`\sigma^2/g^2`, is the ladder -3.5 (squared), -2 (norm), -1.5
(weighted), +0.5 (Sampson), 0 (adjusted); with few poses, or unequal scales, theory
has its own number for each parameter.

Trials come in antithetic pairs, noise and its negative: the mean of a pair has the
bias but not the first-order error, so a bias of a hundredth of a standard deviation
is measured. Such rows are ``control`` rows; the spread of the single trials stands
beside them as ``plain`` rows, with the Cramer-Rao bound and the efficiency.

What both predictions leave out was measured at sigma/g = 0.03 and 0.06 with 12 to 200
poses: at most 31 (sigma/g)^4 in bias (misalignment, relative scale, bias over g) and
47 (sigma/g)^2 of a variance; 40 and 60 are allowed. With unequal scales sigma is
there the noise of the corrected reading on the axis of the greatest scale; in that
unit the bias left out at a spread of 0.9 and 0.3 m/s^2 is again at most 31.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from simval.arrays import Array
from simval.calibrate import calibrate
from simval.montecarlo import moments_of, simulate
from simval.poses import fibonacci_sphere
from simval.results import Outcome, Row
from simval.sensor import AccelerometerModel
from simval.streams import Streams
from simval.studies.study import Cost, StudyParameters
from simval.theory.calibration import CalibrationMoments, calibration_moments

BLOCK = 256
G = 9.80665
BIAS_NEXT = 40.0
VARIANCE_NEXT = 60.0
RUNGS = {"squared": -3.5, "norm": -2.0, "weighted": -1.5, "sampson": 0.5, "adjusted": 0}
UNITS = ("1",) * 6 + ("m/s²",) * 3


class Parameters(StudyParameters):
    """One cell: a residual, a noise level, a pose count and a spread of scales."""

    residual: Literal["squared", "norm", "weighted", "sampson", "adjusted"] = Field(
        default="squared", description="What the calibration minimises."
    )
    noise_std: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.1, description="Noise of each axis of a pose mean, m/s^2."
    )
    poses: Annotated[int, Field(ge=10, le=1000)] = Field(
        default=100, description="Poses, spread evenly over the sphere."
    )
    scale_spread: Annotated[float, Field(ge=0.0, lt=1.0)] = Field(
        default=0.0, description="Scales of x, y, z are 1 less, 1, 1 plus this."
    )
    trials: Annotated[int, Field(ge=2 * BLOCK)] = Field(
        default=4096, description="Antithetic pairs; rounded up to blocks of 256."
    )


def true_sensor(scale_spread: float) -> AccelerometerModel:
    """Return an ideal sensor but for its scales.

    Parameters
    ----------
    scale_spread : float
        Scales are 1 - spread, 1 and 1 + spread.

    Returns
    -------
    AccelerometerModel
        No misalignment, no bias.
    """
    scale = np.array([1.0 - scale_spread, 1.0, 1.0 + scale_spread])
    return AccelerometerModel(T=np.eye(3), K=scale, B=np.zeros(3))


def cost(parameters: Parameters) -> Cost:
    """Cost of a cell: two fits for each pair.

    Parameters
    ----------
    parameters : Parameters
        Residual, poses and pairs.

    Returns
    -------
    Cost
        Seconds and rows.
    """
    passes = 1.0 if parameters.residual in ("squared", "adjusted") else 4.0
    one = 1e-5 + passes * 3e-7 * parameters.poses
    return Cost(2.0 * parameters.trials * one, 29)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell and set it beside theory.

    Parameters
    ----------
    parameters : Parameters
        Residual, noise, poses, spread and number of pairs.
    streams : Streams
        The cell's random streams.

    Returns
    -------
    Outcome
        Bias and rung, standard deviation, efficiency.
    """
    sensor = true_sensor(parameters.scale_spread)
    directions = fibonacci_sphere(parameters.poses)
    clean = sensor.distort(G * directions, np.random.default_rng(0))  # draws nothing
    sigma, residual = parameters.noise_std, parameters.residual
    unit, worst = (sigma / G) ** 2, _worst_noise(sensor, sigma)

    def errors(rng: np.random.Generator, count: int) -> Array:
        noise = sigma * rng.standard_normal((count, *clean.shape))
        both = np.concatenate([clean + noise, clean - noise])
        fit = calibrate(
            both, G, residual=residual, noise_std=sigma, covariance=False
        ).require_converged()
        error = fit.parameters - sensor.parameters
        even = (error[:count] + error[count:]) / 2.0
        rung = (even[:, 3:6] / sensor.K).mean(axis=1) / unit
        return np.concatenate([even, error[:count], rung[:, None]], axis=1).T

    sums = simulate(errors, streams, samples=parameters.trials, block=BLOCK, batch=1)
    measured = moments_of(sums)
    predicted = calibration_moments(
        sensor, directions, g=G, noise_std=sigma, residual=residual
    )
    bias, bias_error = measured.bias, measured.bias_error
    sd = measured.sd[9:18]
    sd_error = np.diagonal(measured.covariance_error)[9:18] / (2.0 * sd)
    return Outcome(
        rows=(
            *_rung_rows(
                parameters, sensor, predicted, bias[18], bias_error[18], sums.samples
            ),
            *_bias_rows(
                sensor, predicted, bias[:9], bias_error[:9], worst, sums.samples
            ),
            *_spread_rows(predicted, sd, sd_error, worst, sums.samples),
        )
    )


def _rung_rows(
    parameters: Parameters,
    sensor: AccelerometerModel,
    predicted: CalibrationMoments,
    value: float,
    error: float,
    samples: int,
) -> list[Row]:
    unit = (parameters.noise_std / G) ** 2
    left_out = BIAS_NEXT * _worst_noise(sensor, parameters.noise_std) ** 2 / unit
    expected = float((predicted.bias[3:6] / sensor.K).mean() / unit)
    rows = [
        Row(
            statistic="scale_bias",
            value=float(value),
            standard_error=float(error),
            n=samples,
            prediction=expected,
            predictor="second order",
            remainder=left_out,
            unit="σ²/g²",
            check="control",
        )
    ]
    if parameters.scale_spread == 0.0:  # the ladder is that of an ideal sensor
        rows.append(
            Row(
                statistic="scale_bias",
                value=float(value),
                standard_error=float(error),
                n=samples,
                prediction=float(RUNGS[parameters.residual]),
                predictor="many poses",
                unit="σ²/g²",
            )
        )
    return rows


def _worst_noise(sensor: AccelerometerModel, noise_std: float) -> float:
    """Squared noise of the corrected reading on its worst axis, by that of gravity."""
    return float((noise_std * sensor.K.max() / G) ** 2)


def _bias_rows(
    sensor: AccelerometerModel,
    predicted: CalibrationMoments,
    bias: Array,
    error: Array,
    unit: float,
    samples: int,
) -> list[Row]:
    natural = np.concatenate([np.ones(3), sensor.K, G / sensor.K])
    return [
        Row(
            statistic=f"bias[{name}]",
            value=float(bias[k]),
            standard_error=float(error[k]),
            n=samples,
            prediction=float(predicted.bias[k]),
            predictor="second order",
            remainder=float(BIAS_NEXT * unit**2 * natural[k]),
            unit=UNITS[k],
            check="control",
        )
        for k, name in enumerate(predicted.names)
    ]


def _spread_rows(
    predicted: CalibrationMoments, sd: Array, error: Array, unit: float, samples: int
) -> list[Row]:
    bound = np.sqrt(np.diagonal(predicted.cramer_rao))
    rows = []
    for k, name in enumerate(predicted.names):
        expected = float(predicted.sd[k])
        efficiency = float(bound[k] / sd[k]) ** 2
        rows += [
            Row(
                statistic=f"sd[{name}]",
                value=float(sd[k]),
                standard_error=float(error[k]),
                n=samples,
                prediction=expected,
                predictor="first order",
                remainder=expected * VARIANCE_NEXT * unit / 2.0,
                unit=UNITS[k],
                check="plain",
            ),
            Row(
                statistic=f"efficiency[{name}]",
                value=efficiency,
                standard_error=float(2.0 * efficiency * error[k] / sd[k]),
                n=samples,
                prediction=float(predicted.efficiency[k]),
                predictor="first order",
                remainder=float(predicted.efficiency[k]) * VARIANCE_NEXT * unit,
                unit="1",
                check="plain",
            ),
        ]
    return rows
