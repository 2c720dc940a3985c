r"""End to end: tumble, distort, detect, calibrate, then gravity and field to attitude.

Each trial calibrates the accelerometer and the magnetometer beside it from the static
intervals that the detector finds in a noisy tumble, by the weighted fit of both. With
that calibration it measures the directions of gravity and of the field in the rests of
a second tumble, and estimates the attitude in closed form. The true attitude is the
simulator's own.

The prediction carries the noise of each sensor through the calibration to the attitude
(`simval.theory.propagation`), for the number of samples in each interval.
Each part of the budget is also measured by itself: with the noise of one sensor in one
of the two tumbles only, and all else at the truth.
"""

from functools import lru_cache

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.consistency import normalised_squares
from simval.figures import Figure, Headline, Quote, entry
from simval.geometry import attitude_error, compose, conjugate, normalize
from simval.imu.attitude import two_vector_quaternion
from simval.imu.calibrate import calibrate_magnetometer
from simval.imu.sensor import AccelerometerModel, MagnetometerModel
from simval.imu.statics import Intervals, interval_counts, interval_means
from simval.poses import fibonacci_sphere
from simval.results import Outcome, nees, plain, unjudged
from simval.scene import Trajectory, simulate_cached
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.detector import detect, known_rest_rows, logged, pure, thinned
from simval.studies.magnetometer import true_magnetometer
from simval.studies.study import LEAST_NOISE, Cost, StudyParameters, ranged, refusing
from simval.studies.trials import Kept, drawn_rows, mean_of, root, trials_of
from simval.theory.magnetometer import Problem, problem_of
from simval.theory.propagation import PARTS, UP, Wanted, calibration_parts, carrier

TITLE = "Error budget: tumble, calibrate both sensors, gravity and field to attitude"
SECTION = "budget"

SETTINGS = (6.0, 51, 15)  # the detector's multiplier, window and trim, in samples
NEXT_ORDER = 30.0
"""Relative remainder of an RMS error and of the NEES, in squares of the relative noise
of a mean. Measured at a relative noise of 1e-3, above that of any suite: at most 1.6
for the RMS error, 0.1 for the NEES (`test_what_the_linear_budget_leaves_out`)."""


class Parameters(StudyParameters):
    """One cell: poses, noise of the two sensors, and samples in a mean."""

    poses: int = ranged(40, "Rests of the calibration's tumble.", 12, 200)
    attitudes: int = ranged(
        24, "Rests of the second tumble, whose attitude is wanted.", 2, 200
    )
    accelerometer_noise_std: float = ranged(
        0.02, "Noise per axis and sample at 100 Hz, m/s^2.", LEAST_NOISE, 1.0
    )
    magnetometer_noise_std: float = ranged(
        5e-8, "Noise per axis and sample at 100 Hz, T.", 1e-14, 1e-5
    )
    average: int = ranged(
        100, "Samples in a mean whose attitude is estimated.", 1, 10_000
    )
    trials: int = ranged(256, "Trials.", 2)

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.5 + 3.5e-2 * self.trials, 22)


Sensors = tuple[AccelerometerModel, MagnetometerModel]
Std = tuple[float | Float[Array, " m"], float | Float[Array, " m"]]
"""Noise of a mean of each sensor."""


@lru_cache(maxsize=8)
def tumbles(poses: int, attitudes: int) -> tuple[Trajectory, Wanted]:
    """Simulate both tumbles, or read them from the cache."""
    first = simulate_cached("gimbal", poses=poses, hold_time=2.0, first_hold=5.0)
    # a fixed rotation that maps no axis near an axis
    columns = np.array([[1.0, 2.0, 3.0], [3.0, -1.0, 1.0], [-2.0, 1.0, 2.0]])
    turned = fibonacci_sphere(attitudes) @ np.linalg.qr(columns)[0]
    second = simulate_cached("gimbal", poses=turned, hold_time=0.2)
    wanted = Wanted(
        force=second.hold_means(),
        field=normalize(second.hold_means(second.magnetic_field)),
        q=normalize(second.hold_means(second.attitude)),
        field_world=normalize(second.magnetic),
    )
    return first, wanted


