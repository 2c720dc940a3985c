r"""End to end: tumble, distort, detect, calibrate, then gravity and field to attitude.

Each trial calibrates the accelerometer from the static intervals that the detector
finds in a noisy tumble. With that calibration it measures the direction of gravity in
the rests of a second tumble, takes the magnetometer as the second vector, and estimates
the attitude in closed form. The true attitude is the simulator's own.

The prediction carries the covariance of the calibration through to the attitude
(`simval.theory.carry`), for the number of samples in each interval.
Each part of the budget is also measured by itself: with the noise of one source only,
all others at their truth.
"""

from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from simval.arrays import Array
from simval.attitude import two_vector_quaternion
from simval.calibrate import calibrate
from simval.geometry import attitude_error, compose, conjugate, normalize
from simval.poses import fibonacci_sphere
from simval.results import Outcome, nees, plain, unjudged
from simval.scene import Trajectory, simulate_cached
from simval.sensor import AccelerometerModel
from simval.shapes import Float
from simval.statics import Intervals, interval_counts, interval_means
from simval.statistics import BUDGET, CARRIED, CHI_SQUARE_3, IMPURE, NEES
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.scoring import detect, mean_of, pure, thinned
from simval.studies.study import Cost, StudyParameters
from simval.theory import calibration_moments
from simval.theory.carry import PARTS, UP, Wanted, carrier

TITLE = "Error budget: tumble, detect, calibrate, gravity and field to attitude"
SECTION = "budget"

SETTINGS = (6.0, 51, 15)  # the detector's multiplier, window and trim, in samples
NEXT_ORDER = 30.0
"""Relative remainder of an RMS error and of the NEES, in squares of the relative noise
of a mean. Measured at a relative noise of 1e-3, above that of any suite: at most 1.6
for the RMS error, 0.1 for the NEES (`test_what_the_linear_budget_leaves_out`)."""


class Parameters(StudyParameters):
    """One cell: poses, noise of the two sensors, and samples in a mean."""

    poses: Annotated[int, Field(ge=12, le=200)] = Field(
        default=40, description="Rests of the calibration's tumble."
    )
    attitudes: Annotated[int, Field(ge=2, le=200)] = Field(
        default=24, description="Rests of the second tumble, whose attitude is wanted."
    )
    accelerometer_noise_std: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.02, description="Noise per axis and sample at 100 Hz, m/s^2."
    )
    magnetometer_noise_std: Annotated[float, Field(gt=0.0, le=1e-5)] = Field(
        default=5e-8, description="Noise per axis and sample at 100 Hz, T."
    )
    average: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=100, description="Samples in a mean whose attitude is estimated."
    )
    trials: Annotated[int, Field(ge=2)] = Field(default=256, description="Trials.")

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.5 + 8e-3 * self.trials, 20)


@lru_cache(maxsize=8)
def tumbles(poses: int, attitudes: int) -> tuple[Trajectory, Wanted]:
    """Simulate both tumbles, or read them from the cache."""
    first = simulate_cached("gimbal", directions=poses, hold_time=2.0, first_hold=5.0)
    turned = fibonacci_sphere(attitudes) @ _rotation()
    second = simulate_cached("gimbal", directions=turned, hold_time=0.2)
    wanted = Wanted(
        force=second.hold_means(),
        field=second.hold_means(second.magnetic_field),
        q=normalize(second.hold_means(second.attitude)),
        field_world=normalize(second.magnetic),
    )
    return first, wanted


