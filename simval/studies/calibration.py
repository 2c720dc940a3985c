r"""Calibration recovery: tumble, distort, average the holds, calibrate, compare.

The scene is simulated once. Each trial distorts every sample of every hold with the
true misalignment, scale, bias and fresh noise, averages the holds and calibrates. The
error is estimate minus truth, in the nine parameters of the model. Beside its bias
and standard deviation stand the second-order bias and the first-order covariance of
theory, and both with the Cramer-Rao bound. The same trials are also averaged with their
first and second order as control variates (`simval.studies.response`): these rows see a
bias of second order, far below the spread of a trial.

Both predictions are allowed the remainder that theory states for them
(`simval.theory.calibration`). With ``noise_std = 0`` the cell is one noise-free
trial that must recover the truth to `RECOVERED`, or to what the scene's rests allow.

Formulas and error bars are also compared with the estimate's response to its readings
(`simval.studies.response`), at some of the cell's poses: theory's (E2) of
`simval.theory.estimating` must meet (R2), and the covariance that the calibration
states must meet theory's. A combination of parameters that the poses see k times worse
bends k times sooner: what the differences leave grows as :math:`k^4`, as was measured
up to k = 6 with poses of every kind.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from pydantic import field_validator

from simval import statistics as stat
from simval.arrays import Array, frozen
from simval.figures import Figure, Headline, Listing, Quote, entries, of_calibration
from simval.imu.calibrate import calibrate
from simval.imu.sensor import AccelerometerModel
from simval.moments import deviations
from simval.montecarlo import Sums, along, mean_square, moments_of
from simval.poses import PARAMETERS, observability
from simval.results import Outcome, Row, Rows, exact, limit, nees, plain, unjudged
from simval.scene import simulate_cached
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.response import MET, STEP, Expanded, apart, beside, response
from simval.studies.study import (
    LEAST_NOISE,
    Cost,
    StudyParameters,
    described,
    ranged,
    refusing,
)
from simval.studies.trials import Block, drawn_rows, noise_row, root, trials_of
from simval.theory.calibration import (
    EVEN,
    CalibrationMoments,
    calibration_expansion,
    calibration_moments,
)
from simval.theory.coverage import bias_square
from simval.units import OF_A_CALIBRATION

TITLE = "Calibration recovery: tumble, distort, average the holds, calibrate"
SECTION = "calibration"

BLOCK = 64  # trials; part of the promise of equal bits
RECOVERED = 1e-9
"""Relative; of 500 random sensors the worst was off by 2e-15 (docs/calibration.md)."""
ROUNDED = 64 * np.finfo(float).eps
"""Of g and 1, times the condition of the poses: thirty times what the worst of those
500 was off by. Control variates see that."""
G = 9.80665  # m/s^2, standard gravity, and the natural size of a bias
UNITS = ("1",) * 6 + ("m/s²",) * 3
MOST_POSES = 40
"""Poses: more tell nothing new of a formula."""
MET_BIAS = 10.0 * MET
"""A second difference keeps fewer digits: 2e-8 was the worst seen of even poses."""
UNEVEN, UNLIKE = 10.0, 4.0
"""Condition of the poses, and ratio of the scales, up to which differences are taken:
the fourth powers of what they make of a step are 3500 and 250."""
SMALL = 1e-6
"""Noise over gravity, of a residual that must be told one: its square is rounding."""
GROUPS = (("T", slice(0, 3), "1"), ("K", slice(3, 6), "1"), ("B", slice(6, 9), "m/s²"))


class Parameters(StudyParameters):
    """One cell: a scene, a pose count, a noise level and a method."""

    scene: Literal["gimbal", "die"] = described("gimbal", "Scene that is simulated.")
    poses: int = ranged(40, "Poses of the gimbal, or throws of the die.", 9, 400)
    hold_time: float = ranged(
        0.2, "Length of each hold that is averaged, s.", 0.002, 10.0
    )
    noise_std: float = ranged(
        0.01, "Noise per axis and sample, m/s^2; 0 is noise-free.", 0.0, 10.0
    )
    trials: int = ranged(2048, "Trials; rounded up to whole blocks of 64.", 2 * BLOCK)

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
        seconds = 5e-4 * self.poses + trials * (2e-5 + 7e-8 * readings)
        return Cost(seconds, 44 if trials else 3)


def true_sensor(noise_std: float) -> AccelerometerModel:
    """The sensor whose parameters are to be recovered."""
    values = np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
    return AccelerometerModel.from_parameters(values, noise_std=noise_std)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rests:
    """Specific forces of a scene's sensor in its rests."""

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
    """Simulate one cell and compare it with theory."""
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

    def trial(rng: np.random.Generator) -> Block:
        readings = sensor.distort(np.broadcast_to(forces, (BLOCK, *forces.shape)), rng)
        raw = np.full(readings.shape[2], 1.0 / readings.shape[2]) @ readings
        fit = calibrate(raw, g=g, covariance=False)
        if not np.isfinite(fit.parameters).all():
            fit.require_converged()
        kept = {"noise": raw - clean, "error": fit.parameters - sensor.parameters}
        return kept, {"samples": (readings - felt) / parameters.noise_std}

    trials = trials_of(streams, parameters.trials, BLOCK, trial)
    sums, x = trials.sums("error"), trials["noise"]
    still = calibrate(clean, g=g)
    rounding = rounding_of(sensor, float(still.condition))
    # a rest that is not quite at rest, as of a noise-free recovery
    left = predicted.bias_remainder + rounding * (1.0 + rests.rest_force / g / ROUNDED)
    rows = (*_moment_rows(sums, predicted, left), *_nees_row(sums, predicted, left))
    error = trials["error"] - (still.parameters - sensor.parameters)
    known = expanded(sensor, means, g, x, noise)
    return Outcome(
        rows=(
            *unjudged(stat.NOISE_OF_MEAN(), noise),
            *noise_row(x.reshape(len(x), -1) / noise),
            *rows,
            *_control_rows(rows, error, known, predicted, rounding),
            *_group_rows(sums, predicted),
            *drawn_rows(trials.noise),
            *response_rows(sensor, means, g),
            *_pooled_rows(sums, predicted),
        )
    )


