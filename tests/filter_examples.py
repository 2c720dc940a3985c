"""Sources of filters as a user writes them, for the tests of the command."""

GOOD = '''
import numpy as np
from simval.plugins.protocol import Filter


def cross(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


class Mekf:
    """Attitude world to body as a matrix; bias; errors on the body side."""

    def __init__(self, start, start_std, bias_std, gravity, field, gyroscope_noise,
                 gyroscope_walk, accelerometer_noise, magnetometer_noise):
        self.A, self.b = start.copy(), np.zeros(3)
        self.P = np.diag([start_std**2] * 3 + [bias_std**2] * 3)
        self.N, self.K = gyroscope_noise, gyroscope_walk
        self.r = np.array([0.0, 0.0, gravity]), field
        self.R = np.diag([accelerometer_noise**2] * 3 + [magnetometer_noise**2] * 3)
        self.last = np.zeros(3)

    def update(self, h, rate, force, field):
        now = (rate - self.b) * h
        phi = now + np.cross(self.last, now) / 12.0
        self.last = now
        a = np.linalg.norm(phi)
        X = cross(phi)
        E = np.eye(3) - np.sinc(a / np.pi) * X
        E += 0.5 * np.sinc(a / 2 / np.pi) ** 2 * X @ X
        self.A = E @ self.A
        F = np.eye(6)
        F[:3, :3], F[:3, 3:] = E, -h * (np.eye(3) - X / 2)
        Q = np.diag([self.N**2 * h] * 3 + [self.K**2 * h] * 3)
        P = F @ self.P @ F.T + Q
        p = [self.A @ r for r in self.r]
        H = np.zeros((6, 6))
        H[:3, :3], H[3:, :3] = cross(p[0]), cross(p[1])
        nu = np.concatenate([force - p[0], field - p[1]])
        S = H @ P @ H.T + self.R
        G = np.linalg.solve(S, H @ P).T
        x = G @ nu
        L = np.eye(6) - G @ H
        P = L @ P @ L.T + G @ self.R @ G.T
        self.P = (P + P.T) / 2
        U, _, V = np.linalg.svd((np.eye(3) - cross(x[:3])) @ self.A)
        self.A, self.b = U @ V, self.b + x[3:]
        return {"attitude": self.A.copy(), "covariance": self.P.copy(),
                "bias": self.b.copy(), "innovation": nu, "innovation_covariance": S}


plugin = Filter(
    name="mine", make=Mekf, components="matrix", matrix="active", world="NWU",
    reads=("start", "start_std", "bias_std", "gravity", "field", "gyroscope_noise",
           "gyroscope_walk", "accelerometer_noise", "magnetometer_noise"),
)
'''

BOLD = GOOD.replace('"covariance": self.P.copy()', '"covariance": self.P / 100.0')
BOLD = BOLD.replace('name="mine"', 'name="bold"')

RAISES = GOOD.replace(
    "now = (rate", "raise RuntimeError('no more')\n        now = (rate"
)
HANGS = GOOD.replace("now = (rate", "import time; time.sleep(1e6)\n        now = (rate")
