r"""Calibration recovery: tumble, distort, average the holds, calibrate, compare.

The scene is simulated once. Each trial distorts every sample of every hold with the
true misalignment, scale, bias and fresh noise, averages the holds and calibrates. The
error is estimate minus truth, in the nine parameters of the model. Beside its bias
and standard deviation stand the second-order bias and the first-order covariance of
theory; beside both, the Cramer-Rao bound. The same trials are also averaged with their
first and second order as control variates (`simval.studies.expanded`): these rows see a
bias of second order, far below the spread of a trial.

Both predictions are allowed the remainder that theory states for them
(`simval.theory.calibration`). With ``noise_std = 0`` the cell is one noise-free
trial that must recover the truth to `RECOVERED`, or to what the scene's rests allow.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from simval.arrays import Array, frozen
from simval.calibrate import calibrate
from simval.figures import Figure, Headline, Listing, Quote, entries, of_calibration
from simval.montecarlo import Sums, along, mean_square, moments_of, simulate
from simval.results import Outcome, Row, limit, nees, plain, unjudged
from simval.scene import simulate_cached
from simval.sensor import AccelerometerModel
from simval.shapes import Float
from simval.statistics import (
    BIAS,
    BIAS_ALONG,
    CRAMER_RAO,
    EFFICIENCY,
    FIRST_ORDER,
    NEES,
    NOISE_OF_MEAN,
    RECOVERY,
    RMS,
    RMS_OVER_BOUND,
    SD,
    SECOND_ORDER,
    SPREAD,
    TRUTH,
)
from simval.streams import Streams
from simval.studies.calibration_response import response_rows
from simval.studies.drawn import Drawn, drawn_rows
from simval.studies.expanded import Expanded, beside, noise_row
from simval.studies.refusing import LEAST_NOISE, refusing
from simval.studies.study import Cost, StudyParameters
from simval.theory.calibration import (
    CalibrationMoments,
    calibration_expansion,
    calibration_moments,
)
from simval.units import OF_A_CALIBRATION

TITLE = "Calibration recovery: tumble, distort, average the holds, calibrate"
SECTION = "calibration"

BLOCK = 64  # trials; part of the promise of equal bits
RECOVERED = 1e-9
"""Relative; of 500 random sensors the worst was off by 2e-15 (docs/calibration.md)."""
ROUNDED = 64 * np.finfo(float).eps
"""Of g and 1, times the condition of the poses: thirty times what the worst of those
500 was off by. Control variates see that."""
G = 9.80665  # m/s^2, natural size of a bias
UNITS = ("1",) * 6 + ("m/s²",) * 3
GROUPS = (("T", slice(0, 3), "1"), ("K", slice(3, 6), "1"), ("B", slice(6, 9), "m/s²"))


class Parameters(StudyParameters):
    """One cell: a scene, a pose count, a noise level and a method."""

    scene: Literal["gimbal", "die"] = Field(
        default="gimbal", description="Scene that is simulated."
    )
    poses: Annotated[int, Field(ge=9, le=400)] = Field(
        default=40, description="Poses of the gimbal, or throws of the die."
    )
    hold_time: Annotated[float, Field(ge=0.002, le=10.0)] = Field(
        default=0.2, description="Length of each hold that is averaged, s."
    )
    noise_std: Annotated[float, Field(ge=0.0, le=10.0)] = Field(
        default=0.01, description="Noise per axis and sample, m/s^2; 0 is noise-free."
    )
    trials: Annotated[int, Field(ge=2 * BLOCK)] = Field(
        default=2048, description="Trials; rounded up to whole blocks of 64."
    )

    @field_validator("noise_std")
    @classmethod
    def _none_or_some(cls, value: float) -> float:
        if 0.0 < value < LEAST_NOISE:
            msg = (
                f"noise_std is {value:g}, which is lost in rounding; it must be 0, or "
                f"{LEAST_NOISE:g} or more"
            )
            raise ValueError(msg)
        return value

    def cost(self) -> Cost:
        """Cost of a cell: the tumble once, then every sample of every trial."""
        readings = self.poses * self.hold_time * 500.0  # at 500 Hz
        trials = self.trials if self.noise_std > 0.0 else 0
        seconds = 0.006 * self.poses + trials * (5e-5 + 1e-7 * readings)
        return Cost(seconds, 44 if trials else 3)


def true_sensor(noise_std: float) -> AccelerometerModel:
    """Sensor whose parameters are to be recovered."""
    values = np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
    return AccelerometerModel.from_parameters(values, noise_std=noise_std)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rests:
    """What a scene's sensor feels while it is at rest."""

    # specific force of every sample of every rest, sensor coordinates, m/s^2
    forces: Float[Array, "rests samples 3"]
    g: float  # length of gravity, m/s^2
    # how far from g the scene lets the length of a rest's force be, m/s^2
    rest_force: float