def expanded(
    sensor: AccelerometerModel,
    directions: Float[Array, "n 3"],
    g: float,
    noise: Float[Array, "t n 3"],
    sigma: float,
    residual: str = "squared",
) -> Expanded:
    """Errors to first and second order in noise of deviation sigma."""
    expansion = calibration_expansion(sensor, directions, g, residual)
    return Expanded(
        first=expansion.first(noise),
        second=expansion.second(noise),
        covariance=sigma**2 * expansion.slope @ expansion.slope.T,
        mean_second=sigma**2 * expansion.bias,
    )


def _recovery(sensor: AccelerometerModel, rests: Rests) -> Rows:
    """Relative error of T, K and B recovered from one tumble without noise.

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
    return limit(stat.RECOVERY.each("TKB"), relative, most, stat.TRUTH, n=1)


def _moment_rows(
    sums: Sums, predicted: CalibrationMoments, left: Float[Array, "9"]
) -> list[Row]:
    measured, n, names = moments_of(sums), sums.samples, predicted.names
    sd, expected = measured.sd, predicted.sd
    variance_error = np.diagonal(measured.covariance_error)
    share = (deviations(predicted.cramer_rao) / sd) ** 2
    return [
        *plain(
            stat.BIAS.each(names, UNITS), measured.bias, measured.bias_error, n,
            predicted.bias, stat.SECOND_ORDER, left,
        ),
        *plain(
            stat.SD.each(names, UNITS), sd, variance_error / (2 * sd), n,
            expected, stat.FIRST_ORDER, predicted.sd_remainder,
        ),
        *unjudged(
            stat.EFFICIENCY.each(names), share, share * variance_error / sd**2, n,
            (deviations(predicted.cramer_rao) / expected) ** 2,
            stat.FIRST_ORDER,
        ),
    ]  # fmt: skip


def _nees_row(
    sums: Sums, predicted: CalibrationMoments, left: Float[Array, "9"]
) -> Rows:
    weight = np.linalg.inv(predicted.covariance)
    shift, off = bias_square(predicted.bias, left, predicted.covariance)
    expected = 9.0 + shift
    off += expected * predicted.variance_remainder
    found = mean_square(sums, weight)
    return nees(stat.NEES(), *found, sums.samples, expected, stat.FIRST_ORDER, off)


def rounding_of(sensor: AccelerometerModel, condition: float) -> Float[Array, "9"]:
    """Rounding error that a fit's arithmetic leaves in its nine parameters."""
    K = sensor.K
    return ROUNDED * condition * np.concatenate([np.ones(3), K, G / K])


