r"""Attitude moments: noise, estimate in a fixed frame, bias and covariance.

Each trial adds noise to both body and both reference vectors and estimates the
quaternion in the one frame that is greatest at the true geometry. The error is truth
minus estimate, with the formula's own sign. Its empirical bias and covariance are set
beside four predictions: second order, the source's fourth order, the complete fourth
order and the exact answer.

A truncated formula is allowed a remainder. For the second order it is twice the
complete fourth-order term :math:`|F_4 - F_2|`; for the complete fourth order twice
the next term, which is estimated as :math:`|F_4 - F_2|` times the largest relative
size of the fourth-order term of the covariance (a geometric series). Below
:math:`|\bar q|/\sigma` = `RANGE` that estimate is too small, so there the expansions
are recorded and not judged; nor is the source's fourth order anywhere, because it
leaves out terms of its own order.

Beside the plain samples, one in `CONTROLLED` is drawn again in antithetic pairs with
the Taylor polynomial as a control variate; its moments have a standard error of the
next order, so they see errors of a prediction that plain samples cannot.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from simval.arrays import Array
from simval.attitude.kernel import normalize_columns, raw_quaternion
from simval.geometry import attitude_matrix, normalize
from simval.moments import Moments
from simval.montecarlo import (
    mean_square,
    moments_of,
    simulate,
    simulate_reduced,
)
from simval.results import Check, Outcome, Row
from simval.streams import Streams
from simval.studies.study import Cost, StudyParameters
from simval.theory.attitude import AttitudeMoments, attitude_moments

BLOCK = 16384
BATCH = 256
MIN_BATCHES = 256
"""Fewer leave the standard error itself too uncertain for the far tail: with 64 the
gate's false-alarm rate was measured as 1.9e-3 where 1e-3 was stated."""
CONTROLLED = 16
CONTROL_STREAM = 1
RANGE = 5.0
COMPONENTS = ("x", "y", "z", "s")
PREDICTORS: tuple[tuple[int | str, str], ...] = (
    (2, "order 2"),
    ("4-paper", "order 4, source"),
    (4, "order 4, complete"),
    ("exact", "exact"),
)


class Parameters(StudyParameters):
    """One cell: a geometry and a noise level."""

    geometry: Annotated[int, Field(ge=0, lt=2**63)] = Field(
        default=3, description="Number of the random attitude and vectors, a seed."
    )
    noise_std: Annotated[float, Field(gt=0.0, le=0.5)] = Field(
        default=0.01, description="Noise per axis of each unit vector, 1."
    )
    samples: Annotated[int, Field(ge=MIN_BATCHES * BATCH)] = Field(
        default=1_000_000, description="Trials; rounded up to whole blocks of 16384."
    )


def random_geometry(number: int) -> tuple[Array, Array, Array]:
    """True quaternion and reference vectors of a numbered geometry.

    Parameters
    ----------
    number : int
        Seed of NumPy's default generator, from which q, r1 and r2 are drawn in this
        order as normalised standard normals.

    Returns
    -------
    q, r1, r2 : Array
        Unit vectors, (4,), (3,), (3,).
    """
    rng = np.random.default_rng(number)
    return (
        normalize(rng.standard_normal(4)),
        normalize(rng.standard_normal(3)),
        normalize(rng.standard_normal(3)),
    )


