r"""A user-supplied calibrator: its errors, set beside the Cramer-Rao bound.

The plug-in's conventions are probed without noise first. Then each trial reads a known
sensor in poses spread over the sphere, with noise on each mean, and calibrates; the
error is estimate minus truth in the nine parameters of the triangular form, to which
every answer is brought: norms fix no more.

The plug-in's bias is not predicted. Every residual of the theory is biased by at most
3.5 :math:`\sigma^2/g^2` in scale, so a scale and a misalignment are each allowed
`BIAS_ALLOWED` :math:`\sigma^2/g^2`, and a bias `BIAS_ALLOWED` :math:`\sigma^2/g` of raw
units; a greater one fails. Where it gives a covariance, the mean normalised square must
be 9, up to the square of that bias and the remainder that theory states for a variance.
A covariance of ``type A``, from residuals with :math:`\nu` degrees of freedom (`dof`),
makes it :math:`9 F(9, \nu)` instead of chi-square, with the mean
:math:`9\nu/(\nu - 2)`; it is multiplied by :math:`(\nu - 2)/\nu` before it is judged,
and `FREEDOM` more is allowed. The spread is set beside the bound and kept for the
baseline.

A command is a process for each trial, so its time limit is for every `CALLS` of them.
"""

from math import ceil
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from simval.arrays import Array
from simval.moments import Moments
from simval.montecarlo import moments_of, simulate
from simval.plugins import Calibrator, find_plugin, probe_calibrator
from simval.plugins.answers import calibration_of
from simval.plugins.names import COMMAND
from simval.plugins.probe import TOLERANCE, probe_sensor
from simval.poses import fibonacci_sphere
from simval.results import Outcome, Row, limit, nees, plain, unjudged
from simval.sensor import forms
from simval.statistics import (
    BIAS,
    CLAIM,
    CRAMER_RAO,
    EFFICIENCY,
    NEES,
    NO_BIAS,
    PROBE,
    SD,
    TRUTH,
)
from simval.streams import Streams
from simval.studies.coverage import FREEDOM
from simval.studies.plugin import PluginName, PluginParameters, isolated
from simval.theory.calibration import CalibrationMoments, calibration_moments

TITLE = "User-supplied calibrator: bias, spread and stated covariance"
SECTION = None

BLOCK = 16
BIAS_ALLOWED = 7.0
"""Twice the greatest bias of the ladder's residuals, 3.5."""
CALLS = 64
"""Trials of a command for which the time limit is."""

G = 9.80665


class Parameters(PluginParameters):
    """One cell: a plug-in, a pose count and a noise level."""

    plugin = "algorithm"
    no_noise = ("algorithm", "time_limit")

    algorithm: PluginName = Field(
        default="",
        description="FILE.py, FILE.py:NAME, an entry point, or command: PROGRAM.",
    )
    poses: Annotated[int, Field(ge=9, le=400)] = Field(
        default=24, description="Poses, spread evenly over the sphere."
    )
    noise_std: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.01, description="Noise per axis of a pose mean, m/s^2."
    )
    trials: Annotated[int, Field(ge=2 * BLOCK)] = Field(
        default=1024, description="Trials; rounded up to whole blocks of 16."
    )
    time_limit: Annotated[float, Field(gt=0.0, le=86_400.0)] = Field(
        default=300.0,
        description="Wall time after which the cell fails, s; of a command for every "
        "64 trials.",
    )


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the plug-in in a child process."""
    limit = parameters.time_limit
    if parameters.algorithm.startswith(COMMAND):
        limit *= ceil(parameters.trials / CALLS)
    return isolated(compute, parameters, streams, limit)


def compute(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the plug-in in this process."""
    plugin = find_plugin(parameters.algorithm, Calibrator)
    off = probe_calibrator(plugin)
    sensor = probe_sensor()
    directions = fibonacci_sphere(parameters.poses)
    clean = sensor.distort(G * directions, np.random.default_rng(0))
    scale = float(np.abs(np.linalg.inv(sensor.matrix)).max())
    noise = parameters.noise_std * scale  # raw units
    predicted = calibration_moments(sensor, directions, g=G, noise_std=noise)

    def errors(rng: np.random.Generator, count: int) -> Float[Array, "p count"]:
        raw = clean + noise * rng.standard_normal((count, *clean.shape))
        return np.stack([_error(plugin, poses, noise) for poses in raw], axis=1)

    sums = simulate(errors, streams, samples=parameters.trials, block=BLOCK, batch=1)
    measured = moments_of(sums)
    relative = (parameters.noise_std / G) ** 2
    rows = limit(PROBE(), off, TOLERANCE, TRUTH, n=1)
    rows += _parameter_rows(measured, predicted, relative)
    if sums.size == 10:
        rows += _nees_row(measured, predicted)
    return Outcome(rows=tuple(rows))


def _error(
    plugin: Calibrator, poses: Float[Array, "n 3"], noise: float
) -> Float[Array, " p"]:
    """Error of the nine parameters and, with a covariance, its normalised square."""
    answer = calibration_of(plugin, poses, G, noise)
    sensor = probe_sensor()
    error = answer.parameters("triangular") - sensor.parameters
    if answer.covariance is None:
        return error
    truth = forms.from_gram(plugin.form, sensor.matrix.T @ sensor.matrix, sensor.B)
    own = answer.parameters(plugin.form) - truth
    square = own @ np.linalg.solve(answer.covariance, own)
    # nine over the mean that a Type A covariance gives it
    factor = 1.0 if answer.dof is None else (answer.dof - 2) / answer.dof
    return np.append(error, square * factor)


def _parameter_rows(
    measured: Moments, predicted: CalibrationMoments, relative: float
) -> tuple[Row, ...]:
    bound = np.sqrt(np.diagonal(predicted.cramer_rao))
    sizes = np.abs(probe_sensor().parameters)
    sizes[:3] = 1.0
    sizes[6:] = G / np.abs(probe_sensor().K).min()
    units = ("1",) * 6 + ("raw",) * 3
    sd, n = measured.sd[:9], measured.samples
    variance_error = np.diagonal(measured.covariance_error)[:9]
    efficiency = (bound / sd) ** 2
    return (
        *plain(
            BIAS.each(predicted.names, units), measured.bias[:9],
            measured.bias_error[:9], n, 0.0, NO_BIAS, BIAS_ALLOWED * relative * sizes,
        ),
        *unjudged(
            SD.each(predicted.names, units), sd, variance_error / (2 * sd), n,
            bound, CRAMER_RAO,
        ),
        *unjudged(
            EFFICIENCY.each(predicted.names), efficiency,
            efficiency * variance_error / sd**2, n,
        ),
    )  # fmt: skip


def _nees_row(measured: Moments, predicted: CalibrationMoments) -> tuple[Row, ...]:
    weight = np.linalg.inv(predicted.cramer_rao)
    bias = measured.bias[:9]
    left = bias @ weight @ bias + 9.0 * (predicted.variance_remainder + FREEDOM)
    return nees(
        NEES(), measured.bias[9], measured.bias_error[9], measured.samples,
        9.0, CLAIM, left,
    )  # fmt: skip
