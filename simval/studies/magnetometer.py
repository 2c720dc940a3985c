r"""Magnetometer: its calibration beside the bound, and whether its error bars hold.

A set of random attitudes is drawn once for each number of poses, so that predictions
involve no chance. Each trial adds fresh noise to the pose means of both sensors and
calibrates twice: by the weighted fit of all 22 parameters, and by the usual recipe, an
ellipsoid for each sensor and then the turn between them. Errors are estimate minus
truth, beside the bound, the second-order bias, and the recipe's own covariance
(`simval.theory.magnetometer`).

A relative error e of a standard deviation moves a 95 % interval's coverage by 0.23 e,
and a bias of b standard deviations by 0.11 b^2; that of the ellipsoid of k parameters
moves by :math:`2 x f_k(x)\, e`, with f the density of chi-square at its 95 % quantile
x. The same trials are averaged once more with control variates
(`simval.studies.magnetometer_controls`). One noise-free set in each cell must recover
the truth to `RECOVERED`, and theory must meet how the estimate answers its readings
(`simval.studies.magnetometer_response`).
"""

from typing import Annotated

import numpy as np
import scipy
from pydantic import Field

from simval.arrays import Array
from simval.calibrate import ellipsoid_then_rotation
from simval.figures import Figure, Headline, Quote
from simval.results import Outcome, Row, limit, nees, plain, unjudged
from simval.shapes import Float
from simval.statistics import (
    BIAS,
    CHI_SQUARE,
    CHI_SQUARE_OF_FREEDOM,
    COVERAGE,
    CRAMER_RAO,
    FIRST_ORDER,
    NEES,
    NORMAL,
    RECOVERY,
    SD,
    SECOND_ORDER,
    SPREAD,
    TRUTH,
    VARIANCE_OVER_BOUND,
    Statistic,
)
from simval.streams import Streams
from simval.studies.drawn import correlation_row
from simval.studies.expanded import noise_row
from simval.studies.magnetometer_controls import LEVEL, control_rows
from simval.studies.magnetometer_response import (
    fitted,
    predicted_moments,
    response_rows,
    stated_row,
)
from simval.studies.magnetometer_scenario import Scenario, scenario
from simval.studies.refusing import refusing
from simval.studies.study import Cost, StudyParameters
from simval.theory.magnetometer import MagnetometerMoments
from simval.units import PERCENT

TITLE = "Magnetometer: all 22 parameters at the bound, and the usual recipe"
SECTION = "magnetometer"

BLOCK = 128  # trials; part of the promise of equal bits
RECOVERED = 1e-9
"""Relative; of 1000 random sensors the worst was off by 3e-15."""
INTERVAL_SLOPE = 0.23  # 2 z f(z) of the normal density at its 97.5 % quantile
BIAS_SLOPE = 0.115  # z f(z), of a squared bias
PARTS = {
    "accelerometer": slice(0, 9),
    "M": slice(9, 18),
    "b": slice(18, 21),
    "dip": slice(21, 22),
}
OWN = ("M", "b", "dip")
UNITS = ("1",) * 6 + ("m/s²",) * 3 + ("1",) * 12 + ("rad",)


class Parameters(StudyParameters):
    """One cell: poses, place and noise."""

    poses: Annotated[int, Field(ge=12, le=400)] = Field(
        default=40, description="Random attitudes in which both sensors rest."
    )
    dip_deg: Annotated[float, Field(ge=-85.0, le=85.0)] = Field(
        default=66.0, description="Angle of the field below the horizon, degrees."
    )
    field_noise: Annotated[float, Field(ge=1e-5, le=0.02)] = Field(
        default=0.005,
        description="Noise per axis of a magnetometer's mean, a share of the field.",
    )
    accelerometer_noise: Annotated[float, Field(ge=1e-5, le=0.02)] = Field(
        default=1e-4,
        description="Noise per axis of an accelerometer's mean, a share of gravity.",
    )
    trials: Annotated[int, Field(ge=8 * BLOCK)] = Field(
        default=4096, description="Trials; rounded up to whole blocks of 128."
    )

    def cost(self) -> Cost:
        """Cost of a cell: both calibrations for each trial."""
        return Cost(0.8 + self.trials * (2e-4 + 2.5e-5 * self.poses), 102)


