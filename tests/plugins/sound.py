"""Sound algorithms: of each kind one to be spoilt, and filters of every convention.

Conversions of filters share nothing with the package's: attitudes are matrices,
quaternions are SciPy's, and worlds are spelled out here once more.
"""

import math
from dataclasses import replace

import numpy as np
from places import EXAMPLES
from scipy.spatial.transform import Rotation

from simval.account.terminal import lines
from simval.geometry import compose, normalize
from simval.imu.attitude.comparators import davenport
from simval.imu.filters.mekf import Mekf
from simval.imu.filters.signals import FilterInput, Told
from simval.plugins import Calibrator, Estimator, Filter, find_plugin

GRAVITY = 9.81
FIELD = 5e-5 * np.array([np.cos(1.1), 0.0, -np.sin(1.1)])  # NWU
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
OWN = find_plugin("simval:mekf", Filter)
PASSIVE = {"components": "xyzs", "matrix": "passive"}
GOOD = Estimator(name="good", estimate=davenport, **PASSIVE)
ellipsoid = find_plugin(str(EXAMPLES / "ellipsoid.py"), Calibrator).calibrate


def said_of(found):
    """All that a check says, one blank between its words."""
    return " ".join("\n".join(lines(found.account, verbose=True)).split())


def leading(b1, b2, r1, r2, noise_std, factor=1.0):
    """Leading covariance of Davenport's answer."""
    size = (b1**2 + b2**2).sum(axis=1)[:, None, None]
    H = size * np.eye(3) - b1[:, :, None] * b1[:, None] - b2[:, :, None] * b2[:, None]
    return factor * noise_std**2 * np.linalg.inv(H)


def turn(q, angle, axis=(1.0, 0.0, 0.0)):
    """Attitudes turned on, each by its angle."""
    half = np.broadcast_to(angle, len(q))[:, None] / 2.0
    more = np.concatenate([np.sin(half) * np.array(axis), np.cos(half)], axis=1)
    return compose(q, more)


def where(q, mask, other):
    return np.where(np.asarray(mask)[:, None], other, q)


# east, north and up of each world, as its name says
_AXES = {"N": (0, 1, 0), "S": (0, -1, 0), "E": (1, 0, 0), "W": (-1, 0, 0)}
_AXES |= {"U": (0, 0, 1), "D": (0, 0, -1)}
WORLDS = ("NWU", "ENU", "SEU", "WSU", "NED", "ESD", "SWD", "WND")


def from_nwu(world):
    """Matrix from NWU to a world, whose name lists its axes."""
    own, nwu = (np.array([_AXES[letter] for letter in each]) for each in (world, "NWU"))
    return (own @ nwu.T).astype(float)


def told(**changes):
    """What a filter is told of sensors and field."""
    known = {
        "gyroscope_noise": 2e-4,
        "gyroscope_walk": 2e-5,
        "accelerometer_noise": 0.02,
        "magnetometer_noise": 2.5e-7,
        "gravity": GRAVITY,
        "field": FIELD,
        "start_std": 0.05,
        "bias_std": 1e-3,
    }
    return Told(**(known | changes))


def cross(v):
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def turned(v):
    """Rodrigues' formula, a tenth of the time of SciPy's."""
    angle, X = math.sqrt(float(v @ v)), cross(v)
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * X + half**2 / 2 * (X @ X)


def spelled(A, components, matrix):
    """An attitude matrix, world to body, as a filter writes it."""
    M = A if matrix == "active" else A.T
    if components == "matrix":
        return M.copy()
    return Rotation.from_matrix(M).as_quat(scalar_first=components == "sxyz")


def understood(q, components, matrix):
    """The attitude matrix, world to body, that a filter writes so."""
    M = q
    if components != "matrix":
        M = Rotation.from_quat(q, scalar_first=components == "sxyz").as_matrix()
    return M if matrix == "active" else M.T


def tumbling(trials, rows, rate=100.0, seed=1, noise=True):
    """Readings over smooth turns, with their exact attitudes, (n, T, 3, 3) from NWU."""
    rng = np.random.default_rng(seed)
    dt, t = 1.0 / rate, (np.arange(rows) + 1) / rate
    phase = rng.uniform(0.0, 2 * np.pi, (trials, 1, 3))
    turns = dt * 0.5 * np.sin(t[:, None] * [0.7, 1.1, 1.3] + phase)  # rad, of each step
    first = Rotation.random(trials, rng).as_matrix()
    A, now = np.empty((trials, rows, 3, 3)), first
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
        dt=np.full(rows, dt), gyroscope=w, accelerometer=f, magnetometer=m,
        start=Rotation.from_matrix(np.swapaxes(first, 1, 2)).as_quat(), told=known,
    )  # fmt: skip
    return given, A


class Rate:
    """Integrates the rate, of one trial or of many."""

    def __init__(self, start=IDENTITY):
        self.q, self.k = start.copy(), -1

    def step(self, dt, w):
        self.k += 1
        turn = np.concatenate([dt * w / 2.0, np.ones((*w.shape[:-1], 1))], axis=-1)
        self.q = normalize(compose(self.q, turn))
        return self.q.copy()

    def update(self, dt, w, f, m):
        return self.step(dt, w)


def filtering(make, **more):
    """A filter that is declared as `Rate` is."""
    given = {"name": "wrong", **PASSIVE, "reads": ("start",)}
    return Filter(**{**given, "make": make, **more})


def converted(world, form, side="body", meaning="specific force", spoil=None):
    """The package's filter, its readings and answers in other conventions."""
    C, sign = from_nwu(world), 1.0 if meaning == "specific force" else -1.0

    class Converted:
        def __init__(self, start, field, **reads):
            start = spelled(understood(start, *form) @ C, *PASSIVE.values())
            self.own = Mekf(start=start, field=C.T @ field, **reads)

        def update(self, dt, w, f, m):
            found = dict(self.own.update(dt, w, sign * f, m))
            A = understood(found["attitude"], *PASSIVE.values()) @ C.T
            found["attitude"] = spelled(A, *form)
            if side == "reference":
                turn = np.eye(6)
                turn[:3, :3] = A.T
                found["covariance"] = turn @ found["covariance"] @ turn.T
            return spoil(found) if spoil else found

    declared = dict(zip(("components", "matrix"), form, strict=True))
    return replace(
        OWN, name="mine", make=Converted, world=world, side=side,
        accelerometer=meaning, batch=False, **declared,
    )  # fmt: skip


class Complementary:
    """Gyroscope, and a share of the turn that accelerometer and magnetometer want."""

    def __init__(self, world, form, share=0.02, start=None):
        self.form, self.share, self.C = form, share, from_nwu(world)
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


class Compass:
    """Up and north of each row, with no memory: the rate is not asked."""

    def __init__(self, world, form, sign):
        self.C, self.form, self.sign = from_nwu(world), form, sign

    def update(self, dt, w, f, m):
        up = self.sign * f / np.linalg.norm(f)
        west = cross(up) @ m
        west /= np.linalg.norm(west)
        north = cross(west) @ up
        return spelled(np.stack([north, west, up], axis=1) @ self.C.T, *self.form)
