r"""Convergence order: how each attitude formula's error falls with the noise.

At five noise levels, shares of :math:`|\bar q|`, the bias and covariance of each
expansion are compared with the truth: the exact oracle for isotropic noise, cubature of
degree 9 through the public estimator for noise that is not. The difference is
:math:`a \sigma^p (1 + b \sigma^2 + \dots)`, so the log of it is fitted by

.. math:: \log a + p \log\sigma + b \sigma^2, \tag{O1}

p the order of the first term that the formula leaves out: 4 for second order, 6 for the
complete fourth order. The source's fourth order leaves out terms of its own order, so
its slope is 4 too. No chance is involved.

What (O1) leaves out is of the size of :math:`\sigma^4`, and of the square of
:math:`b \sigma^2` where b is great because the first term nearly vanishes. Both at the
highest level are allowed, and the rounding of the differences as the fit carries it.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Figure, Listing, along_entry
from simval.imu.attitude import two_vector_quaternion
from simval.moments import Moments
from simval.results import Outcome, Row, beyond, exact, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.attitude import (
    PREDICTORS,
    Noise,
    Truth,
    noise_shapes,
    random_geometry,
)
from simval.studies.study import Cost, Geometry, StudyParameters, described
from simval.theory.attitude import Order, attitude_moments
from simval.theory.cubature import cubature_moments
from simval.theory.exact import isotropic
from simval.theory.two_vector import Frame, column_norms, true_vectors

TITLE = "Convergence order: how fast each attitude formula becomes exact"
SECTION = "orders"

LEVELS = np.geomspace(0.01, 0.04, 5)
"""Noise levels over |qbar|; the largest standard deviation of any vector in any
direction."""

MIN_NORM = 0.05
"""Of |qbar|, below which a geometry is drawn again: rounding is divided by it."""

ROUNDING = 4e-15
"""Of a difference, over |qbar|: the cubature's, 1.5e-15 in 200 geometries."""
FLOOR = 8.0 * ROUNDING
"""Differences below it are not fitted."""

NEXT, AFTER, MOST_BENT = 2.0, 1e-3, 0.3
"""Of the square of b sigma^2 in a slope, 1.2 times which was the most seen, and b is
here the ratio of the sizes of the two terms, which is no less (`_bent`); of the term
after it, the fourth power of the highest level, 3e-6, hundreds of times; and the b
sigma^2 where (O1) ends."""

Bent = dict[tuple[int | str, str], float]
"""Of an order and a moment."""

ORDERS: dict[Order, float] = {2: 4.0, "4-paper": 4.0, 4: 6.0}
"""The slope that each formula's error must have."""

COMBINED: Final = "combined"
LEAD = 0.2
"""Of |qbar|, by which a column must lead for it: no node of the cubature, up to 4.5
deviations away, may start from another."""

FAMILIES = {
    "bias": (stat.BIAS_ORDER, stat.BIAS_ERROR),
    "covariance": (stat.COVARIANCE_ORDER, stat.COVARIANCE_ERROR),
}
"""Slope and distance of each moment."""


