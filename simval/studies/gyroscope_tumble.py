"""The tumble of the study `gyroscope`: scene, sensors, trials and their bound.

The gimbal rests at poses that are spread evenly and moves between them. A trial is the
mean of each rest with its noise, and the rates of all rows with theirs; the bound is
that of both sensors with every attitude unknown (`simval.theory.gyroscope`), of moves
that are cut into segments.
"""

from math import sqrt
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
import scipy

from simval.arrays import Array
from simval.calibrate import (
    FitResult,
    GyroscopeFit,
    calibrate,
    calibrate_gyroscope,
    moves_between,
)
from simval.scene import Trajectory, average_rates, simulate_cached
from simval.sensor import GyroscopeModel
from simval.shapes import Float
from simval.studies.calibration import true_sensor
from simval.studies.drawn import Drawn
from simval.theory.gyroscope import MovePath, gyroscope_moments

ROWS = 500.0  # Hz, of the gimbal
FORCE = 0.01  # m/s^2, of an accelerometer's sample at 100 Hz
CHUNK = 2
PIECES = 40
"""Segments of a move in the bound. Beside the limit of ever shorter ones, a variance is
off by up to 4e-3 of itself with 14 poses, 3e-3 with 40 and 12e-3 with 12, and the mean
of all twelve, which is judged, by 1e-4, 4e-4 and 8e-4
(`tests/studies/test_gyroscope_study.py`)."""

Estimator = Literal["joint", "generalised", "unweighted"]


@runtime_checkable
class Told(Protocol):
    """What a cell says of its tumble."""

    estimator: Estimator
    poses: int
    move_time: float
    every: int
    angle_random_walk: float


