r"""Map of limits: where each attitude formula holds, over many geometries.

In each numbered random geometry the isotropic noise is raised until the covariance and
the bias of each formula are off by 1 % and by 10 % of the exact ones. Quantiles of
:math:`|\bar q|/\sigma` there say what that ratio is worth as a rule. What else decides
is the geometry itself, through the ratio of one order to the one before,
:math:`\rho = |C_4 - C_2|/|C_2|` (`simval.theory.attitude`), in closed form; its
quantiles at the same noise are there too.

The share of geometries in which a formula's covariance is nearer to the exact one than
the second order's, at each ratio down to half a deviation, says whether a higher order
helps near a singularity. Its standard error is that of a share of random geometries;
the complete fourth order must be nearer in all, far enough from the singular set.
"""

from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from simval.arrays import Array, Mask
from simval.figures import Distribution, Figure, Listing, along_entry, entry, predictor
from simval.results import Outcome, Row, exact, unjudged
from simval.shapes import Bool, Float
from simval.statistics import LIMIT_RATIO, NEARER_AT, NEXT_ORDER, ORDER_4
from simval.streams import Streams
from simval.studies.attitude import FORMULAS, PREDICTORS, Truth
from simval.studies.attitude_geometries import QUANTILES, regular_geometries
from simval.studies.study import Cost, StudyParameters, described, ranged
from simval.studies.trials import share_error
from simval.theory.attitude import AttitudeMoments, attitude_moments
from simval.theory.two_vector import Frame

TITLE = "Map of the limits: where each attitude formula holds, over many geometries"
SECTION = "ranges"

SHARES: Final = {"1%": 0.01, "10%": 0.1}
"""What counts as off: the percent that a user would see, and the end of any use."""
RATIOS: Final = np.geomspace(30.0, 1.2, 26)
"""|qbar|/sigma. Between two of them the log of an error is linear in that of the ratio
but for its curvature, which moves a limit by less than 1 %."""

NEAR: Final = np.array([6.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.0, 0.5])
"""|qbar|/sigma at which it is counted which formula is nearer."""
ALWAYS: Final = 4.0
"""|qbar|/sigma from which the complete fourth order always is: 2 was enough in the
first 1500 geometries of each frame."""

PARTS: Final = ("bias", "covariance")
HIGHER: Final = {order: label for order, label in FORMULAS.items() if order != 2}
Limit = tuple[Any, str, str]
"""A formula, a moment, and the share by which it is off."""


class Parameters(StudyParameters):
    """One cell: a rule for the frame."""

    frame: Literal["greatest", "plain"] = described(
        "greatest", "Column of the estimator."
    )
    geometries: int = ranged(150, "Random attitudes and pairs of vectors.", 5, 10_000)

    def cost(self) -> Cost:
        """Cost of a cell: 26 exact answers a geometry."""
        return Cost(0.026 * self.geometries, 120)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Find the quantiles of one cell."""
    _, truths = regular_geometries(parameters.frame, parameters.geometries)
    frame: Frame | None = "plain" if parameters.frame == "plain" else None
    drawn = [*zip(*truths, strict=True)]
    limits = [limits_of(truth, RATIOS, frame) for truth in drawn]
    rows: list[Row] = []
    artifact = {"searched": RATIOS[[0, -1]]}
    for order, part, share in limits[0]:
        at = np.array([limit[order, part, share] for limit in limits])
        label = FORMULAS[order]
        artifact[f"{label}, {part}, {share}"] = at[:, 0]
        # over the geometries of the ratio, and of rho where it is reached
        values = np.quantile(at, list(QUANTILES.values()), axis=0)
        for name, (ratio, rho) in zip(QUANTILES, values, strict=True):
            entries = part, share, name
            rows += unjudged(LIMIT_RATIO(*entries), ratio, predictor=label)
            rows += unjudged(NEXT_ORDER(*entries), rho, predictor=label)
    found = [nearer(truth, frame) for truth in drawn]
    entries_of = [f"{ratio:g}" for ratio in NEAR]
    for label, shares in zip(HIGHER.values(), np.mean(found, axis=0), strict=True):
        for name, ratio, share in zip(entries_of, NEAR, shares, strict=True):
            if label == ORDER_4 and ratio >= ALWAYS:
                rows += exact(NEARER_AT(name), share, 1.0, label, 0.0, len(found))
                continue
            error = share_error(share, len(found))
            rows += unjudged(NEARER_AT(name), share, error, len(found), predictor=label)
    file = artifact_of(parameters.model_dump())
    return Outcome(rows=tuple(rows), artifacts={file: artifact})


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the limits of a cell."""
    return f"attitude-map-{named['frame']}-{named['geometries']}.npz"


