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

Theory is of rests that are still, and of first order. It ends where the noise is so
great that the detector may take a motion for rest, and where the noisier sensor bends
what the other one fixes (`simval.theory.magnetometer`).
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.consistency import normalised_squares
from simval.figures import Figure, Headline, Quote, entry
from simval.geometry import attitude_error, compose, conjugate, normalize
from simval.imu.attitude import two_vector_quaternion
from simval.imu.calibrate import Recording, fit
from simval.imu.sensor import AccelerometerModel, MagnetometerModel, forms
from simval.imu.statics import (
    Intervals,
    interval_counts,
    interval_means,
    intervals_below,
    variance_magnitude,
)
from simval.poses import fibonacci_sphere
from simval.results import Outcome, beyond, nees, plain, unjudged
from simval.scene import Trajectory, simulate_cached
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.detector import detect, known_rest_rows, logged, pure, thinned
from simval.studies.magnetometer import true_magnetometer
from simval.studies.study import LEAST_NOISE, Cost, StudyParameters, ranged, refusing
from simval.studies.trials import Block, drawn_rows, mean_of, root, trials_of
from simval.theory.magnetometer import RANGE, Problem, equations_of, problem_of
from simval.theory.propagation import PARTS, UP, Wanted, calibration_parts, carrier

TITLE = "Error budget: tumble, calibrate both sensors, gravity and field to attitude"
SECTION = "budget"

