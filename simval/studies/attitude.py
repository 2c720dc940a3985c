r"""Attitude moments: noise, estimate in a fixed frame, bias and covariance.

Each trial adds noise to both body and both reference vectors and estimates the
quaternion in the one frame that is greatest at the true geometry. The error is truth
minus estimate, with the formula's own sign. Its empirical bias and covariance are set
against four predictions: second order, the source's fourth order, the complete fourth
order and the exact answer.

A truncated formula is allowed the remainder that theory states for it
(`simval.theory.orders`). Where :math:`|\bar q|/\sigma` is below `RANGE` the
expansions are reported and not judged; nor is the source's fourth order anywhere,
because it leaves out terms of its own order.

Beside the plain samples, one in `CONTROLLED` is drawn again in antithetic pairs with
the Taylor polynomial as a control variate; its moments have a standard error of the
next order, so they see errors of a prediction that plain samples cannot.

Truth and estimate have length 1, so mean and covariance of the error owe each other
:math:`\mathrm{tr}\,C + m^T m = 2 q^T m` (`simval.theory.expansion`): samples and the
exact answer are held to it to rounding, and what each truncated formula misses it by is
reported.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Figure, Headline, Listing, Quote, entry, predictor
from simval.geometry import attitude_matrix, normalize
from simval.imu.attitude.kernel import normalize_columns, raw_quaternion
from simval.moments import Moments
from simval.montecarlo import (
    Sums,
    along,
    mean_square,
    moments_of,
    simulate,
    simulate_reduced,
)
from simval.results import Outcome, Row, beyond, control, limit, nees, plain, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.response import stated
from simval.studies.study import LEAST_NOISE, Cost, Geometry, StudyParameters, ranged
from simval.studies.trials import root
from simval.theory.attitude import (
    AttitudeMoments,
    Order,
    attitude_moments,
)
from simval.theory.expansion import (
    predicted_defect,
    unit_length_defect,
    unit_length_rounding,
)
from simval.theory.orders import RANGE, expansion_remainders
from simval.theory.two_vector import (
    column_norms,
    noise_covariances,
    tangent_covariances,
    true_vectors,
)
from simval.units import DEGREE_OF_QUATERNION

TITLE = "Attitude moments: bias and covariance of the two-vector quaternion"
SECTION = "attitude"

BLOCK = 8192  # trials; part of the promise of equal bits, as is `BATCH`
BATCH = 256  # of them
MIN_BATCHES = 256
"""Fewer leave the standard error itself too uncertain for the far tail: with 64 the
gate's false-alarm rate was measured as 1.9e-3 where 1e-3 was stated."""
CONTROLLED = 16
"""Chosen for its cost: the standard error of the pairs is of the next order anyway."""
CONTROL_STREAM = 1
COMPONENTS = ("x", "y", "z", "s")
PREDICTORS: dict[Order, str] = {
    2: stat.ORDER_2,
    "4-paper": stat.ORDER_4_SOURCE,
    4: stat.ORDER_4,
    "exact": stat.EXACT,
}
FORMULAS = {order: label for order, label in PREDICTORS.items() if order != "exact"}
_UPPER = np.triu_indices(4)
ENTRIES = (
    *stat.BIAS.each(COMPONENTS),
    *(
        stat.COVARIANCE(COMPONENTS[i], COMPONENTS[j])
        for i, j in zip(*_UPPER, strict=True)
    ),
)

Truth = tuple[Float[Array, "4"], Float[Array, "3"], Float[Array, "3"]]
"""Quaternion and reference vectors."""
Truths = tuple[Float[Array, "n 4"], Float[Array, "n 3"], Float[Array, "n 3"]]
"""Those of some geometries."""
Noise = Literal["isotropic", "tangent", "full"]


class Parameters(StudyParameters):
    """One cell: a geometry and a noise level."""

    geometry: Geometry = 3
    noise_std: float = ranged(
        0.01, "Noise per axis of each unit vector.", LEAST_NOISE, 0.5
    )
    samples: int = ranged(
        1_000_000, "Trials; rounded up to whole blocks of 8192.", MIN_BATCHES * BATCH
    )

    def cost(self) -> Cost:
        """Cost of a cell: a twentieth of a second for a million samples."""
        return Cost(0.05 + 1.8e-7 * self.samples, 105)