def _control_rows(
    rows: Rows,
    error: Float[Array, "t 9"],
    known: Expanded,
    predicted: CalibrationMoments,
    rounding: Float[Array, "9"],
) -> Rows:
    """The judged rows again, with control variates."""
    weight = np.linalg.inv(predicted.covariance)
    relative = 18.0 * np.max(rounding / predicted.sd)  # of nine squares
    return beside(
        [row for row in rows if row.claimed],
        (known.mean(error), known.sd(error), known.weighted_square(error, weight)),
        np.concatenate([rounding, rounding, [relative]]),
    )


def _group_rows(sums: Sums, predicted: CalibrationMoments) -> Iterator[Row]:
    """RMS error of T, K and B, each over three entries, against the bound."""
    for name, part, unit in GROUPS:
        weight = np.zeros((9, 9))
        weight[part, part] = np.eye(3) / 3.0
        found = root(*mean_square(sums, weight))
        for predictor, matrix in _theories(predicted).items():
            expected = np.sqrt(np.trace(weight @ matrix))
            yield from unjudged(
                stat.RMS(name, unit=unit), *found, sums.samples, expected, predictor
            )


def _theories(predicted: CalibrationMoments) -> dict[str, Array]:
    bias = predicted.bias
    first = predicted.covariance + np.outer(bias, bias)
    return {stat.FIRST_ORDER: first, stat.CRAMER_RAO: predicted.cramer_rao}


def _pooled_rows(sums: Sums, predicted: CalibrationMoments) -> Iterator[Row]:
    """Error of all nine parameters together; bias and spread of T, K and B.

    They repeat what judged rows say entry by entry, so they are not judged again.
    """
    n, bound = sums.samples, np.diagonal(predicted.cramer_rao)
    all_nine = np.array([1.0] * 6 + [G**-2] * 3) / 9.0
    over = np.concatenate([np.full(3, 1 / (3 * bound[p].sum())) for _, p, _ in GROUPS])
    for statistic, weight, by in (
        (stat.RMS("all"), all_nine, stat.FIRST_ORDER),
        (stat.RMS("all"), all_nine, stat.CRAMER_RAO),
        (stat.RMS_OVER_BOUND(), over, stat.FIRST_ORDER),
    ):
        expected = np.sqrt(weight @ np.diagonal(_theories(predicted)[by]))
        found = root(*mean_square(sums, np.diag(weight)))
        yield from unjudged(statistic, *found, n, expected, by)
    for name, part, unit in GROUPS:
        each = np.zeros(9)
        each[part] = 1.0 / 3.0
        expected = np.sqrt(each @ predicted.sd**2)
        left = expected * predicted.variance_remainder / 2.0
        found = root(*along(sums, np.diag(each)))
        yield from unjudged(
            stat.SPREAD(name, unit=unit), *found, n, expected, stat.FIRST_ORDER, left
        )
        size = np.sqrt(each @ predicted.bias**2)
        if size > 0.0:  # else there is nothing to project on
            weight = each * predicted.bias / size
            left = np.abs(weight) @ predicted.bias_remainder
            found = along(sums, weight)
            yield from unjudged(
                stat.BIAS_ALONG(name, unit=unit),
                *found,
                n,
                size,
                stat.SECOND_ORDER,
                left,
            )


