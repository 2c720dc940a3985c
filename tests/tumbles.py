"""Tumbles with a gyroscope: attitudes of a scene, readings of known sensors."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from simval.imu.calibrate import Recording, calibrate, fit, inter_rest_rotations
from simval.imu.sensor import AccelerometerModel, GyroscopeModel
from simval.scene import average_rates, simulate
from simval.theory import MovePath

ACCELEROMETER = AccelerometerModel.from_parameters(
    np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
)
M = 1.02 * np.eye(3) + np.array(
    [[0.0, 0.02, -0.01], [0.03, 0.01, 0.02], [-0.02, 0.01, -0.03]]
)
GYROSCOPE = GyroscopeModel(M=M, B=np.array([0.02, -0.01, 0.03]))
FORCE_STD = 0.01  # m/s^2, of a sample at 100 Hz
WALK = np.radians(0.01)  # rad/s per root hertz


@dataclass(frozen=True)
class Tumble:
    """A scene's truth at some rate."""

    time: np.ndarray
    rate: np.ndarray  # averages
    force: np.ndarray
    attitude: np.ndarray
    intervals: np.ndarray
    g: float

    @property
    def directions(self):
        """True specific force of each rest, sensor axes."""
        return np.array([self.force[a:b].mean(axis=0) for a, b in self.intervals])

    @property
    def pose_std(self):
        """Noise of a pose mean."""
        rows = np.diff(self.intervals)[:, 0]
        return FORCE_STD / np.sqrt(rows)


@cache
def tumble(poses=40, every=5, move_time=2.0, first_hold=20.0, hold_time=1.0, **more):
    """Tumble of the gimbal, every so many of its rows (500 Hz)."""
    run = simulate(
        "gimbal",
        poses=poses,
        move_time=move_time,
        first_hold=first_hold,
        hold_time=hold_time,
        **more,
    )
    return of(run, every)


def of(run, every=1):
    """A trajectory as a tumble."""
    hold = run.hold[::every]
    rests = [np.flatnonzero(hold == k) for k in run.hold_indices()]
    return Tumble(
        time=run.time[::every],
        rate=average_rates(run, every),
        force=run.specific_force[::every],
        attitude=run.attitude[::every],
        intervals=np.array([[r[0], r[-1] + 1] for r in rests]),
        g=run.g,
    )


def readings(truth, trials, rng, *, gyroscope=GYROSCOPE, times=1.0, rates=None):
    """Pose means and gyroscope rows of some trials, noise `times` the nominal one."""
    poses = ACCELEROMETER.distort(truth.directions, rng)
    noise = rng.standard_normal((trials, *poses.shape)) * truth.pose_std[:, None]
    step = truth.time[1] - truth.time[0]
    clean = gyroscope.distort(truth.rate if rates is None else rates, rng)
    rows = rng.standard_normal((trials, *clean.shape)) * (WALK / np.sqrt(step))
    return poses + times * noise, clean + times * rows


def fitted(truth, poses, rows, *, chunk=2, **options):
    """Accelerometer fits and rotations between rests of some trials."""
    inter_rest = inter_rest_rotations(
        truth.time, rows, truth.intervals, chunk=chunk, **options
    )
    return calibrate(
        poses, truth.g, residual="weighted", noise_std=truth.pose_std
    ), inter_rest


def gyroscope_of(rotations, poses, accelerometer, **given):
    """Calibrate from these rotations and poses."""
    how = {k: given.pop(k) for k in ("estimator", "start") if k in given}
    recording = Recording(
        poses=poses, rotations=rotations, accelerometer=accelerometer,
        g=accelerometer.g, model=accelerometer.model, **given,
    )  # fmt: skip
    return fit(recording, **how).gyroscope


def path_of(truth, pieces=40, margin=10):
    """Moves as theory takes them, from the scene's attitudes."""
    rows = truth.intervals
    inner = np.minimum(margin, np.diff(rows)[:, 0] // 3)
    turns, seconds = [], []
    for a, b in zip(
        rows[:-1, 1] - 1 - inner[:-1], rows[1:, 0] + inner[1:], strict=True
    ):
        nodes = np.unique(np.round(np.linspace(a, b, pieces + 1)).astype(int))
        attitude = Rotation.from_quat(truth.attitude[nodes])
        turns.append((attitude[:-1].inv() * attitude[1:]).as_rotvec())
        seconds.append(np.diff(truth.time[nodes]))
    return MovePath(turns=np.array(turns), seconds=np.array(seconds))


def rolled(axes_angles, hold=60, move=200, h=0.01, first=None):
    """Time, averages of the rate, rests and their attitudes; moves about fixed axes."""
    first = hold if first is None else first
    s = np.linspace(0.0, 1.0, move + 1)
    course = np.diff(s**3 * (10 - 15 * s + 6 * s * s)) / h
    parts = [np.zeros((first, 3))]
    for axis, angle in axes_angles:
        unit = np.array(axis) / np.linalg.norm(axis)
        parts += [course[:, None] * unit * angle, np.zeros((hold, 3))]
    rate = np.concatenate(parts)
    stops = first + (move + hold) * np.arange(len(axes_angles) + 1)
    rests = np.stack([stops - hold, stops], axis=1)
    rests[0, 0] = 0
    turned = [Rotation.identity()]
    for axis, angle in axes_angles:
        step = Rotation.from_rotvec(np.array(axis) / np.linalg.norm(axis) * angle)
        turned.append(turned[-1] * step)
    return np.arange(len(rate)) * h, rate, rests, Rotation.concatenate(turned)


FIRST_UP = np.array([0.2, 0.3, 0.9]) / np.linalg.norm([0.2, 0.3, 0.9])
"""In the axes of the first rest of `rolled`, from which no other is upside down."""


_RANDOM = np.random.default_rng(2)
GENERIC = [(_RANDOM.standard_normal(3), _RANDOM.uniform(1.0, 2.5)) for _ in range(12)]