def random_geometry(number: int, least: float = 0.0) -> Truth:
    """True quaternion and reference vectors of a numbered geometry.

    Drawn again until the greatest column is no shorter than `least`.
    """
    rng = np.random.default_rng(number)
    while True:
        q, r1, r2 = (normalize(rng.standard_normal(k)) for k in (4, 3, 3))
        if np.abs(column_norms(q, r1, r2)).max() >= least:
            return q, r1, r2


def noise_shapes(
    kind: Noise, numbers: Any, truth: Truth | Truths, each: bool = False
) -> Float[Array, "... 4 3 3"]:
    """Covariances of the four vectors of numbered geometries.

    The greatest eigenvalue is 1: of all of them, or of each.
    """
    if kind == "isotropic":
        return noise_covariances(1.0)
    if kind == "tangent":
        return tangent_covariances(true_vectors(*truth)[1], 1.0)
    streams = (np.random.default_rng([int(k), 1]) for k in np.ravel(numbers))
    factor = np.stack([rng.standard_normal((4, 3, 3)) for rng in streams])
    full = factor @ factor.mT
    size = np.linalg.eigvalsh(full)[..., -1:, None]
    full /= size if each else size.max(axis=1, keepdims=True)
    return full.reshape(*np.shape(numbers), 4, 3, 3)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell and compare it with every prediction."""
    q, r1, r2 = random_geometry(parameters.geometry)
    sigma = parameters.noise_std
    predictions = {
        label: attitude_moments(q, r1, r2, sigma, order=order)
        for order, label in PREDICTORS.items()
    }
    exact = predictions[stat.EXACT]
    A = attitude_matrix(q)
    truth = np.stack([A @ r1, A @ r2, r1, r2]).reshape(12, 1)

    def errors(vectors: Float[Array, "12 n"]) -> Float[Array, "4 n"]:
        error = normalize_columns(raw_quaternion(vectors, str(exact.frame)))
        return np.subtract(exact.q_true[:, None], error, out=error)

    def drawn(rng: np.random.Generator, count: int) -> Float[Array, "4 n"]:
        vectors = rng.standard_normal((12, count))
        vectors *= sigma
        vectors += truth
        return errors(vectors)

    sums = simulate(
        drawn, streams, samples=parameters.samples, block=BLOCK, batch=BATCH
    )
    measured = moments_of(sums)
    controlled = moments_of(
        simulate_reduced(
            lambda x: errors(sigma * x + truth),
            Streams(streams.seed, (*streams.key, CONTROL_STREAM)),
            dimension=12,
            samples=max(parameters.samples // CONTROLLED, MIN_BATCHES * BATCH),
            block=BLOCK,
        )
    )
    # rank 3: the quaternion has unit length, and the fourth direction is rounding
    weight = np.linalg.pinv(predictions[stat.ORDER_2].covariance, rcond=1e-8)
    expected = np.sum(weight * exact.second_moment)
    return Outcome(
        rows=(
            *unjudged(stat.NORM_OVER_NOISE(), exact.norm / sigma),
            *_moment_rows(
                measured, controlled, predictions, float(exact.norm) / sigma
            ),
            *_rms_rows(sums, predictions),
            *nees(
                stat.NEES(), *mean_square(sums, weight), sums.samples,
                expected, stat.EXACT,
            ),
            *_unit_rows(sums, predictions),
            *_size_rows(sums, sigma, predictions),
        )
    )  # fmt: skip


def _entries(moments: Moments) -> tuple[Float[Array, "14"], Float[Array, "14"]]:
    """Bias and covariance of some moments as one row, and their standard errors."""
    values = moments.bias, moments.covariance[_UPPER]
    errors = moments.bias_error, moments.covariance_error[_UPPER]
    return np.concatenate(values), np.concatenate(errors)


def _moment_rows(
    measured: Moments,
    controlled: Moments,
    predictions: dict[str, AttitudeMoments],
    ratio: float,
) -> Iterator[Row]:
    left = expansion_remainders({o: predictions[k] for o, k in PREDICTORS.items()})
    why = f"|qbar| is {ratio:.3g} times the noise; expansions hold from {RANGE:g}"
    for order, label in PREDICTORS.items():
        remainder = np.repeat([left[order].bias, left[order].covariance], (4, 10))
        expected = _entries(predictions[label])[0]
        given = ENTRIES, *_entries(measured), measured.samples, expected, label
        if label == stat.ORDER_4_SOURCE:
            yield from unjudged(*given, remainder)
            continue
        # plain samples show a formula's covariance, but hardly its bias
        most = len(ENTRIES) if label == stat.EXACT else len(COMPONENTS)
        value, error = stated(
            _entries(controlled), expected, remainder, controlled.samples
        )
        rows = (
            *plain(*given, remainder),
            *control(
                [statistic.control for statistic in ENTRIES[:most]],
                value[:most], error[:most], controlled.samples,
                expected[:most], label, remainder[:most],
            ),
        )  # fmt: skip
        inside = label == stat.EXACT or ratio >= RANGE
        yield from beyond(rows, "" if inside else why)


def _rms_rows(sums: Sums, predictions: dict[str, AttitudeMoments]) -> Iterator[Row]:
    """RMS length of the error, which the page draws over the noise."""
    found = root(*mean_square(sums, np.eye(4)))
    for label, predicted in predictions.items():
        expected = np.sqrt(np.trace(predicted.second_moment))
        yield from unjudged(stat.RMS(), *found, sums.samples, expected, label)


def _unit_rows(sums: Sums, predictions: dict[str, AttitudeMoments]) -> Iterator[Row]:
    """Defect of the unit length, of the samples and of the predictions."""
    q, square = predictions[stat.EXACT].q_true, mean_square(sums, np.eye(4))[0]
    off = abs(unit_length_defect(square, float(q @ moments_of(sums).bias)))
    most = unit_length_rounding(square)
    yield from limit(
        stat.UNIT_LENGTH("simulated"), off, most, stat.ROUNDING, sums.samples
    )
    for label, predicted in predictions.items():
        off = abs(predicted_defect(predicted, q))
        if label == stat.EXACT:
            most = unit_length_rounding(float(np.trace(predicted.second_moment)))
            yield from limit(stat.UNIT_LENGTH(label), off, most, stat.ROUNDING)
        else:
            yield from unjudged(stat.UNIT_LENGTH(label), off)


def _size_rows(
    sums: Sums, sigma: float, predictions: dict[str, AttitudeMoments]
) -> Iterator[Row]:
    """Size of bias and covariance, and of what each formula leaves out of them.

    The size is the projection on the exact moment, whose entries are judged one by one.
    """
    exact, n = predictions[stat.EXACT], sums.samples
    square, spread = mean_square(sums, np.eye(4))
    rms, expected = np.sqrt(square) / sigma, np.sqrt(np.trace(exact.second_moment))
    error = spread / (2 * rms * sigma**2)
    yield from unjudged(stat.NORM(), exact.norm)
    yield from unjudged(
        stat.RMS_OVER_NOISE(), rms, error, n, expected / sigma, stat.EXACT
    )
    for part, family in (
        ("bias", stat.BIAS_ALONG),
        ("covariance", stat.COVARIANCE_ALONG),
    ):
        moment = getattr(exact, part)
        size = np.linalg.norm(moment)
        if not size > 0.0:  # nothing to project on
            continue
        found = along(sums, moment / size)
        for label, predicted in predictions.items():
            own = getattr(predicted, part)
            projected = np.sum(moment / size * own)
            yield from unjudged(family(), *found, n, projected, label)
            if label != stat.EXACT:
                off = np.linalg.norm(own - moment) / size
                yield from unjudged(stat.LEFT_OUT(part), off, predictor=label)


ABOUT = (
    "Two unit vectors and their references are disturbed by noise, the quaternion is "
    "estimated in one fixed frame, and the error (truth minus estimate) is compared "
    "with what theory says it must be."
)


def _along(row: Row) -> str:
    return "covariance" if row.statistic.family == stat.COVARIANCE_ALONG else "bias"


NOISE = "noise of each unit vector, relative"
LEFT = Figure(
    name="attitude-left-out",
    rows=[stat.LEFT_OUT],
    along="noise_std",
    axis=NOISE,
    panels=lambda row: f"{row.statistic.entries[0]}: what is left out",
    lines=predictor,
    value="distance from exact, relative",
    compared=False,
    resolved={
        "bias: what is left out": stat.BIAS_ALONG,
        "covariance: what is left out": stat.COVARIANCE_ALONG,
    },
    slope={stat.ORDER_2: 2.0, stat.ORDER_4_SOURCE: 2.0, stat.ORDER_4: 4.0},
    caption="",
)
FIGURES = (
    Figure(
        name="attitude",
        asked="Are bias and covariance what theory says?",
        what="The covariance; The bias",
        claimed=(stat.COVARIANCE, stat.BIAS),
        rows=(stat.COVARIANCE_ALONG, stat.BIAS_ALONG),
        by=stat.EXACT,
        theory="the exact theory",
        theories=tuple(PREDICTORS.values()),
        along="noise_std",
        axis=NOISE,
        panels=_along,
        value="norm of the moment",
        slope=2.0,
        each=True,
        beside=[LEFT],
        columns=2,
        caption=(
            "Covariance and bias of the simulated error, along the direction that the "
            "exact theory predicts, and over it; then how far each truncated formula "
            "is from the exact answer, relative and computed without sampling: the "
            "second order has slope 2, the complete fourth order slope 4. What lies "
            "below the dotted standard error cannot be told from the exact answer with "
            "these samples."
        ),
    ),
    Figure(
        name="summary-attitude",
        section="summary",
        what="The RMS error",
        rows=[stat.RMS],
        by=stat.EXACT,
        theory="the exact theory",
        theories=tuple(PREDICTORS.values()),
        along="noise_std",
        axis=NOISE,
        panels=lambda row: "attitude",
        unit=DEGREE_OF_QUATERNION,
        value="RMS error",
        single=True,
        caption="Attitude error against noise.",
    ),
    Figure(
        name="closeness",
        section="closeness",
        asked="What does a geometry near a singular one cost?",
        what="The RMS error",
        claimed=[stat.RMS],
        rows=[stat.RMS_OVER_NOISE],
        by=stat.EXACT,
        theory="the exact theory",
        along="norm",
        axis="|q̄|",
        over=("geometry", "noise_std"),
        panels=lambda row: "what closeness costs",
        value="RMS error / σ",
        beside=[
            replace(
                LEFT,
                rows=[stat.LEFT_OUT("covariance")],
                along="norm_over_noise",
                axis="|q̄| / σ",
                over=("geometry", "noise_std"),
                panels=lambda row: "where a formula may be used",
                resolved={},
                slope=None,
                level=0.01,
            )
        ],
        caption=(
            "All geometries and noise levels in one figure, over the length of the "
            "un-normalised quaternion: singular is to the left. RMS error over the "
            "noise, and over theory; then how far each formula's covariance is from "
            "the exact one, with a line at 1 %."
        ),
    ),
    Listing(
        name="unit-length",
        caption=(
            "Unit length: tr C + |m|² = 2 q'm for bias m and covariance C. Relative "
            "defect: rounding for samples and the exact answer, the remainder for a "
            "truncated formula"
        ),
        rows=[stat.UNIT_LENGTH],
        keys={},
        column=entry(0),
    ),
)
# an angle is twice the length of the quaternion's error, to its square over 48
HEADLINE = Headline(
    says="{angle} RMS; {over} × theory",
    quotes={
        "angle": Quote(of=stat.RMS(), by=stat.EXACT, angle=True, times=2.0),
        "over": Quote(of=stat.RMS(), by=stat.EXACT, over=True),
    },
)
