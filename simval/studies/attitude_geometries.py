r"""Leading errors over many geometries: which formula is the most accurate.

The covariance of each formula that is accurate to second order is off by a term in
:math:`\sigma^4`: the linear one by :math:`C_4`, the source's fourth order by
:math:`C_4 - \mathrm{cov}\,Q_2(x_1, x_1)`, and eq. (63) as printed by
:math:`C_4 - m_2 m_2^T`, :math:`C_4` being the complete term of eq. (O2). Their
Frobenius norms, over that of the linear one, are found in many random geometries:
below 1 a formula is nearer to the truth than the linear one, at 0 it would be of
higher order. The geometries are numbered, so no chance is involved.

A judged row holds :math:`C_4` to an independent route: in the first geometries it is
extrapolated from the exact moments at two noise levels, without any expansion.
"""

from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from simval import statistics as stat
from simval.arrays import Array, Places, outer
from simval.figures import Distribution, Listing, entries, family_words, predictor
from simval.results import Outcome, limit, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.attitude import Noise, Truths, noise_shapes, random_geometry
from simval.studies.study import Cost, StudyParameters, described, ranged
from simval.theory.attitude import BLOCK, attitude_moments
from simval.theory.expansion import (
    complete_fourth_covariance,
    quadratic_covariance,
    scaled_error_moments,
    second_order_bias,
    second_order_covariance,
)
from simval.theory.two_vector import (
    MIN_NORM,
    Frame,
    TwoVectorGeometry,
    column_norms,
    two_vector_geometry,
)
from simval.units import PERCENT

TITLE = "Geometries: which attitude formula is nearer to the truth, and how often"
SECTION = "geometries"

COMPARED: Final = (stat.ORDER_4_SOURCE, stat.ORDER_2_PRINTED)
QUANTILES: Final = {"least": 0.0, "5%": 0.05, "median": 0.5, "95%": 0.95, "most": 1.0}

CHECKED: Final = 6
"""Geometries whose leading term is extrapolated from exact moments, too."""

RATIO: Final = 150.0
"""Least |qbar|/sigma there; the other noise level is half of it."""

MOST_OFF: Final = 1e-4
"""Relative: the extrapolation leaves out (sigma/|qbar|)^4 = 2e-9 times the term after
the next, of some thousands; 1e-12 of a covariance, which is (2 |qbar|/sigma)^2 = 1e5
times the term, is what quadrature may be off by."""


class Parameters(StudyParameters):
    """One cell: a shape of the noise and a rule for the frame."""

    noise: Noise = described(
        "isotropic",
        "Equal isotropic noise, noise tangent to each unit vector, or four "
        "random full covariances.",
    )
    frame: Literal["greatest", "plain"] = described(
        "greatest", "Column of the estimator."
    )
    geometries: int = ranged(500, "Random attitudes and pairs of vectors.", 20, 100_000)

    def cost(self) -> Cost:
        """Cost of a cell: 1.5 ms a geometry, and the exact moments of some."""
        return Cost(0.05 + 4e-4 * self.geometries, 13)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Find the ratios of one cell."""
    numbers, truths = regular_geometries(parameters.frame, parameters.geometries)
    frame: Frame | None = "plain" if parameters.frame == "plain" else None
    ratios, off = np.empty((len(numbers), 2)), np.zeros(0)
    for start in range(0, len(numbers), BLOCK):
        some = slice(start, start + BLOCK)
        q, r1, r2 = (each[some] for each in truths)
        noise = noise_shapes(parameters.noise, numbers[some], (q, r1, r2))
        noise = np.broadcast_to(noise, (len(q), 4, 3, 3))
        geometry = two_vector_geometry(q, r1, r2, frame)
        leading, errors = _leading(geometry, noise)
        ratios[some] = np.transpose([_length(e) / _length(leading) for e in errors])
        if start == 0:
            few = slice(CHECKED)
            checked = q[few], r1[few], r2[few]
            known = _extrapolated(checked, geometry[few], noise[few], frame)
            off = _length(leading[few] - known) / _length(leading[few])
    rows = list(
        limit(stat.LEADING_TERM_OFF(), off.max(), MOST_OFF, stat.EXACT, n=CHECKED)
    )
    for label, found in zip(COMPARED, ratios.T, strict=True):
        values = np.quantile(found, list(QUANTILES.values()))
        statistics = stat.LEADING_ERROR_RATIO.each(QUANTILES)
        rows += unjudged(statistics, values, predictor=label)
        rows += unjudged(stat.NEARER(), np.mean(found < 1.0), predictor=label)
    artifact = dict(zip(COMPARED, ratios.T, strict=True))
    name = artifact_of(parameters.model_dump())
    return Outcome(rows=tuple(rows), artifacts={name: artifact})


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the ratios of a cell."""
    noise, frame, count = (named[key] for key in ("noise", "frame", "geometries"))
    return f"attitude-geometries-{noise}-{frame}-{count}.npz"