class Scenario:
    """Both true sensors on both tumbles, without noise; the field has length 1."""

    def __init__(self, trajectory: Trajectory, wanted: Wanted) -> None:
        every = logged(trajectory)
        self.sensors: Sensors = (true_sensor(0.0), true_magnetometer())
        self.tumble, self.wanted = thinned(trajectory), wanted
        self.attitude = trajectory.attitude[every]
        self.dip = float(-np.arcsin(normalize(trajectory.magnetic)[2]))
        field = normalize(trajectory.magnetic_field[every])
        self.log = self.felt(self.tumble.force, field)
        self.rests = self.felt(wanted.force, wanted.field)

    def felt(self, force: Array, field: Array) -> tuple[Array, Array]:
        """Readings of both sensors."""
        quiet = np.random.default_rng(0)  # draws nothing
        body, iron = self.sensors
        return body.distort(force, quiet), iron.distort(field, quiet)

    def problem(self, q: Float[Array, "m 4"], std: Std) -> Problem:
        """Poses of these attitudes at the truth, for theory."""
        return problem_of(
            *self.sensors, q, self.dip, *std,
            g=self.tumble.g, field=1.0, form="triangular",
        )  # fmt: skip

    def calibrated(
        self,
        noisy: Float[Array, "m 3"],
        intervals: Intervals,
        std: tuple[Float[Array, " m"], Float[Array, " m"]],
        rng: np.random.Generator,
    ) -> list[Sensors]:
        """Both sensors from the accelerometer's noise, the magnetometer's, and both."""
        force, field = (interval_means(rows, intervals) for rows in self.log)
        stirred = field + std[1][:, None] * rng.standard_normal(field.shape)
        fit = calibrate_magnetometer(
            np.stack([noisy, force, noisy]),
            np.stack([field, stirred, stirred]),
            self.tumble.g,
            accelerometer_std=std[0],
            magnetometer_std=std[1],
            model="triangular",
        ).require_converged()
        return [
            (
                AccelerometerModel.from_parameters(values[:9]),
                MagnetometerModel(M=values[9:18].reshape(3, 3), b=values[18:21]),
            )
            for values in fit.parameters
        ]

    def estimates(
        self, fitted: list[Sensors], std: Std, rng: np.random.Generator
    ) -> list[Float[Array, "n 4"]]:
        """Attitudes with one source of error each, and with all, as `PARTS`."""
        exact = self.rests
        noisy = tuple(
            rows + each * rng.standard_normal(rows.shape)
            for rows, each in zip(exact, std, strict=True)
        )
        shape = exact[0].shape
        r1, r2 = (np.broadcast_to(r, shape) for r in (UP, self.wanted.field_world))
        return [
            two_vector_quaternion(
                normalize(body.correct(force)), normalize(iron.correct(field)), r1, r2
            )
            for (body, iron), (force, field) in (
                (fitted[0], exact),
                (fitted[1], exact),
                (self.sensors, (noisy[0], exact[1])),
                (self.sensors, (exact[0], noisy[1])),
                (fitted[2], noisy),
            )
        ]


@refusing("lower the noise, or give more `poses` or a larger `average`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the error budget of one cell against its prediction."""
    trajectory, wanted = tumbles(parameters.poses, parameters.attitudes)
    scenario = Scenario(trajectory, wanted)
    strength = float(np.linalg.norm(trajectory.magnetic))
    force_std = parameters.accelerometer_noise_std
    noise = force_std, parameters.magnetometer_noise_std / strength
    count = np.sqrt(parameters.average)
    mean_std = noise[0] / count, noise[1] / count
    true = scenario.problem(wanted.q, mean_std)
    carriers = [carrier(true, wanted, k, *mean_std) for k in range(len(wanted.q))]

    def trial(rng: np.random.Generator) -> tuple[Kept, Kept]:
        raw = true_sensor(force_std).distort(scenario.tumble.force, rng)
        intervals, _, _ = detect(raw, *SETTINGS)
        samples = np.sqrt(interval_counts(intervals))
        std = noise[0] / samples, noise[1] / samples
        means = interval_means(raw, intervals)
        fitted = scenario.calibrated(means, intervals, std, rng)
        estimates = scenario.estimates(fitted, mean_std, rng)
        angles = np.array([attitude_error(q, wanted.q) for q in estimates])
        middle = scenario.attitude[intervals.sum(axis=1) // 2]  # whole rests
        covariance = calibration_parts(scenario.problem(middle, std))
        parts = np.array([each.parts(covariance) for each in carriers])
        # mean over the poses of one trial, which share its calibration
        step = compose(conjugate(wanted.q), estimates[-1])
        rotation = 2.0 * step[:, :3] * np.sign(step[:, 3:])
        kept = {
            "measured": np.mean(angles**2, axis=1),
            "predicted": np.trace(parts, axis1=2, axis2=3).mean(axis=0),
            "square": np.mean(normalised_squares(rotation, parts[:, -1])),
            "impure": np.sum(~pure(intervals, scenario.tumble.still)),
        }
        drawn = {"samples": (raw - scenario.log[0]) / force_std}
        return {name: np.array([each], float) for name, each in kept.items()}, drawn

    trials = trials_of(streams, parameters.trials, 1, trial)
    remainder = NEXT_ORDER * max(mean_std[0] / scenario.tumble.g, mean_std[1]) ** 2
    # contiguous, so that sums are pairwise
    measured, predicted = (
        np.ascontiguousarray(trials[name].T) for name in ("measured", "predicted")
    )
    error = measured.std(axis=1, ddof=1) / np.sqrt(parameters.trials)
    expected = np.sqrt(np.mean(predicted, axis=1))
    square = mean_of(trials["square"])
    return Outcome(
        rows=(
            *plain(
                stat.BUDGET.each(PARTS), *root(measured.mean(axis=1), error),
                parameters.trials, expected, stat.CARRIED, expected * remainder,
            ),
            *nees(stat.NEES(), *square, 3.0, stat.CHI_SQUARE_3, 3.0 * remainder),
            *unjudged(stat.IMPURE(), *mean_of(trials["impure"])),
            *drawn_rows(trials.noise),
            *known_rest_rows(detect, interval_means, interval_counts, SETTINGS),
        )
    )  # fmt: skip


FIGURES = (
    Figure(
        name="budget",
        asked="What does each source of error contribute?",
        what="Every part",
        says="Most comes from the {most_of}: {most}.",
        about=stat.BUDGET.each(PARTS[:-1]),
        rows=[stat.BUDGET],
        lines=entry(0),
        caption=(
            "Contributions to the attitude error. Predicted: carried from the noise "
            "through the calibration to the attitude."
        ),
    ),
)
HEADLINE = Headline(
    says="attitude {angle} RMS; {over} × theory",
    quotes={
        "angle": Quote(of=stat.BUDGET("total"), by=stat.CARRIED, angle=True),
        "over": Quote(of=stat.BUDGET("total"), by=stat.CARRIED, over=True),
    },
)
