"""A Kalman filter of attitude and gyroscope bias, all trials at once."""

import numpy as np
from scipy.spatial.transform import Rotation

from simval.plugins import Filter

CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)  # CROSS[i] w = e_i x w


class Mine:
    """The filter of some trials: what it knows, and how a row changes that."""

    def __init__(self, start, gravity, field, **sd):
        self.R = start  # of each trial, body to world
        self.bias, self.before = np.zeros((2, len(start), 3))
        self.up, self.field = np.array([0, 0, gravity]), field
        self.P = variances(sd["start_std"], sd["bias_std"])
        self.Q = variances(sd["gyroscope_noise"], sd["gyroscope_walk"])
        self.noise = variances(sd["accelerometer_noise"], sd["magnetometer_noise"])

    def update(self, dt, gyroscope, accelerometer, magnetometer):
        """Attitude, bias, covariance and innovation after one more row."""
        # turn by the rate less the bias, and let the covariance grow
        step = dt * (gyroscope - self.bias)
        # a rate that changes its axis turns by more than its average: coning
        turn = rotation(step + np.cross(self.before, step) / 12)
        self.before = step
        F = np.tile(np.eye(6), (len(turn), 1, 1))
        F[:, :3, :3], F[:, :3, 3:] = turn.mT, -dt * np.eye(3)
        R, P = self.R @ turn, F @ self.P @ F.mT + dt * self.Q
        # correct by what the two sensors read, less what they should
        up, field = self.up @ R, self.field @ R
        z = np.hstack([accelerometer - up, magnetometer - field])
        H = np.zeros_like(P)
        H[:, :3, :3], H[:, 3:, :3] = cross(up), cross(field)
        S = H @ P @ H.mT + self.noise
        K = np.linalg.solve(S, H @ P).mT
        error = np.matvec(K, z)
        self.R, self.bias = R @ rotation(error[:, :3]), self.bias + error[:, 3:]
        P = P - K @ H @ P
        self.P = (P + P.mT) / 2
        return {
            "attitude": self.R,
            "bias": self.bias,
            "covariance": self.P,
            "innovation": z,
            "innovation_covariance": S,
        }


def cross(v):
    """Matrices X with X w = v x w."""
    return np.tensordot(v, CROSS, 1)


def variances(first, second):
    """Covariance of three errors and three others, from standard deviations."""
    return np.diag(np.square([first] * 3 + [second] * 3))


def rotation(vector):
    """Matrices of rotation vectors."""
    return Rotation.from_rotvec(vector).as_matrix()


mine = Filter(
    name="mine",
    make=Mine,
    batch=True,
    components="matrix",
    matrix="passive",
    world="NWU",
    reads=(
        *("start", "start_std", "bias_std", "gravity", "field"),
        *("gyroscope_noise", "gyroscope_walk"),
        *("accelerometer_noise", "magnetometer_noise"),
    ),
)