class Tumble:
    """A cell's scene at its rate, its sensors, and how a trial is drawn and fitted."""

    def __init__(self, parameters: Told) -> None:
        self.parameters = parameters
        every = parameters.every
        run = simulate_cached(
            "gimbal", poses=parameters.poses, move_time=parameters.move_time,
            first_hold=20.0,
        )  # fmt: skip
        self.g = run.g
        self.time, self.attitude = run.time[::every], run.attitude[::every]
        self.rests = _rests(run, every)
        force = run.specific_force[::every]
        still = np.concatenate([force[a:b] for a, b in self.rests])
        self.off = float(np.abs(np.linalg.norm(still, axis=1) - run.g).max())
        self.rest_force = run.rest_force
        self.force = np.array([force[a:b].mean(axis=0) for a, b in self.rests])
        seconds = np.diff(self.rests)[:, 0] * every / ROWS
        self.pose_std = FORCE / np.sqrt(100.0 * seconds)
        self.walk = float(np.radians(parameters.angle_random_walk))
        off = [[0.02, 0.02, -0.01], [0.03, 0.03, 0.02], [-0.02, 0.01, -0.01]]
        bias = np.array([0.02, -0.01, 0.03])
        self.gyroscope = GyroscopeModel(M=np.eye(3) + np.array(off), B=bias)
        self.accelerometer = true_sensor(0.0)
        rng = np.random.default_rng(0)  # draws nothing
        self.rates = self.gyroscope.distort(average_rates(run, every), rng)
        steps = average_rates(run)
        beside = 0.5 * (steps + np.concatenate([steps[1:], steps[-1:]]))[::every]
        self.instants = self.gyroscope.distort(beside, rng)
        self.poses = self.accelerometer.distort(self.force, rng)
        self.truth = np.concatenate([self.gyroscope.M.ravel(), bias])

    def straight_lines(self) -> float:
        """Error of M from instants with straight lines between, without noise.

        An instant is the mean of the two steps of 500 Hz beside it.
        """
        moves = moves_between(self.time, self.instants, self.rests, scheme="linear")
        fit = calibrate_gyroscope(
            moves, self.poses, calibrate(self.poses, self.g), pose_std=self.pose_std,
            angle_random_walk=self.walk, start=np.eye(3), estimator="unweighted",
        )  # fmt: skip
        return float(np.abs(fit.M - self.gyroscope.M).max())

    def trial(
        self, rng: np.random.Generator, count: int, noise: float = 1.0
    ) -> GyroscopeFit:
        """Draw and fit some trials."""
        return self.fitted(*self.readings(rng, count, noise))

    def readings(
        self, rng: np.random.Generator, count: int, noise: float = 1.0
    ) -> tuple[Float[Array, "t n 3"], Float[Array, "t r 3"]]:
        """Draw the pose means and the rates of some trials."""
        std = noise * self.pose_std[:, None]
        poses = self.poses + std * rng.standard_normal((count, *self.poses.shape))
        step = self.parameters.every / ROWS
        each = noise * self.walk / sqrt(step)
        rows = self.rates + each * rng.standard_normal((count, *self.rates.shape))
        return poses, rows

    def drawn(
        self, poses: Float[Array, "t n 3"], rows: Float[Array, "t r 3"]
    ) -> dict[str, Drawn]:
        """Noise of these, in units of what the parameters say."""
        density = np.radians(self.parameters.angle_random_walk)
        each = density * sqrt(ROWS / self.parameters.every)
        return {
            "pose means": Drawn.of((poses - self.poses) / self.pose_std[:, None]),
            "rates": Drawn.of((rows - self.rates) / each),
        }

    def fitted(
        self, poses: Float[Array, "t n 3"], rows: Float[Array, "t r 3"]
    ) -> GyroscopeFit:
        """Calibrate from these."""
        moves = moves_between(self.time, rows, self.rests, chunk=CHUNK)
        known = self.parameters.estimator == "unweighted"
        fit: FitResult = calibrate(
            poses, self.g, residual="weighted", noise_std=self.pose_std
        )
        return calibrate_gyroscope(
            moves, poses, fit, pose_std=self.pose_std, angle_random_walk=self.walk,
            estimator=self.parameters.estimator, start=np.eye(3),
            bias="first rest" if known else "constant",
        ).require_converged()  # fmt: skip

    def bound(self, pieces: int = PIECES) -> Float[Array, "12 12"]:
        """Cramer-Rao bound of the gyroscope's twelve, by moves of so many segments."""
        moves = moves_between(self.time, self.rates, self.rests, chunk=CHUNK)
        moments = gyroscope_moments(
            self.gyroscope, self.accelerometer, self.force, self._path(pieces),
            pose_std=self.pose_std, g=self.g, angle_random_walk=self.walk,
            bias_std=self.walk / np.sqrt(moves.rest_seconds.sum()),
        )  # fmt: skip
        return moments.cramer_rao[9:, 9:]

    def _path(self, pieces: int) -> MovePath:
        # from the attitudes, from ten rows before the end of a rest to ten of the next
        rotation = scipy.spatial.transform.Rotation
        inner = np.minimum(10, np.diff(self.rests)[:, 0] // 3)
        first = self.rests[:-1, 1] - 1 - inner[:-1]
        last = self.rests[1:, 0] + inner[1:]
        turns, seconds = [], []
        for a, b in zip(first, last, strict=True):
            nodes = np.round(np.linspace(a, b, pieces + 1)).astype(int)
            # the package's world to sensor is what SciPy reads as sensor to world
            attitude = rotation.from_quat(np.array(self.attitude[nodes]))
            turns.append((attitude[:-1].inv() * attitude[1:]).as_rotvec())
            seconds.append(np.diff(self.time[nodes]))
        return MovePath(turns=np.array(turns), seconds=np.array(seconds))


def _rests(run: Trajectory, every: int) -> Any:
    hold = run.hold[::every]
    rows = [np.flatnonzero(hold == k) for k in run.hold_indices()]
    return np.array([[r[0], r[-1] + 1] for r in rows])