def cost(parameters: Parameters) -> Cost:
    """Cost of a cell: a quarter of a second for a million samples.

    Parameters
    ----------
    parameters : Parameters
        The number of samples.

    Returns
    -------
    Cost
        Seconds and rows.
    """
    return Cost(0.05 + 2.5e-7 * parameters.samples, 76)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell and set it beside every prediction.

    Parameters
    ----------
    parameters : Parameters
        Geometry, noise and number of trials.
    streams : Streams
        The cell's random streams.

    Returns
    -------
    Outcome
        Bias, covariance, RMS attitude error and NEES.
    """
    q, r1, r2 = random_geometry(parameters.geometry)
    sigma = parameters.noise_std
    predictions = {
        label: attitude_moments(q, r1, r2, sigma, order=order)
        for order, label in PREDICTORS
    }
    exact = predictions["exact"]
    A = attitude_matrix(q)
    truth = np.stack([A @ r1, A @ r2, r1, r2]).reshape(12, 1)

    def errors(vectors: Array) -> Array:
        error = normalize_columns(raw_quaternion(vectors, exact.frame))
        return np.subtract(exact.q_true[:, None], error, out=error)

    def sampler(rng: np.random.Generator, count: int) -> Array:
        vectors = rng.standard_normal((12, count))
        vectors *= sigma
        vectors += truth
        return errors(vectors)

    sums = simulate(
        sampler, streams, samples=parameters.samples, block=BLOCK, batch=BATCH
    )
    measured = moments_of(sums)
    controlled = moments_of(
        simulate_reduced(
            lambda x: errors(sigma * x + truth),
            Streams(streams.seed, (*streams.key, CONTROL_STREAM)),
            dimension=12,
            method="both",
            samples=max(parameters.samples // CONTROLLED, MIN_BATCHES * BATCH),
            block=BLOCK,
        )
    )
    rows = [
        Row(statistic="norm_over_noise", value=exact.norm / sigma, unit="1"),
        *_moment_rows(measured, predictions, exact.norm / sigma >= RANGE),
        *_control_rows(controlled, exact),
        *_rms_rows(mean_square(sums, np.eye(4)), measured.samples, predictions),
    ]
    weight = np.linalg.pinv(predictions["order 2"].covariance, rcond=1e-8)
    nees, error = mean_square(sums, weight)
    rows.append(
        Row(
            statistic="nees",
            value=nees,
            standard_error=error,
            n=measured.samples,
            prediction=float(np.sum(weight * exact.second_moment)),
            predictor="exact",
            unit="1",
            check="nees",
        )
    )
    return Outcome(rows=tuple(rows))


def _moment_rows(
    measured: Moments, predictions: dict[str, AttitudeMoments], inside: bool
) -> list[Row]:
    remainders = _remainders(predictions)
    rows = []
    for label, predicted in predictions.items():
        judged = label == "exact" or (inside and label != "order 4, source")
        check: Check = "plain" if judged else "record"
        off_bias, off_covariance = remainders[label]
        for k, name in enumerate(COMPONENTS):
            rows.append(
                Row(
                    statistic=f"bias[{name}]",
                    value=float(measured.bias[k]),
                    standard_error=float(measured.bias_error[k]),
                    n=measured.samples,
                    prediction=float(predicted.bias[k]),
                    predictor=label,
                    remainder=off_bias,
                    unit="1",
                    check=check,
                )
            )
        for i, j in zip(*np.triu_indices(4), strict=True):
            rows.append(
                Row(
                    statistic=f"covariance[{COMPONENTS[i]},{COMPONENTS[j]}]",
                    value=float(measured.covariance[i, j]),
                    standard_error=float(measured.covariance_error[i, j]),
                    n=measured.samples,
                    prediction=float(predicted.covariance[i, j]),
                    predictor=label,
                    remainder=off_covariance,
                    unit="1",
                    check=check,
                )
            )
    return rows


def _control_rows(controlled: Moments, exact: AttitudeMoments) -> list[Row]:
    """Bias and covariance under the Taylor control variate, beside the exact ones."""
    pairs = [(i, j) for i in range(4) for j in range(i, 4)]
    names = [f"bias[{name}]" for name in COMPONENTS]
    names += [f"covariance[{COMPONENTS[i]},{COMPONENTS[j]}]" for i, j in pairs]

    def flat(bias: Array, covariance: Array) -> list[float]:
        return [*map(float, bias), *(float(covariance[i, j]) for i, j in pairs)]

    values = flat(controlled.bias, controlled.covariance)
    errors = flat(controlled.bias_error, controlled.covariance_error)
    predictions = flat(exact.bias, exact.covariance)
    return [
        Row(
            statistic=f"control {name}",
            value=value,
            standard_error=error,
            n=controlled.samples,
            prediction=prediction,
            predictor="exact",
            unit="1",
            check="control",
        )
        for name, value, error, prediction in zip(
            names, values, errors, predictions, strict=True
        )
    ]


def _remainders(
    predictions: dict[str, AttitudeMoments],
) -> dict[str, tuple[float, float]]:
    """What each prediction of the bias and of the covariance may be off by."""
    second, fourth = predictions["order 2"], predictions["order 4, complete"]
    bias = float(np.abs(fourth.bias - second.bias).max())
    covariance = float(np.abs(fourth.covariance - second.covariance).max())
    ratio = covariance / float(np.abs(second.covariance).max())
    return {
        "order 2": (2 * bias, 2 * covariance),
        "order 4, source": (2 * bias, 2 * covariance),
        "order 4, complete": (2 * ratio * bias, 2 * ratio * covariance),
        "exact": (0.0, 0.0),
    }


def _rms_rows(
    mean: tuple[float, float], samples: int, predictions: dict[str, AttitudeMoments]
) -> list[Row]:
    """Length of the error's RMS and mean: what the report draws over the noise."""
    rms = float(np.sqrt(mean[0]))
    return [
        Row(
            statistic="rms",
            value=rms,
            standard_error=mean[1] / (2 * rms),
            n=samples,
            prediction=float(np.sqrt(np.trace(predicted.second_moment))),
            predictor=label,
            unit="1",
        )
        for label, predicted in predictions.items()
    ]
