"""Bounds of all calibrations, by another way: every attitude is an unknown.

Readings are functions of the sensors and of a small rotation at each rest, the turns
between them are what the gyroscope reads in short steps; derivatives are complex steps
of these functions, and the bound is a part of the inverse of the whole information.
"""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from simval.geometry import attitude_matrix, cross_matrix
from simval.imu.sensor import AccelerometerModel, GyroscopeModel, MagnetometerModel
from simval.theory import (
    MovePath,
    calibration_moments,
    gyroscope_moments,
    magnetometer_moments,
    nine_axis_moments,
)

RESTS, STEPS, G, WALK = 14, 60, 9.8, 2e-4
ACC = AccelerometerModel(
    T=np.array([[1.0, 0.0, 0.0], [0.02, 1.0, 0.0], [-0.03, 0.01, 1.0]]),
    K=np.array([1.05, 0.97, 1.1]), B=np.array([0.2, -0.1, 0.3]),
)  # fmt: skip
GYRO = GyroscopeModel(
    M=np.eye(3) + 0.03 * np.arange(9).reshape(3, 3) / 8, B=np.array([0.01, 0.02, -0.01])
)
IRON = MagnetometerModel(
    M=np.diag([1.1, 0.9, 1.0]) + 0.02, b=np.array([0.1, -0.2, 0.05])
)
Q = Rotation.random(RESTS, rng=np.random.default_rng(8))
A = attitude_matrix(Q.as_quat())
TURNS = (Q[:-1].inv() * Q[1:]).as_rotvec()
PATH = MovePath(
    turns=np.repeat(TURNS[:, None] / STEPS, STEPS, axis=1),
    seconds=np.full((RESTS - 1, STEPS), 2.0 / STEPS),
)
NOISE = {"pose_std": 2e-3, "bias_std": 3e-5, "g": G, "angle_random_walk": WALK}
FIELD_STD, TAU = 4e-3, 2.0 / STEPS


def exponential(v):
    return expm(np.einsum("ajk,...a->...jk", E, v))


E = np.stack([cross_matrix(row) for row in np.eye(3)])
STEP = exponential(TURNS / STEPS)
HALF = exponential(TURNS / STEPS / 2.0)
TURN = exponential(TURNS)


def measured(sensors, theta, small):
    """What these sensors read at small turns of the rests, in units of its noise."""
    off = np.eye(3) + np.einsum("ajk,na->njk", E, small)
    C = np.swapaxes(off, 1, 2) @ A
    T = np.eye(3, dtype=complex)
    T[1, 0], T[2, 0], T[2, 1] = theta[0], -theta[1], theta[2]
    M = T @ np.diag(theta[3:6])
    force = G * np.linalg.solve(M, C[:, :, 2].T).T + theta[6:9]
    read = [force / NOISE["pose_std"]]
    if "magnetometer" in sensors:
        field = C @ np.array([np.cos(theta[33]), 0.0, -np.sin(theta[33])])
        field = np.linalg.solve(theta[21:30].reshape(3, 3), field.T).T + theta[30:33]
        read.append(field / FIELD_STD)
    if "gyroscope" in sensors:
        raw = np.linalg.solve(GYRO.M, TURNS.T / STEPS).T + GYRO.B * TAU
        # the same in all steps of a move
        step = (raw - theta[18:21] * TAU) @ theta[9:18].reshape(3, 3).T
        by_gyro = np.linalg.matrix_power(exponential(step), STEPS)
        by_rests = np.swapaxes(off[:-1], 1, 2) @ TURN @ off[1:]
        apart = (by_gyro - by_rests) @ np.swapaxes(TURN, 1, 2)
        angle = np.stack([apart[:, 2, 1], apart[:, 0, 2], apart[:, 1, 0]], axis=1)
        read.append(np.linalg.solve(ROOT, angle[..., None]))
        read.append((theta[18:21] - GYRO.B) / NOISE["bias_std"])
    return np.concatenate([part.ravel() for part in read])


def angle_root():
    """Of the covariance of the angle of each move, by its steps' middles."""
    covariance, so_far = 0.0, np.broadcast_to(np.eye(3), TURN.shape)
    for _ in range(STEPS):
        middle = so_far @ HALF @ GYRO.M
        covariance = covariance + WALK**2 * TAU * middle @ np.swapaxes(middle, 1, 2)
        so_far = so_far @ STEP
    return np.linalg.cholesky(covariance)


ROOT = angle_root()


PLACES = {"gyroscope": range(9, 21), "magnetometer": range(21, 34)}


def found(sensors, dip):
    """The bound by theory."""
    if "gyroscope" in sensors and "magnetometer" in sensors:
        given = Q.as_quat(), dip, PATH
        return nine_axis_moments(
            GYRO, ACC, IRON, *given, field_std=FIELD_STD, **NOISE
        ).cramer_rao
    if "gyroscope" in sensors:
        return gyroscope_moments(GYRO, ACC, A[:, :, 2], PATH, **NOISE).cramer_rao
    if "magnetometer" in sensors:
        return magnetometer_moments(
            ACC, IRON, Q.as_quat(), dip, accelerometer_std=NOISE["pose_std"],
            magnetometer_std=FIELD_STD, g=G,
        ).covariance  # fmt: skip
    return calibration_moments(ACC, A[:, :, 2], G, NOISE["pose_std"]).cramer_rao


@pytest.mark.parametrize(
    ("sensors", "dip", "limit"),
    [
        ("", 0.0, 1e-10),
        ("magnetometer", 1.05, 1e-9),
        ("magnetometer", -0.6, 1e-9),
        ("magnetometer", 0.0, 1e-9),
        ("magnetometer", 1.48, 1e-9),
        # the steps' middles leave a square of a step, 0.05 rad, over 24
        ("gyroscope", 0.0, 1e-5),
        ("gyroscope magnetometer", 1.1, 1e-5),
    ],
)
def test_every_attitude_unknown(sensors, dip, limit):
    theta = np.concatenate(
        [ACC.parameters, GYRO.M.ravel(), GYRO.B, IRON.M.ravel(), IRON.b, [dip]]
    )
    own = np.r_[0:9, *(PLACES[sensor] for sensor in sensors.split())]
    unknowns = np.concatenate([theta, np.zeros(3 * RESTS)])
    ways = unknowns + 1e-30j * np.eye(len(unknowns))
    J = np.stack(
        [
            measured(sensors, way[:34], way[34:].reshape(RESTS, 3)).imag / 1e-30
            for way in ways
        ],
        axis=1,
    )
    J, others = J[:, own], J[:, 34:]
    # what no change of the attitudes does as well; some of them nobody sees
    J = J - others @ np.linalg.pinv(others, rcond=1e-12) @ J
    unit = 1.0 / np.linalg.norm(J, axis=0)
    expected = np.linalg.inv((J * unit).T @ (J * unit)) * np.outer(unit, unit)
    sd = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        found(sensors, dip) / np.outer(sd, sd), expected / np.outer(sd, sd), atol=limit
    )
    # power: the accelerometer taken as known gives another bound
    if sensors:
        known = np.linalg.inv(np.linalg.inv(expected / np.outer(sd, sd))[9:, 9:])
        assert np.abs(np.diagonal(known) - 1.0).max() > 100 * limit