def regular_geometries(frame: str, count: int) -> tuple[Places, Truths]:
    """The first numbered geometries that are not singular."""
    drawn = count
    while True:
        q, r1, r2 = map(np.stack, zip(*map(random_geometry, range(drawn)), strict=True))
        norms = np.abs(column_norms(q, r1, r2))
        lengths = norms[:, -1] if frame == "plain" else norms.max(axis=1)
        regular = np.flatnonzero(lengths >= MIN_NORM)[:count]
        if len(regular) == count:
            return regular, (q[regular], r1[regular], r2[regular])
        drawn += count


def _leading(
    geometry: TwoVectorGeometry, noise: Array
) -> tuple[Array, tuple[Array, Array]]:
    # leading error of the linear formula and of those compared, in the turned frame
    moments = scaled_error_moments(geometry, noise)
    q, P = moments.q, moments.P
    leading = complete_fourth_covariance(moments) - second_order_covariance(q, P)
    bias = second_order_bias(q, P)
    return leading, (leading - quadratic_covariance(q, P), leading - outer(bias, bias))


def _extrapolated(
    truths: Truths, geometry: TwoVectorGeometry, noise: Array, frame: Frame | None
) -> Array:
    # the term in sigma^4 from exact moments at two noise levels, free of sigma^6
    terms = []
    for size in (geometry.norm / RATIO, 0.5 * geometry.norm / RATIO):
        scale = size[:, None, None]
        exact, linear = (
            attitude_moments(*truths, scale[..., None] ** 2 * noise, order, frame)
            for order in ("exact", 2)
        )
        terms.append((exact.covariance - linear.covariance) / scale**4)
    back = geometry.back
    return back.mT @ (4.0 * terms[1] - terms[0]) @ back / 3.0


def _length(matrices: Float[Array, "n 4 4"]) -> Float[Array, " n"]:
    return np.linalg.norm(matrices, axis=(1, 2))


FIGURES = (
    Distribution(
        name="geometries",
        asked="Is a formula nearer to the truth than the second order?",
        says="Share of geometries in which a formula is nearer: {each}.",
        about=[stat.NEARER],
        named=predictor,
        unit=PERCENT,
        file=artifact_of,
        arrays=lambda parameters: {"": {name: name for name in COMPARED}},
        upright={stat.ORDER_4: 0.0, stat.ORDER_2: 1.0},
        axis="leading error / the second order's",
        value="share of geometries",
        caption=(
            "Share of geometries in which the leading error of a formula's covariance, "
            "the term in σ⁴ that it has wrong, is at most so many times that of the "
            "second order. To the left of 1 (dashed) a formula is nearer to the truth "
            "than the second order; the complete fourth order, which is of higher "
            "order, is at 0. The geometries are numbered, so no chance is involved."
        ),
    ),
    Listing(
        name="geometries",
        caption=(
            "Leading error of each formula's covariance over the second order's: "
            "quantiles over the geometries"
        ),
        rows=[stat.LEADING_ERROR_RATIO, stat.NEARER, stat.LEADING_TERM_OFF],
        keys={"formula": predictor},
        column=lambda row: entries(row) or family_words(row),
    ),
)