def response_rows(
    sensor: AccelerometerModel,
    forces: Float[Array, "n 3"],
    g: float,
    residual: Any = "squared",
) -> Rows:
    """Rows that test theory and stated error bars against the fit's response.

    None for poses or scales so uneven that differences are no match for them.
    """
    count = len(forces)
    few = forces[np.linspace(0, count - 1, min(count, MOST_POSES)).round().astype(int)]
    seen, K = observability(few), np.linalg.norm(sensor.matrix, axis=1)
    if seen.rank < PARAMETERS or seen.condition > UNEVEN or K.max() > UNLIKE * K.min():
        return ()
    still = AccelerometerModel(T=sensor.T, K=sensor.K, B=sensor.B)
    clean = still.distort(few, np.random.default_rng(0))  # draws nothing
    told = {"g": g, "residual": residual, "noise_std": SMALL * g}

    def estimate(y: Float[Array, "t d"]) -> Float[Array, "t 9"]:
        poses = y.reshape(-1, *clean.shape)
        return calibrate(poses, **told, covariance=False).require_converged().parameters

    found = response(estimate, clean.ravel(), STEP * g / K.max())
    noise = np.ones(clean.size)
    predicted = calibration_moments(sensor, few, g=g, noise_std=1.0, residual=residual)
    worse = max(1.0, seen.condition / EVEN)
    claimed = calibrate(clean, **told).covariance / told["noise_std"] ** 2
    rows = exact(
        stat.COVARIANCE_OFF("predicted"),
        apart(predicted.covariance, found.covariance(noise)),
        0.0, stat.RESPONSE, MET * worse**4,
    ) + exact(
        stat.COVARIANCE_OFF("stated"), apart(claimed, predicted.covariance),
        0.0, stat.FIRST_ORDER, MET * worse**4,
    )  # fmt: skip
    if residual == "adjusted":  # subtracts its bias by the noise that is stated
        return rows
    off = np.abs(predicted.bias - found.bias(noise)) / predicted.sd
    return rows + exact(
        stat.BIAS_OFF("predicted"), off.max(), 0.0, stat.RESPONSE, MET_BIAS * worse**4
    )


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
    rows=stat.RMS.each("TKB"),
    by=stat.FIRST_ORDER,
    bound=stat.CRAMER_RAO,
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
        rows=[stat.BIAS_ALONG],
        claimed=[stat.BIAS],
        scale=(stat.SD, stat.FIRST_ORDER, "the scatter"),
        by=stat.SECOND_ORDER,
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
        rows=[stat.SPREAD],
        claimed=[stat.SD],
        bound="",
        fold="{claim}",
        caption="Standard deviation alone, RMS over the three entries.",
    ),
    replace(
        _RMS,
        name="calibration-together",
        asked="",
        what="",
        rows=[stat.RMS("all")],
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
        caption="Without noise: relative error of the parameters, and its limit",
        rows=[stat.RECOVERY],
        keys={"of": entries},
        predicted=True,
        where=lambda parameters: not _noisy(parameters),
    ),
)
HEADLINE = Headline(
    says="T {T}, K {K}, B {B}; {over} × the bound",
    quotes={
        "over": Quote(of=stat.RMS_OVER_BOUND(), by=stat.FIRST_ORDER),
        **{
            name: Quote(
                of=stat.RMS(name), by=stat.CRAMER_RAO, unit=OF_A_CALIBRATION[name]
            )
            for name in "TKB"
        },
    },
)