def _rotation() -> Float[Array, "3 3"]:
    # a fixed rotation that maps no axis near an axis
    columns = np.array([[1.0, 2.0, 3.0], [3.0, -1.0, 1.0], [-2.0, 1.0, 2.0]])
    orthogonal = np.linalg.qr(columns)[0]
    return np.asarray(orthogonal)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Measure the error budget of one cell beside its prediction."""
    trajectory, wanted = tumbles(parameters.poses, parameters.attitudes)
    truth = thinned(trajectory)
    noise = parameters.accelerometer_noise_std
    sensor = true_sensor(noise)
    field_std = parameters.magnetometer_noise_std / np.sqrt(parameters.average)
    force_std = noise / np.sqrt(parameters.average)
    carriers = [
        carrier(sensor, wanted, k, force_std, field_std) for k in range(len(wanted.q))
    ]
    measured, predicted, squares, impure = [], [], [], []
    for trial in range(parameters.trials):
        rng = streams.block(trial)
        raw = sensor.distort(truth.force, rng)
        intervals, _, _ = detect(raw, *SETTINGS)
        impure.append(float(np.sum(~pure(intervals, truth.still))))
        means = interval_means(raw, intervals)
        fit = calibrate(means, g=truth.g, covariance=False).require_converged()
        estimates = _estimates(sensor, fit.sensor(), wanted, force_std, field_std, rng)
        angles = np.array([attitude_error(q, wanted.q) for q in estimates])
        measured.append(np.mean(angles**2, axis=1))
        covariance = _calibration_covariance(sensor, truth.force, intervals, truth.g)
        parts = np.array([each.parts(covariance) for each in carriers])
        predicted.append(np.trace(parts, axis1=2, axis2=3).mean(axis=0))
        squares.append(_normalized_square(estimates[3], wanted.q, parts[:, 3]))
    size = max(force_std / truth.g, field_std / np.linalg.norm(trajectory.magnetic))
    remainder = NEXT_ORDER * size**2
    rms, error = _root_mean_square(np.transpose(measured))
    expected = np.sqrt(np.mean(np.ascontiguousarray(np.transpose(predicted)), axis=1))
    return Outcome(
        rows=(
            *plain(
                BUDGET.each(PARTS), rms, error, parameters.trials,
                expected, CARRIED, expected * remainder,
            ),
            *nees(NEES(), *mean_of(squares), 3.0, CHI_SQUARE_3, 3.0 * remainder),
            *unjudged(IMPURE(), *mean_of(impure)),
        )
    )  # fmt: skip


def _estimates(
    sensor: AccelerometerModel,
    calibrated: AccelerometerModel,
    wanted: Wanted,
    force_std: float,
    field_std: float,
    rng: np.random.Generator,
) -> list[Array]:
    # attitudes with one source of error after the other, and with all, in PARTS' order
    exact = np.linalg.solve(sensor.matrix, wanted.force.T).T + sensor.B
    noisy = exact + force_std * rng.standard_normal(exact.shape)
    field = wanted.field + field_std * rng.standard_normal(exact.shape)
    cases = (
        (calibrated.correct(exact), wanted.field),
        (sensor.correct(noisy), wanted.field),
        (wanted.force, field),
        (calibrated.correct(noisy), field),
    )
    r1, r2 = (
        np.broadcast_to(UP, exact.shape),
        np.broadcast_to(wanted.field_world, exact.shape),
    )
    return [
        two_vector_quaternion(normalize(force), normalize(seen), r1, r2)
        for force, seen in cases
    ]


def _calibration_covariance(
    sensor: AccelerometerModel,
    force: Float[Array, "n 3"],
    intervals: Intervals,
    g: float,
) -> Float[Array, "9 9"]:
    std = sensor.noise_std / np.sqrt(interval_counts(intervals))
    directions = interval_means(force, intervals)
    return calibration_moments(sensor, directions, g, std).covariance


def _normalized_square(
    estimate: Float[Array, "n 4"],
    truth: Float[Array, "n 4"],
    covariances: Float[Array, "n 3 3"],
) -> float:
    # mean over the poses of one trial, which share its calibration
    step = compose(conjugate(truth), estimate)
    rotation = 2.0 * step[:, :3] * np.sign(step[:, 3:])
    solved = np.linalg.solve(covariances, rotation[..., None])[..., 0]
    return float(np.mean(np.sum(rotation * solved, axis=1)))


def _root_mean_square(
    squares: Float[Array, "p n"],
) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
    # of each row, with its standard error; contiguous, so that sums are pairwise
    squares = np.ascontiguousarray(squares)
    rms = np.sqrt(squares.mean(axis=1))
    error = squares.std(axis=1, ddof=1) / np.sqrt(squares.shape[1])
    return rms, error / (2.0 * rms)
