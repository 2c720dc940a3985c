"""Sound attitude filters of every convention, and readings to step them through.

Their conversions share nothing with the package's: attitudes are matrices, quaternions
are SciPy's, and worlds are spelled out here once more.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from simval.imu.filters.signals import FilterInput, Told
from simval.plugins.protocol import Filter

GRAVITY = 9.81
FIELD = 5e-5 * np.array([np.cos(1.1), 0.0, -np.sin(1.1)])  # NWU

# east, north and up of each world, as its name says
_AXES = {"N": (0, 1, 0), "S": (0, -1, 0), "E": (1, 0, 0), "W": (-1, 0, 0)}
_AXES |= {"U": (0, 0, 1), "D": (0, 0, -1)}
WORLDS = ("NWU", "ENU", "SEU", "WSU", "NED", "ESD", "SWD", "WND")


def from_enu(world):
    """Matrix from east, north, up to a world, whose name lists its axes."""
    return np.array([_AXES[letter] for letter in world], dtype=float)


def from_nwu(world):
    return from_enu(world) @ from_enu("NWU").T


def told(**changes):
    values = {
        "gyroscope_noise": 2e-4,
        "gyroscope_walk": 2e-5,
        "accelerometer_noise": 0.02,
        "magnetometer_noise": 2.5e-7,
        "gravity": GRAVITY,
        "field": FIELD,
        "start_std": 0.05,
        "bias_std": 1e-3,
    }
    return Told(**{**values, **changes})


def cross(v):
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def turned(v):
    """Rodrigues' formula: SciPy's `from_rotvec(v).as_matrix()`."""
    angle = math.sqrt(float(v @ v))
    X = cross(v)
    return (
        np.eye(3)
        + np.sinc(angle / np.pi) * X
        + (np.sinc(angle / (2 * np.pi)) ** 2 / 2 * (X @ X))
    )


def spelled(A, components, matrix):
    """An attitude matrix, world to body, as a filter writes it."""
    M = A if matrix == "active" else np.swapaxes(A, -1, -2)
    if components == "matrix":
        return M.copy()
    if M.ndim > 2:
        q = Rotation.from_matrix(M).as_quat()
        return np.roll(q, 1, axis=-1) if components == "sxyz" else q
    x, y, z, s = quaternion_of(M.tolist())
    return np.array([s, x, y, z] if components == "sxyz" else [x, y, z, s])


def quaternion_of(M):
    """SciPy's `from_matrix` of one, which it takes a tenth of the time for."""
    (a, b, c), (d, e, f), (g, h, i) = M
    four = [1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i]
    most = four.index(max(four))
    rows = [
        (four[0], b + d, c + g, h - f),
        (b + d, four[1], f + h, c - g),
        (c + g, f + h, four[2], d - b),
        (h - f, c - g, d - b, four[3]),
    ]
    size = 2.0 * math.sqrt(four[most])
    return [v / size for v in rows[most]]


def understood(q, components, matrix):
    """The attitude matrix, world to body, that a filter writes so."""
    if components == "matrix":
        M = np.asarray(q)
    else:
        last = np.roll(q, -1, axis=-1) if components == "sxyz" else q
        M = Rotation.from_quat(last).as_matrix()
    return M if matrix == "active" else np.swapaxes(M, -1, -2)


def tumbling(trials, rows, rate=100.0, seed=1, noise=True):
    """Readings over smooth turns, with their exact attitudes, (n, T, 3, 3) from NWU."""
    rng = np.random.default_rng(seed)
    dt, t = 1.0 / rate, (np.arange(rows) + 1) / rate
    phase = rng.uniform(0.0, 2 * np.pi, (trials, 1, 3))
    turns = dt * 0.5 * np.sin(t[:, None] * [0.7, 1.1, 1.3] + phase)  # rad, of each step
    first = Rotation.random(trials, rng).as_matrix()
    A = np.empty((trials, rows, 3, 3))
    now = first
    for k in range(rows):
        now = Rotation.from_rotvec(-turns[:, k]).as_matrix() @ now
        A[:, k] = now
    known = told()
    sizes = (known.gyroscope_noise * np.sqrt(rate), 0.02, 2.5e-7)
    clean = (turns / dt, A @ [0.0, 0.0, GRAVITY], A @ FIELD)
    w, f, m = (
        c + noise * s * rng.standard_normal(c.shape)
        for c, s in zip(clean, sizes, strict=True)
    )
    given = FilterInput(
        dt=np.full(rows, dt),
        gyroscope=w,
        accelerometer=f,
        magnetometer=m,
        start=Rotation.from_matrix(np.swapaxes(first, 1, 2)).as_quat(),
        told=known,
    )
    return given, A


