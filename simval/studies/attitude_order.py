r"""Convergence order: how each attitude formula's error falls with the noise.

At five noise levels the bias and covariance of each expansion are compared with the
truth: the exact oracle for isotropic noise, cubature of degree 9 through the public
estimator for noise that is not. The slope of the log of the difference against the log
of the noise is the order of the first term that the formula leaves out: 4 for second
order, 6 for the complete fourth order. The source's fourth order leaves out terms of
its own order, so its slope is 4 too. No chance is involved.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from pydantic import Field

from simval import statistics as stat
from simval.arrays import Array
from simval.errors import GeometryError
from simval.figures import Figure, Listing, along_entry, predictor
from simval.imu.attitude import two_vector_quaternion
from simval.moments import Moments
from simval.results import Outcome, Row, exact, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.attitude import PREDICTORS, Noise, noise_shapes, random_geometry
from simval.studies.study import Cost, Geometry, StudyParameters, refusing
from simval.theory.attitude import attitude_moments
from simval.theory.cubature import cubature_moments
from simval.theory.two_vector import true_vectors

TITLE = "Convergence order: how fast each attitude formula becomes exact"
SECTION = "orders"

LEVELS = tuple(np.geomspace(0.005, 0.02, 5).tolist())
"""Noise levels; the largest standard deviation of any vector in any direction."""

MIN_NORM = 0.15
"""Below this the next term bends the slope by more than 0.1 at the highest level."""

TOLERANCE = 0.1
"""Of a slope: twice the next term's relative size at the highest level."""

FLOOR = 3e-14
"""Differences below 30 times the cubature's rounding, 1e-15, are not fitted."""

ORDERS: dict[int | str, float] = {2: 4.0, "4-paper": 4.0, 4: 6.0}
"""The slope that each formula's error must have."""

FAMILIES = {
    "bias": (stat.BIAS_ORDER, stat.BIAS_ERROR),
    "covariance": (stat.COVARIANCE_ORDER, stat.COVARIANCE_ERROR),
}
"""Slope and distance of each moment."""


class Parameters(StudyParameters):
    """One cell: a geometry and a shape of the noise."""

    geometry: Geometry = 3
    noise: Noise = Field(
        default="isotropic",
        description="Equal isotropic noise, four different full covariances, or noise "
        "tangent to each unit vector.",
    )

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.1, 40)


@refusing("give another `geometry`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the slopes of one cell.

    Raises
    ------
    GeometryError
        If the greatest column of the geometry is shorter than `MIN_NORM`.
    """
    q, r1, r2 = random_geometry(parameters.geometry)
    norm = attitude_moments(q, r1, r2, LEVELS[0]).norm
    if not norm >= MIN_NORM:
        msg = (
            f"geometry {parameters.geometry} has |qbar| {norm:.3f}, needed {MIN_NORM} "
            "or more for a slope; choose another number"
        )
        raise GeometryError(msg)
    shape = noise_shapes(parameters.noise, parameters.geometry, (q, r1, r2), each=True)
    found: dict[int | str, list[Moments]] = {order: [] for order in (*ORDERS, "truth")}
    for noise in (level**2 * shape for level in LEVELS):
        for order in ORDERS:
            found[order].append(attitude_moments(q, r1, r2, noise, order))
        if parameters.noise == "isotropic":
            truth: Moments = attitude_moments(q, r1, r2, noise, "exact")
        else:
            second = attitude_moments(q, r1, r2, noise)
            estimator = partial(two_vector_quaternion, frame=str(second.frame))
            vectors = true_vectors(q, r1, r2)[1]
            truth = cubature_moments(estimator, vectors, noise, second.q_true)
        found["truth"].append(truth)
    rows = list(unjudged(stat.NORM(), norm))
    for order, slope in ORDERS.items():
        for part, families in FAMILIES.items():
            pairs = zip(found[order], found["truth"], strict=True)
            off = [getattr(a, part) - getattr(b, part) for a, b in pairs]
            gap = np.array([np.linalg.norm(each) for each in off])
            rows += _rows(*families, PREDICTORS[order], gap, slope)
    return Outcome(rows=tuple(rows))


def _rows(
    slope: stat.Family,
    distance: stat.Family,
    label: str,
    gap: Float[Array, " n"],
    order: float,
) -> tuple[Row, ...]:
    fitted, value = gap > FLOOR, float("nan")  # which is judged inconclusive
    if fitted.sum() >= 2:
        value = float(np.polyfit(np.log(LEVELS)[fitted], np.log(gap[fitted]), 1)[0])
    statistics = distance.each(f"{level:.4g}" for level in LEVELS)
    return (
        *exact(slope(), value, order, label, TOLERANCE),
        *unjudged(statistics, gap, predictor=label),
    )


def _moment(row: Row) -> str:
    return "bias" if row.statistic.family == stat.BIAS_ORDER else "covariance"


_COVARIANCE = Figure(
    name="orders",
    asked="How fast does each formula become exact?",
    says="The error of each formula has the slope {each}.",
    about=[stat.COVARIANCE_ORDER, stat.BIAS_ORDER],
    rows=[stat.COVARIANCE_ERROR],
    along=along_entry,
    axis="noise of each unit vector, relative",
    lines=predictor,
    over=("geometry",),
    value="distance from the truth",
    compared=False,
    caption=(
        "Distance of each formula's covariance from the truth (the exact oracle, or "
        "cubature for noise that is not isotropic), a line for each geometry, computed "
        "without sampling. The second order has slope 4, the complete fourth order 6; "
        "the source's fourth order falls like the second, because it leaves out terms "
        "of its own order."
    ),
)
FIGURES = (
    _COVARIANCE,
    replace(
        _COVARIANCE,
        name="orders-bias",
        fold="The same of the bias",
        says="",
        rows=[stat.BIAS_ERROR],
        caption="Distance of each formula's bias from the truth.",
    ),
    Listing(
        name="orders",
        caption="Slopes of every formula, noise and moment, and the stated order",
        rows=[stat.BIAS_ORDER, stat.COVARIANCE_ORDER],
        keys={"formula": predictor, "moment": _moment},
        column=lambda row: "slope",
        predicted=True,
    ),
)
