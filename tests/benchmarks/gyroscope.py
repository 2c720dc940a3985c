"""Races of the gyroscope's calibration: path statistics beside a loop over samples."""

from functools import cache, partial
from typing import Any

import numpy as np
import scipy

from benchmarks.race import Answers, Contender, race
from simval.arrays import Array
from simval.imu.calibrate import (
    FitResult,
    Recording,
    calibrate,
    fit,
    inter_rest_rotations,
)
from simval.imu.calibrate.gyroscope.noise import Weighting
from simval.imu.calibrate.path_statistics import Scheme
from simval.imu.calibrate.recording import Bias
from simval.imu.sensor import AccelerometerModel, GyroscopeModel
from simval.poses import fibonacci_sphere
from simval.shapes import Float
from simval.turns import turns_of

G = 9.80665  # m/s^2, standard gravity
POSES, MOVE, REST, STEP = 40, 200, 100, 0.01  # rows and s: moves of 2 s at 100 Hz
POSE_STD = 1e-3  # m/s^2, of the mean of a rest; chosen
WALK = 1.75e-4  # rad/s per root hertz: 0.01 degree
TRIALS, BLOCK = 24, 12
"""Fits of the batches, and of one batch: of 4, 6, 8, 12 and 24 at once, 12 are quickest
(119, 148, 158, 175 and 155 a second on a busy machine)."""
AGREEMENT = 1e-6
"""Difference allowed between contenders that weigh alike, rad/s per rad/s. Chosen: a
hundredth of a standard deviation; Runge and Kutta's own fourth order leaves 1e-8, as do
chunks of samples."""
SPREAD = 1e-3
"""The same between all. Chosen: three standard deviations of the unweighted fit."""


@cache
def _data() -> tuple[Array, Array, Any, Array, FitResult]:
    # time, rows of each trial, rests, poses and their fit
    u = fibonacci_sphere(POSES)
    axis, angle = turns_of(u)
    s = np.linspace(0.0, 1.0, MOVE + 1)
    course = np.diff(s**3 * (10.0 + s * (6.0 * s - 15.0))) / STEP
    still = np.zeros((REST, 3))
    parts = [still]
    for a, b in zip(axis, angle, strict=True):
        parts += [course[:, None] * a * b, still]
    rate = np.concatenate(parts)
    off = np.array([[0.02, 0.02, -0.01], [0.03, 0.03, 0.02], [0.0, 0.01, 0.0]])
    bias = np.array([0.02, -0.01, 0.03])
    sensor = GyroscopeModel(M=np.eye(3) + off, B=bias, angle_random_walk=WALK)
    rng = np.random.default_rng(1)
    rows = np.stack([sensor.distort(rate, rng, timestep=STEP) for _ in range(TRIALS)])
    values = np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
    force = AccelerometerModel.from_parameters(values, noise_std=POSE_STD)
    poses = force.distort(G * np.broadcast_to(u, (TRIALS, POSES, 3)), rng)
    starts = np.arange(POSES) * (MOVE + REST)
    rests = np.stack([starts, starts + REST], axis=1)
    return np.arange(len(rate)) * STEP, rows, rests, poses, calibrate(poses, G)


@race("gyroscope", "Calibrations of a gyroscope, 39 moves of 200 samples", "fits")
def contenders() -> list[Contender]:
    """List the ways to fit; the reference is SciPy over Runge-Kutta steps."""

    def seen(M: Float[Array, "k 3 3"], weights: str) -> Answers:
        # alike where the weights are, and near in any case
        alike = {f"matrix, {weights}": (M, 0.5 * AGREEMENT)}
        return alike | {"matrix": (M, 0.5 * SPREAD)}

    as_imu_tk = {"scheme": "linear", "chunk": 1, "bias": "first rest"}
    ways: dict[str, tuple[str, int, int, dict[str, Any]]] = {
        "the same fit": ("unweighted", 4, 1, as_imu_tk),
        "one at a time": ("generalised", 4, 1, {}),
        "batch": ("generalised", TRIALS, BLOCK, {}),
        "batch, chunks of four": ("generalised", TRIALS, BLOCK, {"chunk": 4}),
        "with the accelerometer, batch": ("joint", TRIALS, BLOCK, {}),
    }
    return [
        Contender(
            "scipy least_squares, Runge-Kutta on samples, data unchecked", 1,
            lambda: _scipy(0)[None], partial(seen, weights="unweighted"),
        ),
        *(
            Contender(
                f"fit of a gyroscope, {name}", min(count, TRIALS),
                partial(_in_blocks, min(count, TRIALS), block, estimator=way, **more),
                partial(seen, weights=way),
            )
            for name, (way, count, block, more) in ways.items()
        ),
    ]  # fmt: skip