class Kalman:
    """A multiplicative Kalman filter with a bias, error on the body side."""

    def __init__(self, *, world="NWU", components="xyzs", matrix="passive", **reads):
        self.world, self.form = world, (components, matrix)
        self.side, self.sign = reads.pop("side", "body"), reads.pop("sign", 1.0)
        self.A = understood(reads["start"], components, matrix)
        self.b = np.zeros(3)
        self.P = np.diag([reads["start_std"] ** 2] * 3 + [reads["bias_std"] ** 2] * 3)
        self.N, self.K = reads["gyroscope_noise"], reads["gyroscope_walk"]
        up = from_nwu(world) @ [0.0, 0.0, reads["gravity"]]
        self.r = (up, reads["field"])
        self.R = np.diag(
            [reads["accelerometer_noise"] ** 2] * 3
            + [reads["magnetometer_noise"] ** 2] * 3
        )

    def update(self, dt, w, f, m):
        phi = dt * (w - self.b)
        turn = turned(-phi)
        self.A = turn @ self.A
        F = np.eye(6)
        F[:3, :3], F[:3, 3:] = turn, -dt * np.eye(3)
        Q = np.diag([self.N**2 * dt] * 3 + [self.K**2 * dt] * 3)
        P = F @ self.P @ F.T + Q
        predicted = [self.A @ r for r in self.r]
        # truth is turned on by e: A = (I - [e x]) A_hat
        H = np.hstack([np.vstack([cross(p) for p in predicted]), np.zeros((6, 3))])
        S = H @ P @ H.T + self.R
        gain = np.linalg.solve(S, H @ P).T
        innovation = np.concatenate([self.sign * f, m]) - np.concatenate(predicted)
        x = gain @ innovation
        left = np.eye(6) - gain @ H
        P = left @ P @ left.T + gain @ self.R @ gain.T
        self.P = (P + P.T) / 2
        self.A = turned(-x[:3]) @ self.A
        self.b = self.b + x[3:]
        P = self.P
        if self.side == "reference":
            turn = np.eye(6)
            turn[:3, :3] = self.A.T
            P = turn @ P @ turn.T
        return {
            "attitude": spelled(self.A, *self.form),
            "covariance": P,
            "bias": self.b,
            "innovation": innovation,
            "innovation_covariance": S,
        }


KALMAN_READS = (
    "start",
    "start_std",
    "bias_std",
    "gravity",
    "field",
    "gyroscope_noise",
    "gyroscope_walk",
    "accelerometer_noise",
    "magnetometer_noise",
)


def kalman(
    world="NWU", components="xyzs", matrix="passive", side="body", force=1.0, **more
):
    """The Kalman filter as a plug-in that is rightly declared."""

    def make(**reads):
        form = {"world": world, "components": components, "matrix": matrix}
        return Kalman(**form, side=side, sign=force, **reads)

    meaning = "specific force" if force > 0.0 else "gravity"
    declared = {
        "name": "kalman",
        "components": components,
        "matrix": matrix,
        "world": world,
        "side": side,
        "accelerometer": meaning,
        "reads": KALMAN_READS,
    }
    return Filter(**{**declared, "make": make, **more})


class Complementary:
    """Gyroscope, and a share of the turn that accelerometer and magnetometer want."""

    def __init__(self, world="NWU", form=("xyzs", "passive"), share=0.02, start=None):
        self.form, self.share = form, share
        self.C = from_nwu(world)
        self.A = np.eye(3) if start is None else understood(start, *form)

    def update(self, dt, w, f, m=None):
        self.A = turned(-dt * w) @ self.A
        up = f / np.linalg.norm(f)
        error = cross(up) @ self.A @ self.C[:, 2]
        if m is not None:
            west = cross(up) @ m
            west /= np.linalg.norm(west)
            error = error + cross(west) @ self.A @ self.C[:, 1]
        self.A = turned(-self.share * error) @ self.A
        return spelled(self.A, *self.form)