@refusing("lower the noise or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell and set it beside theory."""
    case = scenario(
        parameters.poses,
        parameters.dip_deg,
        parameters.accelerometer_noise,
        parameters.field_noise,
    )
    predicted = predicted_moments(case, parameters.dip_deg)
    blocks = -(-parameters.trials // BLOCK)
    trials = [_trials(case, streams.block(i)) for i in range(blocks)]
    seen = {k: np.concatenate([block[k] for block in trials]) for k in trials[0]}
    rows = (
        *_parameter_rows(seen["error"], predicted),
        *_bound_rows(seen, predicted),
        *_coverage_rows(seen, predicted),
    )

    def errors(x: Float[Array, "t d"]) -> Float[Array, "t p"]:
        readings = case.readings(x)
        usual = ellipsoid_then_rotation(*readings) - case.truth[9:]
        fit = fitted(case, *readings)
        return np.concatenate([fit.parameters - case.truth, usual], axis=1)

    bound = np.diagonal(predicted.covariance)
    return Outcome(
        rows=(
            *_recovery(case),
            *noise_row(seen["noise"]),
            *rows,
            *control_rows(rows, seen, errors, case.equations(), PARTS, bound),
            *correlation_row(_vectors(seen["noise"])),
            *stated_row(case, predicted),
            *response_rows(
                parameters.poses,
                parameters.dip_deg,
                parameters.accelerometer_noise,
                parameters.field_noise,
            ),
            *_spread_row(seen["error"], predicted),
        )
    )


def _vectors(noise: Float[Array, "t d"]) -> Float[Array, "k m"]:
    """Noise of each sensor in each block."""
    t, d = noise.shape
    both = noise.reshape(t // BLOCK, BLOCK, 2, d // 2).transpose(0, 2, 1, 3)
    return both.reshape(2 * (t // BLOCK), -1)


def _trials(case: Scenario, rng: np.random.Generator) -> dict[str, Array]:
    noise = rng.standard_normal((2, BLOCK, case.accelerometer.size))
    noise = noise.transpose(1, 0, 2).reshape(BLOCK, -1)
    body, iron = case.readings(noise)
    fit = fitted(case, body, iron).require_converged()
    error, sd = fit.parameters - case.truth, fit.sd
    scaled = fit.covariance / (sd[:, :, None] * sd[:, None, :])
    ratio = error / sd
    low, high = np.moveaxis(fit.confidence_intervals(LEVEL), -1, 0)
    square = np.vecdot(ratio, np.linalg.solve(scaled, ratio[..., None])[..., 0])
    return {
        "noise": noise,
        "error": error,
        "recipe": ellipsoid_then_rotation(body, iron) - case.truth[9:],
        "inside": ((low <= case.truth) & (case.truth <= high)).astype(float),
        "square": square,
        "chi_square": fit.chi_square / fit.dof,
    }


def _recovery(case: Scenario) -> tuple[Row, ...]:
    fit = fitted(case, case.accelerometer, case.magnetometer)
    error = np.abs(fit.parameters - case.truth)
    sizes = [np.abs(case.truth[PARTS[name]]).max() for name in (*PARTS,)[:-1]]
    relative = [
        float(error[part].max() / size)
        for part, size in zip(PARTS.values(), (*sizes, 1.0), strict=True)  # dip: rad
    ]
    return limit(RECOVERY.each(PARTS), relative, RECOVERED, TRUTH, n=1)


def _parameter_rows(
    error: Float[Array, "t 22"], predicted: MagnetometerMoments
) -> list[Row]:
    n, mean = len(error), error.mean(axis=0)
    off = error - mean
    variance = np.sum(off * off, axis=0) / (n - 1)
    sd, spread = np.sqrt(variance), np.std(off * off, axis=0) / np.sqrt(n)
    return [
        *plain(
            BIAS.each(predicted.names, UNITS), mean, sd / np.sqrt(n), n,
            predicted.bias, SECOND_ORDER, predicted.bias_remainder,
        ),
        *plain(
            SD.each(predicted.names, UNITS), sd, spread / (2.0 * sd), n,
            predicted.sd, FIRST_ORDER,
            predicted.sd * (predicted.variance_remainder / 2.0),
        ),
    ]  # fmt: skip


def _spread_row(
    error: Float[Array, "t 22"], predicted: MagnetometerMoments
) -> tuple[Row, ...]:
    """Standard deviation of M, RMS over its entries, which are judged one by one."""
    part, n = PARTS["M"], len(error)
    squares = np.mean((error - error.mean(axis=0))[:, part] ** 2, axis=1)
    sd = float(np.sqrt(n / (n - 1) * squares.mean()))
    expected = float(np.sqrt(np.mean(predicted.sd[part] ** 2)))
    return unjudged(
        SPREAD("M"), sd, np.std(squares) / np.sqrt(n) / (2.0 * sd), n, expected,
        FIRST_ORDER, expected * predicted.variance_remainder / 2.0,
    )  # fmt: skip


def _bound_rows(seen: dict[str, Array], predicted: MagnetometerMoments) -> list[Row]:
    """Mean square errors over the bound, of the fit and of the usual recipe."""
    bound = np.diagonal(predicted.covariance)
    recipe = np.diagonal(predicted.recipe) / bound
    squares = seen["error"] ** 2 / bound
    usual = seen["recipe"] ** 2 / bound[9:]
    square_bias = predicted.bias**2 / bound
    rows: list[Row] = []
    for name, part in PARTS.items():
        remainder = predicted.variance_remainder
        rows += _mean_row(
            VARIANCE_OVER_BOUND(name), squares[:, part].mean(axis=1),
            1.0 + square_bias[part].mean(), CRAMER_RAO, remainder,
        )  # fmt: skip
    for name in OWN:
        part = PARTS[name]
        own = slice(part.start - 9, part.stop - 9)
        # the recipe's bias is of second order as well, and not predicted: its variance
        values = usual[:, own] - np.mean(seen["recipe"], axis=0)[own] ** 2 / bound[part]
        expected = float(recipe[part].mean())
        rows += _mean_row(
            VARIANCE_OVER_BOUND(name, "usual recipe"), values.mean(axis=1),
            expected, FIRST_ORDER, expected * predicted.variance_remainder,
        )  # fmt: skip
    return rows


def _coverage_rows(seen: dict[str, Array], predicted: MagnetometerMoments) -> list[Row]:
    n, names = len(seen["square"]), predicted.names
    quantile = float(2.0 * scipy.special.gammaincinv(len(names) / 2.0, LEVEL))
    inside = np.mean(seen["square"] <= quantile)
    error = float(np.sqrt(LEVEL * (1.0 - LEVEL) / n))
    relative = predicted.variance_remainder / 2.0
    shift = float(
        predicted.bias @ np.linalg.solve(predicted.covariance, predicted.bias)
    )
    slope = _ellipsoid_slope(quantile, len(names))
    moved = BIAS_SLOPE * (predicted.bias / predicted.sd) ** 2
    return [
        *plain(
            COVERAGE.each(names), seen["inside"].mean(axis=0), error, n,
            LEVEL, NORMAL, INTERVAL_SLOPE * relative + moved,
        ),
        *plain(
            COVERAGE("ellipsoid"), inside, error, n, LEVEL, CHI_SQUARE,
            slope * (relative + shift / (2.0 * len(names))),
        ),
        *nees(
            NEES(), seen["square"].mean(), np.std(seen["square"]) / np.sqrt(n), n,
            len(names) + shift, CHI_SQUARE, len(names) * 2.0 * relative,
        ),
        *_mean_row(
            CHI_SQUARE_OF_FREEDOM(), seen["chi_square"], 1.0, CHI_SQUARE, 2.0 * relative
        ),
    ]  # fmt: skip


def _ellipsoid_slope(x: float, freedom: int) -> float:
    # 2 x f(x) of chi-square
    half = freedom / 2.0
    log = half * np.log(x / 2.0) - x / 2.0 - scipy.special.gammaln(half)
    return float(2.0 * np.exp(log))


def _mean_row(
    statistic: Statistic,
    values: Float[Array, " t"],
    prediction: float,
    predictor: str,
    remainder: float,
) -> tuple[Row, ...]:
    n = len(values)
    return plain(
        statistic, values.mean(), np.std(values, ddof=1) / np.sqrt(n), n,
        prediction, predictor, remainder,
    )  # fmt: skip


WORDS = {"M": "matrix M", "b": "hard iron b"}


def _called(row: Row) -> str:
    what, *recipe = row.statistic.entries
    return ", ".join((WORDS.get(what, what), *recipe))


FIGURES = (
    Figure(
        name="magnetometer",
        asked="Does the weighted fit reach the bound, and what does the recipe cost?",
        what="The variance",
        says="The variance is at most {most} times the bound ({most_of}).",
        rows=[VARIANCE_OVER_BOUND],
        lines=_called,
        value="variance over the bound",
        columns=2,
        caption=(
            "Variance over the Cramér-Rao bound, mean over the entries of a matrix or "
            "vector: the weighted fit of all 22 parameters, which reaches 1, and the "
            "usual recipe, an ellipsoid for each sensor and then the turn between them."
        ),
    ),
)
HEADLINE = Headline(
    says="M {M}, dip {dip}; {over} × the bound",
    quotes={
        "M": Quote(of=SPREAD("M"), by=FIRST_ORDER, unit=PERCENT),
        "dip": Quote(of=SD("dip"), by=FIRST_ORDER, angle=True),
        "over": Quote(of=VARIANCE_OVER_BOUND("M"), by=CRAMER_RAO, root=True),
    },
)