def _in_blocks(count: int, block: int, **options: Any) -> Float[Array, "k 3 3"]:
    starts = range(0, count, block)
    fits = [_fitted(slice(i, min(i + block, count)), **options) for i in starts]
    return np.concatenate(fits)


def _fitted(
    some: slice,
    estimator: Weighting,
    scheme: Scheme = "averages",
    chunk: int = 2,
    bias: Bias = "constant",
) -> Float[Array, "k 3 3"]:
    time, rows, rests, poses, _ = _data()
    inter_rest = inter_rest_rotations(
        time, rows[some], rests, scheme=scheme, chunk=chunk, margin=0
    )
    acc = calibrate(poses[some], G, covariance=False)
    recording = Recording(
        poses=poses[some], rotations=inter_rest, accelerometer=acc, g=G,
        pose_std=POSE_STD, angle_random_walk=WALK, bias=bias,
    )  # fmt: skip
    found = fit(recording, estimator=estimator, start=np.eye(3)).gyroscope
    return np.asarray(found.M)


def _scipy(trial: int) -> Float[Array, "3 3"]:
    # what IMU-TK minimises, as a user of SciPy would: nine entries, unit vectors
    _, rows, rests, poses, acc = _data()
    h = (poses[trial] - acc.B[trial]) @ acc.matrix[trial].T
    u = h / np.linalg.norm(h, axis=1, keepdims=True)
    first, last = rests[:-1, 1] - 1, rests[1:, 0]
    # the mean of the first rest, its last row given to the move
    bias = rows[trial, :REST].mean(axis=0)
    samples = np.stack(
        [rows[trial, a : b + 1] - bias for a, b in zip(first, last, strict=True)]
    )

    def residual(values: Array) -> Array:
        q = _runge_kutta(samples @ values.reshape(3, 3).T)
        turned = scipy.spatial.transform.Rotation.from_quat(q)
        return (turned.apply(u[:-1], inverse=True) - u[1:]).ravel()

    return scipy.optimize.least_squares(
        residual, np.eye(3).ravel(), xtol=1e-12, ftol=1e-12, gtol=1e-12
    ).x.reshape(3, 3)


def _runge_kutta(w: Float[Array, "k n 3"]) -> Float[Array, "k 4"]:
    # quaternion, vector first, of each move; one step between any two samples
    q = np.tile([0.0, 0.0, 0.0, 1.0], (len(w), 1))
    for a, b in zip(np.moveaxis(w, 1, 0)[:-1], np.moveaxis(w, 1, 0)[1:], strict=True):
        k1 = _slope(q, a)
        k2 = _slope(q + 0.5 * STEP * k1, 0.5 * (a + b))
        k3 = _slope(q + 0.5 * STEP * k2, 0.5 * (a + b))
        k4 = _slope(q + STEP * k3, b)
        q = q + STEP / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        q /= np.linalg.norm(q, axis=1, keepdims=True)
    return q


def _slope(q: Float[Array, "k 4"], w: Float[Array, "k 3"]) -> Float[Array, "k 4"]:
    vector = q[:, 3:] * w + np.cross(q[:, :3], w)
    return 0.5 * np.concatenate([vector, -(q[:, :3] * w).sum(1, keepdims=True)], axis=1)
