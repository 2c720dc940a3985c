r"""An attitude estimator of one's own: probe, noise, error, beside cubature and bound.

The plug-in's conventions are probed without noise first. Then each trial adds noise to
both body and both reference vectors; the error is the rotation vector from the truth
to the estimate, on the side that the plug-in declares. Its bias and covariance are set
beside Gaussian cubature of the plug-in itself: no theory of it is needed, and the two
share nothing but its code. What cubature of degree 7 differs from degree 5 by, twice,
is the remainder that it is allowed.

Where the plug-in gives a covariance, its normalised squared error has the mean 3, but
for what the claim leaves out. An exact claim is allowed nothing. A claim of order k is
allowed twice what cubature says that it is off by; and it must earn its order: halving
the noise must reduce that by :math:`2^k`, or by :math:`2^{k - 1/2}` at least. So a
wrong leading term is never hidden by its own remainder.
"""

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from simval.arrays import Array
from simval.geometry import attitude_matrix
from simval.montecarlo import mean_square, moments_of, simulate
from simval.plugins import Estimator, find_plugin, probe_estimator
from simval.plugins.answers import covariances_of, quaternions_of
from simval.plugins.probe import TOLERANCE, rotation_error
from simval.results import Outcome, Row
from simval.streams import Streams
from simval.studies.attitude import random_geometry
from simval.studies.isolation import isolated
from simval.studies.study import StudyParameters
from simval.theory.cramer_rao import attitude_bound
from simval.theory.cubature import cubature_moments

BLOCK = 1024
BATCH = 8
AXES = ("x", "y", "z")
RESOLVED = 1e-6
"""Relative error of a claim below which its order cannot be told from rounding."""


class Parameters(StudyParameters):
    """One cell: a plug-in, a geometry and a noise level."""

    algorithm: Annotated[str, Field(min_length=1, max_length=400)] = Field(
        default="", description="FILE.py, FILE.py:NAME or the name of an entry point."
    )
    geometry: Annotated[int, Field(ge=0)] = Field(
        default=3, description="Number of the random attitude and vectors, a seed."
    )
    noise_std: Annotated[float, Field(gt=0.0, le=0.1)] = Field(
        default=0.01, description="Noise per axis of each unit vector, 1."
    )
    samples: Annotated[int, Field(ge=BLOCK)] = Field(
        default=16_384, description="Trials; rounded up to whole blocks of 1024."
    )
    time_limit: Annotated[float, Field(gt=0.0, le=86_400.0)] = Field(
        default=300.0, description="Wall time after which the cell fails, s."
    )


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the plug-in in a child process.

    Parameters
    ----------
    parameters : Parameters
        Plug-in, geometry, noise and number of trials.
    streams : Streams
        The cell's random streams.

    Returns
    -------
    Outcome
        Probe, bias, covariance, RMS, efficiency and NEES.
    """
    return isolated("estimator", parameters, streams, parameters.time_limit)


def compute(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the plug-in in this process.

    Parameters
    ----------
    parameters : Parameters
        As `run`.
    streams : Streams
        As `run`.

    Returns
    -------
    Outcome
        As `run`.
    """
    plugin = find_plugin(parameters.algorithm, Estimator)
    off = probe_estimator(plugin)
    setting = _Setting(plugin, parameters)
    sums = simulate(
        lambda rng, count: (
            setting.errors(
                setting.truth
                + parameters.noise_std * rng.standard_normal((count, 4, 3)),
                parameters.noise_std,
            ).T
        ),
        streams,
        samples=parameters.samples,
        block=BLOCK,
        batch=BATCH,
    )
    rows = [
        Row(
            statistic="probe",
            value=off,
            n=1,
            prediction=TOLERANCE,
            predictor="truth",
            unit="rad",
            check="limit",
        ),
        *_moment_rows(moments_of(sums), *_predicted(setting, parameters.noise_std)),
        *_size_rows(setting, sums, parameters.noise_std),
    ]
    if plugin.covariance is not None:
        rows += _claim_rows(setting, moments_of(sums), parameters.noise_std)
    return Outcome(rows=tuple(rows))


