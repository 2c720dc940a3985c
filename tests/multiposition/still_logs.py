"""Random logs of two or three sensors: some rests turn slowly, those of twins do not.

The motion is one law of time; the twin of a log has the same sensors, noise, holds and
turns between them, and no rest that turns.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from simval.logs import Log
from simval.poses import fibonacci_sphere
from simval.sensor import AccelerometerModel, GyroscopeModel

G = 9.80665
FIELD = np.array([0.0, 20e-6, -44e-6])  # T, world axes


@dataclass(frozen=True, kw_only=True)
class Still:
    """A log, its sensors, its holds as [start, stop) rows, and where these turn."""

    log: Log
    accelerometer: AccelerometerModel
    gyroscope: GyroscopeModel
    holds: np.ndarray
    turning: np.ndarray  # bool, of each row: in a hold, and turned by what is hidden
    rate_std: float  # rad/s, noise of a row


def _linear(rng):
    return np.eye(3) + 0.03 * rng.standard_normal((3, 3))


def _blend(n):
    s = (np.arange(n) + 1.0) / n
    return s - np.sin(2 * np.pi * s) / (2 * np.pi)  # starts and ends at rest


def _hidden(rng, n, share):
    """Angle by which a hold of n rows turns, from 0: all the time, at one end only."""
    rate = np.radians(0.3 * 40.0 ** rng.random()) * rng.choice([-1.0, 1.0])
    part = int(n * rng.choice([1.0, share, share]))
    first = int(rng.choice([0, n - part]))
    speed = np.zeros(n)
    speed[first : first + part] = rate
    return np.cumsum(speed)


def draw(seed, *, turning=True, most=5):
    """Log of a seed; the twin of a log that turns is that of the same seed."""
    rng = np.random.default_rng([320, seed])
    hz = float(rng.choice([50.0, 100.0, 200.0]))
    count = int(rng.integers(16, 31))
    turn = Rotation.random(rng=rng).as_matrix()
    down = fibonacci_sphere(count) @ turn
    down = down[rng.permutation(count)]
    heading = rng.uniform(-np.pi, np.pi, count)
    bad = rng.choice(count, int(rng.integers(1, most + 1)), replace=False)
    parts, marks, holds, row = [], [], [], 0
    now = None
    for k in range(count):
        level, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [down[k]])
        target = Rotation.from_rotvec([0.0, 0.0, heading[k]]) * level
        steps = int(hz * rng.uniform(0.6, 2.0))
        hold = int(hz * (rng.uniform(5.0, 10.0) if k == 0 else rng.uniform(2.4, 5.0)))
        tilt = np.append(np.radians(rng.normal(0.0, 0.3, 2)), 1.0)
        angle = _hidden(rng, hold, rng.uniform(0.15, 0.6))
        if now is not None:
            step = (target * now.inv()).as_rotvec()
            parts.append(Rotation.from_rotvec(_blend(steps)[:, None] * step) * now)
            marks.append(np.zeros(steps, bool))
            row += steps
        if not (turning and k in bad):
            angle = np.zeros(hold)
        angle = angle / hz
        parts.append(Rotation.from_rotvec(angle[:, None] * tilt) * target)
        marks.append(np.diff(angle, prepend=0.0) != 0.0)
        holds.append((row, row + hold))
        row += hold
        now = parts[-1][-1]
    path = Rotation.concatenate(parts)
    return _read(rng, hz, path, np.array(holds), np.concatenate(marks))


def _read(rng, hz, path, holds, turning):
    n = len(path)
    time = np.arange(n) / hz
    acc = AccelerometerModel.from_parameters(
        np.concatenate(
            [
                0.02 * rng.standard_normal(3),
                rng.uniform(0.95, 1.05, 3),
                rng.normal(0, 0.2, 3),
            ]
        )
    )
    gyro = GyroscopeModel(M=_linear(rng), B=np.radians(rng.normal(0.0, 1.0, 3)))
    true = np.zeros((n, 3))
    true[1:] = (path[:-1].inv() * path[1:]).as_rotvec() * hz
    force = path.inv().apply([0.0, 0.0, G])
    rate_std = np.radians(10 ** rng.uniform(-2.0, -0.4)) * np.sqrt(hz / 100.0)
    rates = gyro.distort(true, rng) + rate_std * rng.standard_normal((n, 3))
    raw = acc.distort(force, rng)
    raw += 10 ** rng.uniform(-2.5, -1.3) * rng.standard_normal((n, 3))
    kind = rng.integers(4)
    t = time[:, None] / time[-1]
    if kind == 1:  # the bias drifts: a line, a warming up, a random walk
        rates += np.radians(rng.normal(0.0, 0.3, 3)) * t
        rates += np.radians(rng.normal(0.0, 0.2, 3)) * np.exp(-time / 40.0)[:, None]
    walk = np.radians(10 ** rng.uniform(-3.5, -2.5)) * rng.standard_normal((n, 3))
    if kind == 2:
        rates += np.cumsum(walk, axis=0) / np.sqrt(hz)
    if kind == 3:  # a table that shakes, in some holds more than in others
        size = np.repeat(10 ** rng.uniform(-2, 0.5, len(holds)), np.diff(holds)[:, 0])
        inside = np.concatenate([np.arange(a, b) for a, b in holds])
        f, phase = rng.uniform(0.15, 0.45, 3) * hz, rng.uniform(0, 6.3, 3)
        wave = np.sin(2 * np.pi * f * time[:, None] + phase)
        rates[inside] += rate_std * size[:, None] * wave[inside]
    field = path.inv().apply(FIELD) @ _linear(rng).T + 1e-5 * rng.standard_normal(3)
    field += 10 ** rng.uniform(-7.5, -6.3) * rng.standard_normal((n, 3))
    log = Log(
        path="log",
        time=time,
        accelerometer=raw,
        gyro=rates,
        magnetometer=field if rng.random() < 0.5 else None,
        rate=hz,
    )
    return Still(
        log=log, accelerometer=acc, gyroscope=gyro, holds=holds, turning=turning,
        rate_std=rate_std,
    )  # fmt: skip