@lru_cache(maxsize=32)
def simulated_rests(scene: str, poses: int, hold_time: float) -> Rests:
    """Simulate a scene and keep the samples of its rests."""
    trajectory = simulate_cached(scene, poses=poses, hold_time=hold_time)
    rows = [
        trajectory.specific_force[trajectory.hold == k]
        for k in trajectory.hold_indices()
    ]
    shortest = min(len(r) for r in rows)
    return Rests(
        forces=frozen([r[:shortest] for r in rows]),
        g=trajectory.g,
        rest_force=trajectory.rest_force,
    )


@refusing("lower `noise_std` or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Simulate one cell and set it beside theory."""
    sensor = true_sensor(parameters.noise_std)
    rests = simulated_rests(parameters.scene, parameters.poses, parameters.hold_time)
    forces, g = rests.forces, rests.g
    if parameters.noise_std == 0.0:
        return Outcome(rows=_recovery(sensor, rests))
    means = forces.mean(axis=1)
    noise = parameters.noise_std / np.sqrt(forces.shape[1])
    predicted = calibration_moments(sensor, means / g, g=g, noise_std=noise)
    quiet = np.random.default_rng(0)  # draws nothing
    clean, felt = (true_sensor(0.0).distort(f, quiet) for f in (means, forces))
    drawn: list[Array] = []  # noise of the pose means
    found: list[Array] = []
    samples: list[dict[str, Drawn]] = []

    def errors(rng: np.random.Generator, count: int) -> Float[Array, "9 count"]:
        shape = (count, *forces.shape)
        readings = sensor.distort(np.broadcast_to(forces, shape), rng)
        raw = readings.mean(axis=2)
        each = (readings - felt) / parameters.noise_std
        samples.append({"samples": Drawn.of(each)})
        fit = calibrate(raw, g=g, covariance=False)
        if not np.isfinite(fit.parameters).all():
            fit.require_converged()
        drawn.append(raw - clean)
        found.append(fit.parameters - sensor.parameters)
        return found[-1].T

    sums = simulate(errors, streams, samples=parameters.trials, block=BLOCK, batch=1)
    still = calibrate(clean, g=g)
    x = np.concatenate(drawn)
    expansion = calibration_expansion(sensor, means, g)
    known = Expanded(
        first=expansion.first(x),
        second=expansion.second(x),
        covariance=noise**2 * expansion.slope @ expansion.slope.T,
        mean_second=noise**2 * expansion.mean_second,
    )
    rows = (*_parameter_rows(sums, predicted), *_nees_row(sums, predicted))
    error = np.concatenate(found) - (still.parameters - sensor.parameters)
    return Outcome(
        rows=(
            *unjudged(NOISE_OF_MEAN(), noise),
            *noise_row(x.reshape(len(x), -1) / noise),
            *rows,
            *_control_rows(rows, error, known, predicted, float(still.condition)),
            *_group_rows(sums, predicted),
            *drawn_rows(samples),
            *response_rows(sensor, means, g),
            *_pooled_rows(sums, predicted),
        )
    )


def _recovery(sensor: AccelerometerModel, rests: Rests) -> tuple[Row, ...]:
    """Relative error of T, K and B from one noise-free tumble.

    A rest that is not quite at rest passes its relative error on to the parameters,
    at most enlarged by the condition of the poses.
    """
    raw = sensor.distort(rests.forces, np.random.default_rng(0)).mean(axis=1)
    fit = calibrate(raw, g=rests.g)  # there was no noise to draw
    error = fit.parameters - sensor.parameters
    most = RECOVERED + float(fit.condition) * rests.rest_force / rests.g
    relative = [
        np.abs(error[part]).max() / np.abs(sensor.parameters[part]).max()
        for _, part, _ in GROUPS
    ]
    names = [name for name, _, _ in GROUPS]
    return limit(RECOVERY.each(names), relative, most, TRUTH, n=1)


def _parameter_rows(sums: Sums, predicted: CalibrationMoments) -> list[Row]:
    measured, n = moments_of(sums), sums.samples
    names, units = predicted.names, UNITS
    sd, expected = measured.sd, predicted.sd
    variance_error = np.diagonal(measured.covariance_error)
    share = (np.sqrt(np.diagonal(predicted.cramer_rao)) / sd) ** 2
    return [
        *plain(
            BIAS.each(names, units), measured.bias, measured.bias_error, n,
            predicted.bias, SECOND_ORDER, predicted.bias_remainder,
        ),
        *plain(
            SD.each(names, units), sd, variance_error / (2 * sd), n,
            expected, FIRST_ORDER, predicted.sd_remainder,
        ),
        *unjudged(
            EFFICIENCY.each(names), share, share * variance_error / sd**2, n,
            (np.sqrt(np.diagonal(predicted.cramer_rao)) / expected) ** 2, FIRST_ORDER,
        ),
    ]  # fmt: skip


def _control_rows(
    rows: tuple[Row, ...],
    error: Float[Array, "t 9"],
    known: Expanded,
    predicted: CalibrationMoments,
    condition: float,
) -> tuple[Row, ...]:
    """The judged ones of these rows, of what noise adds, with control variates."""
    weight = np.linalg.inv(predicted.covariance)
    rounding = ROUNDED * condition * np.array([1.0] * 6 + [G] * 3)
    relative = 18.0 * np.max(rounding / predicted.sd)  # of nine squares
    return beside(
        [row for row in rows if row.check != "record"],
        (known.mean(error), known.sd(error), known.weighted_square(error, weight)),
        np.concatenate([rounding, rounding, [relative]]),
    )


def _group_rows(sums: Sums, predicted: CalibrationMoments) -> list[Row]:
    """RMS error of T, K and B over their three entries, and the bound on it."""
    rows: list[Row] = []
    second_moment = predicted.covariance + np.outer(predicted.bias, predicted.bias)
    theories = ((FIRST_ORDER, second_moment), (CRAMER_RAO, predicted.cramer_rao))
    for name, part, unit in GROUPS:
        weight = np.zeros((9, 9))
        weight[part, part] = np.eye(3) / 3.0
        square, error = mean_square(sums, weight)
        rms, n = float(np.sqrt(square)), sums.samples
        for predictor, matrix in theories:
            expected = float(np.sqrt(np.trace(weight @ matrix)))
            rows += unjudged(
                RMS(name, unit=unit), rms, error / (2 * rms), n, expected, predictor
            )
    return rows


def _pooled_rows(sums: Sums, predicted: CalibrationMoments) -> list[Row]:
    """Errors of all nine parameters together, and bias and spread of T, K and B.

    They repeat what judged rows say entry by entry, so they are not judged again.
    """
    rows: list[Row] = []
    n = sums.samples
    second_moment = predicted.covariance + np.outer(predicted.bias, predicted.bias)
    bound = np.diagonal(predicted.cramer_rao)
    all_nine = np.array([1.0] * 6 + [G**-2] * 3) / 9.0
    over = np.concatenate([np.full(3, 1 / (3 * bound[p].sum())) for _, p, _ in GROUPS])
    for statistic, weight, by in (
        (RMS("all"), all_nine, FIRST_ORDER),
        (RMS("all"), all_nine, CRAMER_RAO),
        (RMS_OVER_BOUND(), over, FIRST_ORDER),
    ):
        matrix = second_moment if by == FIRST_ORDER else predicted.cramer_rao
        expected = float(np.sqrt(weight @ np.diagonal(matrix)))
        square, error = mean_square(sums, np.diag(weight))
        rms = float(np.sqrt(square))
        rows += unjudged(statistic, rms, error / (2 * rms), n, expected, by)
    for name, part, unit in GROUPS:
        each = np.zeros(9)
        each[part] = 1.0 / 3.0
        expected = float(np.sqrt(each @ predicted.sd**2))
        left = expected * predicted.variance_remainder / 2.0
        square, error = along(sums, np.diag(each))
        sd = float(np.sqrt(square))
        rows += unjudged(
            SPREAD(name, unit=unit), sd, error / (2 * sd), n, expected, FIRST_ORDER,
            left,
        )  # fmt: skip
        size = float(np.sqrt(each @ predicted.bias**2))
        if not size > 0.0:  # nothing to project on
            continue
        weight = each * predicted.bias / size
        rows += unjudged(
            BIAS_ALONG(name, unit=unit), *along(sums, weight), n, size, SECOND_ORDER,
            float(np.abs(weight) @ predicted.bias_remainder),
        )  # fmt: skip
    return rows


def _nees_row(sums: Sums, predicted: CalibrationMoments) -> tuple[Row, ...]:
    weight = np.linalg.inv(predicted.covariance)
    value, error = mean_square(sums, weight)
    expected = 9.0 + float(predicted.bias @ weight @ predicted.bias)
    left = expected * predicted.variance_remainder
    return nees(NEES(), value, error, sums.samples, expected, FIRST_ORDER, left)


def _noisy(parameters: Mapping[str, Any]) -> bool:
    return bool(parameters["noise_std"] > 0.0)


def _part(row: Row) -> str:
    return PARTS[row.statistic.entries[0]]


ABOUT = (
    "A simulated body is tumbled through poses; each sample is distorted with the "
    "true T, K, B and noise; the means of the holds are calibrated from their lengths "
    "alone. Error: estimate minus truth."
)
PARTS = {"T": "misalignment T", "K": "scale K", "B": "bias B", "all": "T, K and B / g"}
_RMS = Figure(
    name="calibration",
    asked="Is the error what theory says, and at the Cramér-Rao bound?",
    what="The RMS error",
    rows=RMS.each("TKB"),
    by=FIRST_ORDER,
    bound=CRAMER_RAO,
    along="noise_std",
    panels=_part,
    unit=of_calibration,
    slope=1.0,
    where=_noisy,
    caption=(
        "RMS error of T, K and B. Theory: first-order covariance and second-order bias."
    ),
)
FIGURES = (
    _RMS,
    replace(
        _RMS,
        name="calibration-bias",
        asked="Is there a bias, and is it what theory says?",
        what="The bias",
        rows=[BIAS_ALONG],
        claimed=[BIAS],
        scale=(SD, FIRST_ORDER, "the scatter"),
        by=SECOND_ORDER,
        bound="",
        slope=2.0,
        caption=(
            "Bias alone (estimate minus truth), projected on the direction that theory "
            "predicts. Hollow triangles: upper limits, where these trials cannot tell "
            "the bias from zero; where no ratio is below, none can be seen."
        ),
    ),
    replace(
        _RMS,
        name="calibration-sd",
        asked="Is the spread what theory says?",
        what="The standard deviation alone",
        rows=[SPREAD],
        claimed=[SD],
        bound="",
        fold="{claim}",
        caption="Standard deviation alone, RMS over the three entries.",
    ),
    replace(
        _RMS,
        name="calibration-together",
        asked="",
        what="",
        rows=[RMS("all")],
        fold="RMS error of all nine parameters together",
        columns=2,
        caption="RMS error of all nine parameters, B in units of g.",
    ),
    replace(
        _RMS,
        name="summary-calibration",
        section="summary",
        asked="",
        panels=lambda row: "calibration",
        lines=lambda row: f"{_part(row)}, {of_calibration(row).name}",
        value="RMS error",
        single=True,
        ratio=False,
        slope=None,
        caption="Calibration error against noise.",
    ),
    replace(
        _RMS,
        name="poses",
        section="poses",
        asked="How many poses are needed?",
        what="",
        says="{many} poses instead of {few}: {gains} times more accurate by theory.",
        along="poses",
        several=True,
        slope=-0.5,
        caption=(
            "RMS error against the number of poses, for each noise level. Expected "
            "slope: -1/2 once the directions are spread evenly."
        ),
    ),
    Listing(
        name="calibration-recovery",
        caption="Without noise: relative error of what was recovered, and its limit",
        rows=[RECOVERY],
        keys={"of": entries},
        predicted=True,
        where=lambda parameters: not _noisy(parameters),
    ),
)
HEADLINE = Headline(
    says="T {T}, K {K}, B {B}; {over} × the bound",
    quotes={
        "over": Quote(of=RMS_OVER_BOUND(), by=FIRST_ORDER),
        **{
            name: Quote(of=RMS(name), by=CRAMER_RAO, unit=OF_A_CALIBRATION[name])
            for name in "TKB"
        },
    },
)