class _Setting:
    """A plug-in at one geometry."""

    def __init__(self, plugin: Estimator, parameters: Parameters) -> None:
        self.plugin = plugin
        self.q, self.r1, self.r2 = random_geometry(parameters.geometry)
        A = attitude_matrix(self.q)
        self.truth = np.stack([A @ self.r1, A @ self.r2, self.r1, self.r2])

    def errors(self, vectors: Array, noise: float) -> Array:
        """Rotation vectors and, with a claim, the normalised square, (n, 3 or 4)."""
        b1, b2, r1, r2 = np.moveaxis(vectors, 1, 0)
        q = quaternions_of(self.plugin, b1, b2, r1, r2)
        error = rotation_error(self.q, q, self.plugin.side)
        if self.plugin.covariance is None:
            return error
        P = covariances_of(self.plugin, b1, b2, r1, r2, noise)
        solved = np.linalg.solve(P, error[..., None])[..., 0]
        return np.column_stack([error, np.sum(error * solved, axis=1)])

    def cubature(self, noise: float, degree: int) -> tuple[Array, Array]:
        """Mean and covariance of `errors` under the noise."""
        count = 4 if self.plugin.covariance is not None else 3
        found = cubature_moments(
            lambda *vectors: self.errors(np.stack(vectors, axis=1), noise),
            self.truth,
            np.broadcast_to(noise**2 * np.eye(3), (4, 3, 3)),
            np.zeros(count),
            degree,
        )
        return -found.bias, found.covariance


def _predicted(setting: _Setting, noise: float) -> tuple[tuple[Array, Array], ...]:
    return setting.cubature(noise, 7), setting.cubature(noise, 5)


def _moment_rows(
    measured: Any, predicted: tuple[Array, Array], coarser: tuple[Array, Array]
) -> list[Row]:
    mean, covariance = predicted
    off = [2.0 * np.abs(a - b) for a, b in zip(predicted, coarser, strict=True)]
    rows = []
    for k, name in enumerate(AXES):
        rows.append(
            Row(
                statistic=f"bias[{name}]",
                value=float(measured.bias[k]),
                standard_error=float(measured.bias_error[k]),
                n=measured.samples,
                prediction=float(mean[k]),
                predictor="cubature",
                remainder=float(off[0][:3].max()),
                unit="rad",
                check="plain",
            )
        )
    for i, j in zip(*np.triu_indices(3), strict=True):
        rows.append(
            Row(
                statistic=f"covariance[{AXES[i]},{AXES[j]}]",
                value=float(measured.covariance[i, j]),
                standard_error=float(measured.covariance_error[i, j]),
                n=measured.samples,
                prediction=float(covariance[i, j]),
                predictor="cubature",
                remainder=float(off[1][:3, :3].max()),
                unit="rad²",
                check="plain",
            )
        )
    return rows


def _size_rows(setting: _Setting, sums: Any, noise: float) -> list[Row]:
    """RMS angle and how it compares with the Cramer-Rao bound."""
    weight = np.zeros((sums.size, sums.size))
    weight[:3, :3] = np.eye(3)
    square, error = mean_square(sums, weight)
    bound = attitude_bound(setting.q, setting.r1, setting.r2, noise)
    least = float(np.trace(bound.rotation))
    rms = float(np.sqrt(square))
    return [
        Row(
            statistic="rms",
            value=rms,
            standard_error=error / (2 * rms),
            n=sums.samples,
            prediction=float(np.sqrt(least)),
            predictor="Cramer-Rao",
            unit="rad",
        ),
        Row(
            statistic="efficiency",
            value=least / square,
            standard_error=least * error / square**2,
            n=sums.samples,
            unit="1",
        ),
    ]


def _claim_rows(setting: _Setting, measured: Any, noise: float) -> list[Row]:
    """Mean normalised square, and whether the claim earns its order."""
    claim = setting.plugin.claim
    off = float(setting.cubature(noise, 7)[0][3]) / 3.0 - 1.0
    half = float(setting.cubature(noise / 2.0, 7)[0][3]) / 3.0 - 1.0
    allowed = 0.0 if claim == "exact" else 6.0 * abs(off)
    rows = [
        Row(
            statistic="nees",
            value=float(measured.bias[3]),
            standard_error=float(measured.bias_error[3]),
            n=measured.samples,
            prediction=3.0,
            predictor=f"claim: {claim}",
            remainder=allowed,
            unit="1",
            check="nees",
        )
    ]
    if claim != "exact":
        rows.append(
            Row(
                statistic="claim_off_at_half_noise",
                value=abs(half),
                n=1,
                prediction=max(abs(off) / 2.0 ** (claim - 0.5), RESOLVED),
                predictor=f"order {claim}",
                unit="1",
                check="limit",
            )
        )
    return rows
