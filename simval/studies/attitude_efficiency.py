r"""Efficiency: how much accuracy the closed form loses against the bound.

Over many geometries, drawn once for all, the RMS error of each estimator is set against
the Cramer-Rao bound of the two-vector problem, which the q-method reaches to first
order. The median ratio of 500 random geometries has itself a standard error of 0.003.
The first-order ratios involve no chance; the simulation, with the same noise for every
estimator, must bear them out: its squared errors over the predicted ones have mean 1.

The noise is of one of the kinds of `simval.studies.noise_kinds`, and the vectors go
into the estimators as they are or normalised; `optimal`, the q-method and TRIAD always
normalise. Under unequal noise `optimal` and the q-method are given the weights of
maximum likelihood, the others take none. Noise along the vectors carries no attitude,
and what `combined` makes of it is its whole price: at an angle theta between them it
adds, to the mean square of the q-method without weights,

.. math:: \tfrac14 \cot^2\theta\,
   (\sigma_{b1}^2 + \sigma_{b2}^2 + \sigma_{r1}^2 + \sigma_{r2}^2),  \tag{AE1}

so that for equal noise its ratio is :math:`\sqrt{5 / (4 + \sin^2\theta)}`, (K7) of
docs/theory.md. A body vector that is too long by a share e turns `combined` by
:math:`\tfrac12 e \cot\theta`, (K6), to first order; it was off by at most
:math:`e^2 / (8 \sin^2\theta)` in 10,000 geometries, and half as much again is allowed.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, Final

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Distribution, Listing, entry
from simval.geometry import attitude_error, cross, normalize, random_quaternions
from simval.imu.attitude import two_vector_quaternion
from simval.imu.attitude.comparators import davenport, triad
from simval.imu.attitude.estimator import Selection
from simval.results import Outcome, Row, Rows, exact, plain, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.attitude import Truth, Truths
from simval.studies.noise_kinds import (
    DEVIATIONS,
    TAILS,
    NoiseKind,
    noise_covariances,
    noise_roots,
    tails,
)
from simval.studies.study import LEAST_NOISE, Cost, StudyParameters, described, ranged
from simval.theory.attitude import attitude_moments
from simval.theory.cramer_rao import attitude_bound
from simval.theory.estimators import wahba_moments
from simval.theory.two_vector import Frame, true_vectors

TITLE = "Efficiency: cost of the closed form against the Cramer-Rao bound"
SECTION = "estimators"

MIN_SINE = 0.3
"""Of the angle between r1 and r2."""

ROUNDED = 1e-12
"""Of a first-order ratio: some hundred operations, over the square of a sine of 0.3."""

REMAINDER = 1e-3
"""The second-order term of a squared error, relative: 90 (sigma/MIN_SINE)^2 at the
default noise."""

ESTIMATORS = ("combined", "best of four", "optimal", "q-method", "TRIAD")
JUDGED = ("combined", "optimal", "q-method")
"""Free selection follows the noise, and TRIAD has no prediction here."""


WEIGHTS: Final = tuple(1.0 / np.sum(np.reshape(DEVIATIONS, (2, 2)) ** 2, axis=0))
"""Of maximum likelihood under unequal noise: inverse of the summed variances."""


def estimators(parameters: "Parameters") -> dict[str, Callable[..., Array]]:
    """The estimators to compare, with vectors normalised or as they are."""
    weights = WEIGHTS if parameters.noise == "unequal" else (1.0, 1.0)
    frames: tuple[Selection, ...] = ("combined", "best")
    ours = (
        partial(two_vector_quaternion, frame=frame, normalized=parameters.normalized)
        for frame in frames
    )
    optima = (
        partial(each, weights=weights) for each in (two_vector_quaternion, davenport)
    )
    return dict(zip(ESTIMATORS, (*ours, *optima, triad), strict=True))


TOO_LONG: Final = 0.02
"""Share by which one body vector is too long."""

AT_ONCE = 4096
"""Trials of some geometries, for the cache; no result depends on it."""

MOST_TRIALS = 1_000_000
"""Those of a geometry are held all at once."""


class Parameters(StudyParameters):
    """One cell: how many geometries and trials, at which noise."""

    # the same draws for each shape of the noise, so that cells compare
    no_noise = ("noise", "normalized")

    noise: NoiseKind = described("isotropic", "Noise of the four vectors.")
    normalized: bool = described(False, "Normalise the vectors before they are used.")
    geometries: int = ranged(500, "Random attitudes and vector pairs.", 100)
    trials: int = ranged(200, "Trials for each geometry.", 10, MOST_TRIALS)
    noise_std: float = ranged(
        1e-3, "Noise per axis of each unit vector.", LEAST_NOISE, 1e-3
    )

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.1 + 5e-6 * self.geometries * self.trials, 20)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Predict and simulate the RMS errors of one cell."""
    # always the same geometries, so that the predicted ratios involve no chance
    rng = np.random.default_rng(parameters.geometries)
    problems = geometries(parameters.geometries, rng)
    predicted = predicted_squares(problems, parameters)
    squares, errors = _simulated(problems, parameters, streams)
    best = ESTIMATORS.index("q-method")
    ratios = np.sqrt(predicted / predicted[:, best, None])
    simulated = np.sqrt(squares / squares[:, best, None])
    relative = errors / squares
    # as if both mean squares were independent: they share their noise, so at most this
    error = simulated * np.hypot(relative, relative[:, best, None]) / 2.0
    unit = predicted * parameters.noise_std**2
    rows: list[Row] = []
    prices: dict[str, Array] = dict.fromkeys(ESTIMATORS, np.ones(len(ratios)))
    prices["combined"] = price_of_columns(problems, parameters, predicted[:, best])
    left = REMAINDER * (TAILS if parameters.noise == "heavy tails" else 1.0)
    for k, name in enumerate(ESTIMATORS):
        rows += ratio_rows(
            name, ratios[:, k], simulated[:, k], error[:, k], prices[name]
        )
        scaled = squares[:, k] / unit[:, k], errors[:, k] / unit[:, k]
        rows += _scale_row(name, *scaled, parameters.trials, left)
    if not parameters.normalized:
        rows += length_rows(problems)
    artifact = dict(zip(ESTIMATORS, simulated.T, strict=True))
    name = artifact_of(parameters.model_dump())
    return Outcome(rows=tuple(rows), artifacts={name: artifact})


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the ratios of a cell."""
    used = "normalised" if named["normalized"] else "as they are"
    return f"attitude-efficiency-{named['noise']}-{used}.npz".replace(" ", "-")


def geometries(count: int, rng: np.random.Generator) -> Truths:
    """Random attitudes with reference vectors that are not too close."""
    found: list[Truth] = []
    while len(found) < count:
        q = random_quaternions(1, rng)[0]
        r1, r2 = normalize(rng.standard_normal((2, 3)))
        if np.linalg.norm(cross(r1, r2)) > MIN_SINE:
            found.append((q, r1, r2))
    q, r1, r2 = map(np.stack, zip(*found, strict=True))
    return q, r1, r2


def predicted_squares(problems: Truths, parameters: Parameters) -> Float[Array, "n 5"]:
    """Predicted mean squared angle of each estimator, for unit noise.

    TRIAD has no prediction here and is compared with the bound.
    """
    noise = noise_covariances(parameters.noise, true_vectors(*problems)[1])
    bound = np.linalg.trace(attitude_bound(*problems, noise).rotation)
    frames: tuple[Frame | None, ...] = ("combined", None, "optimal")
    moments = (
        attitude_moments(*problems, noise, 2, frame, normalized=parameters.normalized)
        for frame in frames
    )
    squares = [4.0 * np.linalg.trace(found.covariance) for found in moments]
    if parameters.noise == "unequal":
        squares[2] = squares_of_pairs(problems, WEIGHTS)
    return np.stack([*squares, bound, bound], axis=1)


def squares_of_pairs(problems: Truths, weights: Any = None) -> Float[Array, " n"]:
    """Mean squared angle of weighted least squares, for unequal noise."""
    found = [
        wahba_moments(q, [r1, r2], DEVIATIONS, weights).covariance
        for q, r1, r2 in zip(*problems, strict=True)
    ]
    return 4.0 * np.linalg.trace(found)


def price_of_columns(
    problems: Truths, parameters: Parameters, bound: Float[Array, " n"]
) -> Float[Array, " n"]:
    """RMS error of the combined estimator over the bound, eq. (AE1)."""
    n = cross(problems[1], problems[2])
    along = 0.25 * (1.0 / np.sum(n * n, axis=-1) - 1.0)
    if parameters.noise == "tangent" or parameters.normalized:
        along = np.zeros(len(n))
    if parameters.noise == "unequal":
        square = squares_of_pairs(problems) + along * np.sum(np.square(DEVIATIONS))
        return np.sqrt(square / bound)
    return np.sqrt(1.0 + 4.0 * along / bound)


def length_rows(problems: Truths) -> Iterator[Row]:
    """Median and worst turn that a too long body vector causes, without noise."""
    q, vectors, _ = true_vectors(*problems)
    squared = np.sum(cross(problems[1], problems[2]) ** 2, axis=-1)
    first = 0.5 * TOO_LONG * np.sqrt(1.0 / squared - 1.0)
    left = TOO_LONG**2 * 1.5 / 8.0 / squared
    for name, estimator in estimators(Parameters()).items():
        turns = []
        for k in range(2):
            longer = np.moveaxis(vectors, -2, 0).copy()
            longer[k] *= 1.0 + TOO_LONG
            turns.append(attitude_error(estimator(*longer), q))
        for what, pick in (("median", np.median), ("worst", np.max)):
            statistic = stat.LENGTH_TURN(name, what, unit="rad")
            value = max(pick(each) for each in turns)
            if name == "combined":
                at, off = pick(first), pick(first + left) - pick(first)
                off = max(off, at - pick(first - left))
                yield from exact(statistic, value, at, stat.FIRST_ORDER, off)
            elif name == "best of four":
                yield from unjudged(statistic, value)
            else:
                yield from exact(statistic, value, 0.0, stat.EXACT, ROUNDED)


def _simulated(
    problems: Truths, parameters: Parameters, streams: Streams
) -> tuple[Float[Array, "n 5"], Float[Array, "n 5"]]:
    # mean squared angle of each estimator, and its standard error
    trials, quiet = parameters.trials, true_vectors(*problems)[1]
    shape = len(quiet), len(ESTIMATORS)
    means, errors = np.empty(shape), np.empty(shape)
    together = max(1, AT_ONCE // trials)
    for start in range(0, len(quiet), together):
        some = range(start, min(start + together, len(quiet)))
        q, truth = problems[0][some, None], quiet[some, :, None]
        roots = noise_roots(parameters.noise, quiet[some])
        noise = np.stack([_noise(parameters, streams.block(i)) for i in some]) @ roots
        vectors = np.moveaxis(truth + parameters.noise_std * noise, 1, 0)
        for k, estimator in enumerate(estimators(parameters).values()):
            square = np.asarray(attitude_error(estimator(*vectors), q)) ** 2
            means[some, k] = square.mean(axis=1)
            errors[some, k] = square.std(axis=1, ddof=1) / np.sqrt(trials)
    return means, errors


def _noise(parameters: Parameters, rng: np.random.Generator) -> Float[Array, "4 t 3"]:
    # of variance 1 on each axis
    normal = rng.standard_normal((4, parameters.trials, 3))
    return normal * tails(parameters.noise, (4, parameters.trials, 1), rng)


def ratio_rows(
    name: str,
    predicted: Float[Array, " n"],
    simulated: Float[Array, " n"],
    error: Float[Array, " n"],
    price: Float[Array, " n"],
) -> list[Row]:
    """Median and worst RMS error over the q-method's, predicted and simulated."""
    rows: list[Row] = []
    for what, pick in (("median", np.median), ("worst", np.max)):
        ratio, at = stat.RMS_RATIO(name, what), pick(predicted)
        if name in ("combined", "optimal"):
            rows += exact(ratio, at, pick(price), stat.CLOSED_FORM, ROUNDED)
        elif name != "TRIAD":
            rows += unjudged(ratio, at, predictor=stat.FIRST_ORDER)
        value = pick(simulated)
        # that of the geometry which it is, or is next to
        near = error[np.argmin(np.abs(simulated - value))]
        rows += unjudged(
            stat.SIMULATED_RMS_RATIO(name, what), value, near, len(simulated)
        )
    return rows