SETTINGS = (6.0, 51, 15)  # the detector's multiplier, window and trim, in samples
CHANCE = 1.2
"""Of the detector's threshold: the variance of an initial rest of 500 samples is
seldom so much greater."""
ROUNDED = 10.0  # times the rounding of weights as far apart as those of two noises
NEXT_ORDER = 30.0
"""Relative remainder of an RMS error and of the NEES, in squares of the greatest
relative noise of a mean. Measured at a relative noise of 1e-3, above that of any suite:
at most 1.6 for the RMS error, 0.1 for the NEES
(`test_what_the_linear_budget_leaves_out`)."""


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
        one = 7e-4 + 1e-4 * self.poses + 2e-5 * self.attitudes
        return Cost(0.2 + one * self.trials, 22)


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
        self.dip = -np.arcsin(normalize(trajectory.magnetic)[2])
        field = normalize(trajectory.magnetic_field[every])
        self.log = np.stack(self.felt(self.tumble.force, field))
        self.rests = self.felt(wanted.force, wanted.field)

    def outside(self, force_std: float, rests: Problem) -> str:
        """Say why theory does not hold with this noise; empty if it does."""
        multiplier, window, trim = SETTINGS
        # what is below the threshold with noise, is so without
        most = CHANCE * multiplier * np.sqrt(3.0) * force_std**2
        spread = variance_magnitude(self.log[0], window)
        found = intervals_below(spread, most, window // 2, trim)
        if not pure(found, self.tumble.still).all():
            return (
                f"noise of {force_std:.2g} m/s² hides motions from the detector, and "
                "theory is of still rests; lower `accelerometer_noise_std`"
            )
        bent = equations_of(rests).bent
        if bent > RANGE:
            return (
                f"the noises are so unlike that the second order adds {bent:.2g} to "
                f"the normalised square of a calibration; theory holds up to {RANGE:g}"
            )
        return ""

    def felt(self, force: Array, field: Array) -> tuple[Array, Array]:
        """Readings of both sensors without noise."""
        quiet = np.random.default_rng(0)  # draws nothing
        body, iron = self.sensors
        return body.distort(force, quiet), iron.distort(field, quiet)

    def problem(self, q: Float[Array, "m 4"], std: Std) -> Problem:
        """The poses of these attitudes, at the truth, for theory."""
        return problem_of(
            *self.sensors, q, self.dip, *std,
            g=self.tumble.g, field=1.0, form="triangular",
        )  # fmt: skip

    def drawn(
        self, raw: Float[Array, "n 3"], noise: Std, mean: Std, rng: np.random.Generator
    ) -> "Readings":
        """Draw the readings of a trial."""
        intervals, _, _ = detect(raw, *SETTINGS)
        counts = interval_counts(intervals)
        std = np.stack([each / np.sqrt(counts) for each in noise])
        # every second sum is of the rows between two intervals
        sums = np.add.reduceat(self.log, intervals.ravel(), axis=1)[:, ::2]
        quiet = sums / counts[:, None]
        field = quiet[1] + std[1][:, None] * rng.standard_normal(quiet[1].shape)
        rests = [
            rows + each * rng.standard_normal(rows.shape)
            for rows, each in zip(self.rests, mean, strict=True)
        ]
        return Readings(
            intervals=intervals, std=std, quiet=quiet,
            noisy=np.stack([interval_means(raw, intervals), field]),
            rests=(rests[0], rests[1]),
        )  # fmt: skip

    def calibrated(self, drawn: Sequence["Readings"]) -> Float[Array, "t 3 22"]:
        """Calibrate with noise in the accelerometer, the magnetometer, and both.

        Of each trial; those with as many rests are one batch.
        """
        fitted = np.empty((len(drawn), 3, 22))
        sizes = np.array([len(each.intervals) for each in drawn])
        for size in np.unique(sizes):
            rows = np.flatnonzero(sizes == size)
            some = [drawn[k] for k in rows.tolist()]
            force, field = (
                np.concatenate([each.mixed(k) for each in some]) for k in (0, 1)
            )
            std = np.repeat([each.std for each in some], 3, axis=0)
            recording = Recording(
                poses=force, fields=field, g=self.tumble.g, pose_std=std[:, 0],
                field_std=std[:, 1],
            )  # fmt: skip
            found = fit(recording).require_converged()
            fitted[rows] = found.parameters.reshape(-1, 3, 22)
        return fitted

    def directions(
        self, fitted: Float[Array, "t 3 22"], noisy: tuple[Array, Array]
    ) -> Float[Array, "t 2 5 n 3"]:
        """Gravity and field with each source of error alone, and all (`PARTS`)."""
        a, b, both = fitted[:, 0], fitted[:, 1], fitted[:, 2]
        body, iron = self.sensors
        true = np.concatenate([body.parameters, iron.M.ravel(), iron.b, [0.0]])
        values = np.stack(np.broadcast_arrays(a, b, true, true, both), axis=1)
        force, field = (
            np.stack(np.broadcast_arrays(exact, exact, *pair, rows), axis=1)
            for exact, rows, pair in (
                (self.rests[0], noisy[0], (noisy[0], self.rests[0])),
                (self.rests[1], noisy[1], (self.rests[1], noisy[1])),
            )
        )
        up = forms.matrix("triangular", values[..., :9])
        along = values[..., 9:18].reshape(*values.shape[:-1], 3, 3)
        pairs = (force, values[..., 6:9], up), (field, values[..., 18:21], along)
        return np.stack(
            [normalize((raw - bias[..., None, :]) @ M.mT) for raw, bias, M in pairs],
            axis=1,
        )

    def estimates(
        self, directions: Float[Array, "t 2 5 n 3"]
    ) -> Float[Array, "t 5 n 4"]:
        """Attitudes from these directions."""
        b1, b2 = directions[:, 0], directions[:, 1]
        r1, r2 = (np.broadcast_to(r, b1.shape) for r in (UP, self.wanted.field_world))
        return two_vector_quaternion(b1, b2, r1, r2, "best")


class Readings(NamedTuple):
    """Pose means of a trial, accelerometer first."""

    intervals: Intervals
    std: Float[Array, "2 m"]  # of the means over them
    quiet: Float[Array, "2 m 3"]  # without noise
    noisy: Float[Array, "2 m 3"]
    rests: tuple[Array, Array]  # of the second tumble, with noise

    def mixed(self, sensor: int) -> Float[Array, "3 m 3"]:
        """Means of one sensor with noise in the first, in the second, and in both."""
        return np.stack(
            [(self.quiet, self.noisy)[k][sensor] for k in (sensor == 0, sensor, 1)]
        )


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

    drawn: list[Readings] = []
    sensor = true_sensor(force_std)

    def trial(rng: np.random.Generator) -> Block:
        raw = sensor.distort(scenario.tumble.force, rng)
        drawn.append(scenario.drawn(raw, noise, mean_std, rng))
        moved = np.sum(~pure(drawn[-1].intervals, scenario.tumble.still))
        samples = (raw - scenario.log[0]) / force_std
        return {"impure": np.array([moved], float)}, {"samples": samples}

    trials = trials_of(streams, parameters.trials, 1, trial)
    fitted = scenario.calibrated(drawn)
    force, field = (np.stack([each.rests[k] for each in drawn]) for k in (0, 1))
    estimates = scenario.estimates(scenario.directions(fitted, (force, field)))
    # of whole rests the attitude in their middle; rows of a problem are its rests
    middle = np.concatenate([each.intervals.sum(axis=1) // 2 for each in drawn])
    stds = np.concatenate([each.std for each in drawn], axis=1)
    every = scenario.problem(scenario.attitude[middle], (stds[0], stds[1]))
    ends = np.cumsum([len(each.intervals) for each in drawn])[:-1]
    covariance = calibration_parts(every, ends)
    parts = np.stack([each.parts(covariance) for each in carriers], axis=1)
    # means over the poses of one trial, which share its calibration
    step = compose(conjugate(wanted.q), estimates[:, -1])
    rotation = 2.0 * step[..., :3] * np.sign(step[..., 3:])
    measured = np.mean(attitude_error(estimates, wanted.q) ** 2, axis=2).T
    # below zero only by rounding of a negligible part
    predicted = np.maximum(np.linalg.trace(parts).mean(axis=1).T, 0.0)
    square = mean_of(np.mean(normalised_squares(rotation, parts[:, :, -1]), axis=1))
    g, whole = scenario.tumble.g, np.maximum(stds.max(axis=1), mean_std)
    remainder = NEXT_ORDER * max(whole[0] / g, whole[1]) ** 2
    first = slice(len(drawn[0].intervals))
    rests = scenario.problem(scenario.attitude[middle[first]], (*stds[:, first],))
    why = scenario.outside(force_std, rests)
    # contiguous, so that sums are pairwise
    measured, predicted = map(np.ascontiguousarray, (measured, predicted))
    error = measured.std(axis=1, ddof=1) / np.sqrt(parameters.trials)
    expected = np.sqrt(np.mean(predicted, axis=1))
    # weights as far apart as these squared lose digits of the lesser part
    apart = max(mean_std[0] / g / mean_std[1], mean_std[1] / (mean_std[0] / g), 1.0)
    lost = np.sqrt(ROUNDED * np.finfo(float).eps) * apart * expected[-1]
    return Outcome(
        rows=(
            *beyond(plain(
                stat.BUDGET.each(PARTS), *root(measured.mean(axis=1), error),
                parameters.trials, expected, stat.CARRIED, expected * remainder + lost,
            ), why),
            *beyond(nees(
                stat.NEES(), *square, 3.0, stat.CHI_SQUARE_3, 3.0 * remainder
            ), why),
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