class Parameters(StudyParameters):
    """One cell: a geometry and a shape of the noise."""

    geometry: Geometry = 3
    noise: Noise = described(
        "isotropic",
        "Equal isotropic noise, four different full covariances, or noise "
        "tangent to each unit vector.",
    )

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.08, 80)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the slopes of one cell."""
    truth = random_geometry(parameters.geometry, MIN_NORM)
    shape = noise_shapes(parameters.noise, parameters.geometry, truth, each=True)
    *_, second, norm = np.sort(np.abs(column_norms(*truth))).tolist()
    bent = _bent(truth, norm * LEVELS, shape)
    rows = [*unjudged(stat.NORM(), norm), *_slopes(truth, norm, shape, None, bent)]
    if norm - second >= LEAD * norm:
        rows += _slopes(truth, norm, shape, COMBINED, bent)
    return Outcome(rows=tuple(rows))


def _bent(
    truth: Truth, levels: Float[Array, " n"], shape: Float[Array, "4 3 3"]
) -> Bent:
    """Ratio of the next term left out to the first one, at the highest noise.

    From the truth alone, whose powers of the variance go through its levels: a wrong
    formula must not say of itself where theory ends. The source's first term is its
    distance from the complete order.
    """
    noises = levels[:, None, None, None] ** 2 * shape
    truths = [_truth(truth, noise, None) for noise in noises]
    powers = (levels[:, None] / levels[-1]) ** (2.0 * np.arange(1, len(levels) + 1))
    whole, source = (attitude_moments(*truth, noises[-1], o) for o in (4, "4-paper"))
    found: Bent = {}
    for part in FAMILIES:
        every = np.array([getattr(each, part).ravel() for each in truths])
        _, second, third, fourth, *_ = np.linalg.norm(
            np.linalg.solve(powers, every), axis=1
        )
        apart = np.linalg.norm(getattr(whole, part) - getattr(source, part))
        found |= {(2, part): third / second, (4, part): fourth / third}
        found[("4-paper", part)] = third / max(apart, np.finfo(float).tiny)
    return found


def _slopes(
    truth: Truth,
    norm: float,
    shape: Float[Array, "4 3 3"],
    frame: Frame | None,
    bent: Bent,
) -> Iterator[Row]:
    """Rows of slopes, for the longest column or for all combined."""
    levels = norm * LEVELS[2 if frame else 0 :]
    noises = levels[:, None, None, None] ** 2 * shape
    truths = [_truth(truth, noise, frame) for noise in noises]
    of = () if frame is None else (frame,)
    for order, slope in ORDERS.items():
        if frame and order == "4-paper":  # the source's is of one frame
            continue
        label = PREDICTORS[order]
        found = attitude_moments(*truth, noises, order, frame)
        for part, (order_of, error_of) in FAMILIES.items():
            off = getattr(found, part) - [getattr(each, part) for each in truths]
            gap = np.linalg.norm(off.reshape(len(levels), -1), axis=1)
            value, left, why = slope_of(levels, gap, norm, bent[order, part])
            yield from beyond(exact(order_of(*of), value, slope, label, left), why)
            statistics = [error_of(*of, f"{level:.4g}") for level in levels]
            yield from unjudged(statistics, gap, predictor=label)


def slope_of(
    levels: Float[Array, " n"], gap: Float[Array, " n"], norm: float, bent: float
) -> tuple[float, float, str]:
    """Slope by (O1), its possible error, and why it says nothing, if it does not."""
    fitted = gap > FLOOR / norm
    if fitted.sum() < 3:
        words = f"what it leaves out is below rounding, {FLOOR / norm:.1g}"
        return (
            0.0,
            0.0,
            f"{words}, at all but {fitted.sum()} of {len(gap)} noise levels",
        )
    x, y = levels[fitted], gap[fitted]
    squares = (x / x[-1]) ** 2
    fit = np.linalg.pinv(np.stack([np.ones(len(x)), np.log(x), squares], axis=1))
    value = fit[1] @ np.log(y)
    left = NEXT * bent**2 + AFTER + np.abs(fit[1]) @ (ROUNDING / norm / y)
    why = (
        f"the next term is {bent:.2g} of the first that is left out; a "
        f"slope can be measured up to {MOST_BENT:g}"
    )
    return value, left, why if not bent <= MOST_BENT else ""


def _truth(truth: Truth, noise: Float[Array, "4 3 3"], frame: Frame | None) -> Moments:
    """Exact moments under isotropic noise in a fixed frame, else by cubature."""
    if isotropic(noise) and frame is None:
        return attitude_moments(*truth, noise, "exact")
    second = attitude_moments(*truth, noise, 2, frame)
    estimate = partial(two_vector_quaternion, frame=second.frame)

    def estimator(*vectors: Any) -> Array:
        found = estimate(*vectors)
        if frame is None:
            return found
        # the sign of the scalar part is chance where that is small
        return found * np.copysign(1.0, found @ second.q_true)[:, None]

    vectors = true_vectors(*truth)[1]
    return cubature_moments(estimator, vectors, noise, second.q_true)


def _moment(row: Row) -> str:
    return "bias" if row.statistic.family == stat.BIAS_ORDER else "covariance"


def _formula(row: Row) -> str:
    combined = COMBINED in row.statistic.entries
    return f"{row.predictor}, all frames combined" if combined else row.predictor


_COVARIANCE = Figure(
    name="orders",
    asked="How fast does each formula become exact?",
    says="The error of each formula has the slope {each}.",
    about=[stat.COVARIANCE_ORDER, stat.BIAS_ORDER],
    rows=[stat.COVARIANCE_ERROR],
    along=along_entry,
    axis="noise of each unit vector, relative",
    lines=_formula,
    over=("geometry",),
    value="distance from the truth",
    compared=False,
    caption=(
        "Distance of each formula's covariance from the truth (the exact oracle, or "
        "cubature for noise that is not isotropic), a line for each geometry, computed "
        "without sampling. The second order has slope 4, the complete fourth order 6; "
        "the source's fourth order falls like the second, because it leaves out terms "
        "of its own order. Of all frames combined the truth is cubature."
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
        keys={"formula": _formula, "moment": _moment},
        column=lambda row: "slope",
        predicted=True,
    ),
)