def limits_of(
    truth: Truth, ratios: Float[Array, " n"], frame: Frame | None
) -> dict[Limit, tuple[float, float]]:
    """Where each formula is off by each share: |qbar|/sigma and rho there.

    The first ratio at which it is, from above, or an end of the ratios.
    """
    found = _moments_at(truth, ratios, frame)
    rho = _relative(found[4], found[2], found[2], "covariance")
    limits = {}
    for order in FORMULAS:
        for part in PARTS:
            off = _relative(found[order], found["exact"], found["exact"], part)
            for share, size in SHARES.items():
                ratio = _crossing(ratios, off, size)
                at = np.exp(np.interp(-np.log(ratio), -np.log(ratios), np.log(rho)))
                limits[order, part, share] = (ratio, float(at))
    return limits


def nearer(truth: Truth, frame: Frame | None) -> Bool[Mask, "2 n"]:
    """True at each of `NEAR` where a formula beats the second order."""
    found = _moments_at(truth, NEAR, frame)
    exact = found["exact"]
    off = {o: _relative(found[o], exact, exact, "covariance") for o in FORMULAS}
    return np.stack([off[order] < off[2] for order in HIGHER])


def _moments_at(
    truth: Truth, ratios: Float[Array, " n"], frame: Frame | None
) -> dict[Any, AttitudeMoments]:
    """Moments by each formula, with a sample for each |qbar|/sigma."""
    noise = (attitude_moments(*truth, 1e-3, 2, frame).norm / ratios)[:, None]
    return {o: attitude_moments(*truth, noise, o, frame) for o in PREDICTORS}


def _relative(
    a: AttitudeMoments, b: AttitudeMoments, size: AttitudeMoments, part: str
) -> Float[Array, " n"]:
    def length(values: Array) -> Array:
        return np.linalg.norm(values.reshape(len(values), -1), axis=1)

    gap = length(getattr(a, part) - getattr(b, part))
    return gap / length(getattr(size, part))


def _crossing(ratios: Array, off: Array, limit: float) -> float:
    # between two ratios the log of the error is linear in the log of the ratio
    reached = np.flatnonzero(off >= limit)
    if reached.size == 0:
        return ratios[-1]
    i = int(reached[0])
    if i == 0:
        return ratios[0]
    step = np.log(limit / off[i - 1]) / np.log(off[i] / off[i - 1])
    return ratios[i - 1] * (ratios[i] / ratios[i - 1]) ** step


FIGURES = (
    Distribution(
        name="ranges",
        asked="How far from singular must a geometry be?",
        says="Half of the geometries are within 1 % from |q̄| / σ of {each}.",
        about=[LIMIT_RATIO("covariance", "1%", "median")],
        named=predictor,
        file=artifact_of,
        arrays=lambda parameters: {
            f"{part} within {share}": {
                formula: f"{formula}, {part}, {share}" for formula in FORMULAS.values()
            }
            for part in PARTS[::-1] for share in SHARES
        },
        axis="|q̄| / σ",
        value="share of geometries",
        references=(0.1, 0.9),
        each=True,
        columns=2,
        caption=(
            "Share of random geometries in which each formula is within 1 % and 10 % "
            "of the exact answer, over the length of the un-normalised quaternion in "
            "units of the noise; singular is to the left. Between the two dashed lines "
            "are 80 % of the geometries. The source's fourth order has the bias of "
            "the second order, so these two are one line. No chance is involved."
        ),
    ),
    Figure(
        name="nearer",
        asked="Does a higher order help near a singularity?",
        says="At |q̄| / σ of 0.5 a formula is nearer in a share of {each}.",
        about=[NEARER_AT("0.5")],
        rows=[NEARER_AT],
        along=along_entry,
        axis="|q̄| / σ",
        lines=predictor,
        value="share of geometries",
        compared=False,
        log_y=False,
        caption=(
            "Share of the geometries in which a formula's covariance is nearer to the "
            "exact one than the second order's. Nearness helps neither: both shares "
            "fall towards the singular set, to none at half a deviation."
        ),
    ),
    *(
        Listing(
            name=name,
            caption=f"{caption}: quantiles over the geometries",
            rows=[family],
            keys={"formula": predictor, "moment": entry(0), "within": entry(1)},
            column=entry(2),
        )
        for name, family, caption in (
            ("ranges", LIMIT_RATIO,
             "Least |q̄| / σ at which each formula is within the limit"),
            ("ranges-next-order", NEXT_ORDER,
             "Ratio of the next order to the second where a formula reaches the limit"),
        )
    ),
)  # fmt: skip