def _scale_row(
    name: str,
    squares: Float[Array, " n"],
    errors: Float[Array, " n"],
    trials: int,
    left: float = REMAINDER,
) -> Rows:
    # from the spread of the trials in each geometry: the geometries are fewer, and
    # their spread has fewer degrees of freedom than `verdict.freedom` takes
    error = np.sqrt(np.sum(errors**2)) / len(errors)
    found = (
        stat.SQUARED_ERROR(name),
        np.mean(squares),
        error,
        len(squares) * trials,
    )
    if name in JUDGED:
        return plain(*found, 1.0, stat.FIRST_ORDER, left)
    return unjudged(*found, predictor=stat.FIRST_ORDER)


KINDS = {stat.RMS_RATIO: "theory", stat.SIMULATED_RMS_RATIO: "simulated"}
FIGURES = (
    Distribution(
        name="estimators",
        asked="What does a suboptimal estimator cost?",
        says="RMS error over the q-method's, in the median: {each}.",
        about=[stat.SIMULATED_RMS_RATIO(name, "median") for name in ESTIMATORS],
        named=entry(0),
        file=artifact_of,
        arrays=lambda parameters: {"": {name: name for name in ESTIMATORS}},
        axis="RMS error / the q-method's",
        value="share of geometries",
        caption=(
            "RMS error over that of the q-method on the same noise: the share of "
            "geometries with at most the value on the axis. The q-method reaches the "
            "Cramér-Rao bound to first order."
        ),
    ),
    Listing(
        name="estimators",
        caption="RMS error over the q-method's, by theory and simulated",
        rows=[stat.RMS_RATIO, stat.SIMULATED_RMS_RATIO],
        keys={"estimator": entry(0)},
        column=lambda row: f"{row.statistic.entries[1]}, {KINDS[row.statistic.family]}",
    ),
    Listing(
        name="estimators-lengths",
        caption="Turn by a body vector that is 2 % too long, without noise",
        rows=[stat.LENGTH_TURN],
        keys={"estimator": entry(0)},
        column=entry(1),
        predicted=True,
    ),
)
