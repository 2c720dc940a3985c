r"""Near singularity: the noise at which each attitude formula breaks down.

The quantity that decides is :math:`|\bar q|/\sigma`. For a geometry with a given
:math:`|\bar q|` in the plain frame, the noise is raised until the bias and covariance
of each formula are off by 1 % and by 10 % of the exact ones. The simulation counts how
often the raw sign of the estimate flips (predicted exactly) and how often free
selection of the greatest column would have taken another frame than the true geometry.
"""

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Figure, Listing, entry, predictor
from simval.imu.attitude.kernel import column_matrix, raw_quaternion
from simval.results import Outcome, Row, Rows, plain, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.attitude import FORMULAS, Truth
from simval.studies.attitude_map import limits_of
from simval.studies.study import Cost, StudyParameters, ranged
from simval.theory.sign_flips import flip_probability
from simval.theory.two_vector import (
    noise_covariances,
    true_vectors,
    two_vector_geometry,
)

TITLE = "Limits: the noise at which each attitude formula breaks down"
SECTION = "closeness"

BLOCK = 4096  # samples; part of the promise of equal bits
RATIOS = np.geomspace(200.0, 1.5, 50)
"""|qbar|/sigma, from where every formula holds to where none does."""

MIN_EVENTS = 100
"""Expected flips below which their number is reported, not judged."""


class Parameters(StudyParameters):
    """One cell: a length of qbar, and the noise at which flips are counted."""

    norm: float = ranged(
        0.3, "Length of the noise-free qbar in the plain frame.", 0.05, 0.8
    )
    ratio: float = ranged(2.0, "|qbar|/sigma at which flips are counted.", 1.5, 20.0)
    samples: int = ranged(400_000, "Trials; rounded up to whole blocks of 4096.", BLOCK)

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.05 + 3e-7 * self.samples, 20)


def geometry_of_norm(norm: float) -> Truth:
    """An attitude whose plain column has a given length, r1 and r2 at right angles."""
    # e.n = norm with |e| = 0.8: the part of e in the plane of r1 and r2 is the rest
    r1, r2 = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    across = np.sqrt(max(0.0, 0.64 - norm**2))
    return np.array([0.8 * across, 0.6 * across, norm, 0.6]), r1, r2


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Find the limits and count the flips of one cell."""
    geometry = geometry_of_norm(parameters.norm)
    rows: list[Row] = []
    for (order, *entries), (ratio, _) in limits_of(geometry, RATIOS, "plain").items():
        if RATIOS[-1] < ratio < RATIOS[0]:
            label = FORMULAS[order]
            rows += unjudged(stat.LIMIT_RATIO(*entries), ratio, predictor=label)
    sigma = parameters.norm / parameters.ratio
    rows += _flip_rows(geometry, sigma, parameters.samples, streams)
    return Outcome(rows=tuple(rows))


def _flip_rows(truth: Truth, sigma: float, samples: int, streams: Streams) -> Rows:
    geometry = two_vector_geometry(*truth, "plain")
    chance = flip_probability(geometry, noise_covariances(sigma))
    quiet = true_vectors(*truth)[1].reshape(12, 1)
    best = int(np.argmax(_norms(quiet)[:, 0]))
    blocks = -(-samples // BLOCK)
    flips = changes = 0
    for i in range(blocks):
        vectors = quiet + sigma * streams.block(i).standard_normal((12, BLOCK))
        flips += int(np.sum(geometry.q_true @ raw_quaternion(vectors, "plain") < 0.0))
        changes += int(np.sum(np.argmax(_norms(vectors), axis=0) != best))
    n = blocks * BLOCK
    write = plain if n * chance >= MIN_EVENTS else unjudged
    error = np.sqrt(chance * (1.0 - chance) / n)
    other_error = np.sqrt(changes * (1.0 - changes / n)) / n
    return (
        *write(stat.FLIP_RATE(), flips / n, error, n, chance, stat.EXACT),
        *unjudged(stat.OTHER_SELECTION_RATE(), changes / n, other_error, n),
    )


def _norms(vectors: Float[Array, "12 n"]) -> Float[Array, "4 n"]:
    return np.linalg.norm(column_matrix(vectors, symmetric=False), axis=1)


AT_ONE_PERCENT = [stat.LIMIT_RATIO(part, "1%") for part in ("covariance", "bias")]
FIGURES = (
    Figure(
        name="limits",
        asked="From where on does a formula hold?",
        says="The covariance is within 1 % where |q̄| / σ is at least {most_each}.",
        about=AT_ONE_PERCENT[:1],
        rows=AT_ONE_PERCENT,
        along="norm",
        panels=lambda row: f"{row.statistic.entries[0]}: least |q̄| / σ",
        lines=predictor,
        value="|q̄| / σ",
        compared=False,
        log_x=False,
        columns=2,
        caption=(
            "How far from singular a geometry must be, in units of the noise, for each "
            "formula to be within 1 % of the exact answer."
        ),
    ),
    Listing(
        name="limits-shares",
        caption="Least |q̄| / σ at which each formula is within 1 % and 10 %",
        rows=[stat.LIMIT_RATIO],
        keys={"formula": predictor, "moment": entry(0)},
        column=entry(1),
    ),
    Listing(
        name="limits",
        caption="How often the raw sign flips, and how often free selection differs",
        rows=[stat.FLIP_RATE, stat.OTHER_SELECTION_RATE],
        keys={},
        predicted=True,
    ),
)
