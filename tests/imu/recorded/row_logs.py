"""Simulated logs whose gyroscope has rows of each kind, with real accelerations."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

G = 9.80665
MOTIONS = {  # Hz from and to, rad/s
    "handheld": ((0.15, 1.5), 1.5),
    "multirotor": ((1.5, 6.0), 0.8),
    "slow": ((0.02, 0.15), 0.3),
}


def waves(rng, low, high, size, terms=8):
    """A smooth function of time of so many terms a component, and its RMS length."""
    pace = 2.0 * np.pi * np.exp(rng.uniform(np.log(low), np.log(high), (terms, 3)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (terms, 3))
    sizes = rng.standard_normal((terms, 3))
    sizes *= size / np.sqrt(np.sum(sizes**2) / 2.0)
    return lambda t: np.sum(sizes * np.sin(pace * t[:, None, None] + phase), axis=1)


def swings(rng, pace, size):
    """Three harmonics of a gait, one above the other."""
    k, phase = np.arange(1.0, 4.0)[:, None], rng.uniform(0.0, 6.0, (3, 3))
    sizes = size * rng.standard_normal((3, 3)) / k
    return lambda t: np.sum(sizes * np.sin(pace * t[:, None, None] * k + phase), axis=1)


@dataclass(frozen=True, kw_only=True)
class Body:
    """Attitudes body to world, and where the sensor is, m."""

    attitude: Callable
    place: Callable = lambda t: np.zeros((len(t), 3))
    felt: Callable | None = None  # the specific force, where that is known instead

    def rate(self, t, d=2e-4):
        """Body rate of an instant, rad/s."""
        turn = self.attitude(t - d).inv() * self.attitude(t + d)
        return turn.as_rotvec() / (2.0 * d)

    def mean(self, t, h):
        """Mean rate over the step that begins at t, by turns of a millisecond."""
        count = max(4, int(np.ceil(h / 1.5e-3)))
        edges = [self.attitude(t + k * h / count) for k in range(count + 1)]
        d = np.array([(a.inv() * b).as_rotvec() for a, b in pairwise(edges)])
        return (d.sum(axis=0) - np.cross(d[:-1], d[1:]).sum(axis=0) / 12.0) / h

    def rows(self, t, h, kind, delay=0.0):
        """Rows of a gyroscope."""
        s = t - delay
        if kind == "instant":
            return self.rate(s)
        return self.mean(s - h if kind == "before" else s, h)

    def force(self, t, more=0.0, d=2e-3):
        """Specific force, m/s^2, with what else acts in the world."""
        if self.felt is not None:
            return self.felt(t)
        p = [self.place(t + k * d) for k in (-1, 0, 1)]
        world = (p[0] - 2.0 * p[1] + p[2]) / d**2 + more + [0.0, 0.0, G]
        return self.attitude(t).inv().apply(world)


def moving(motion, seed, arm=0.0):
    """A body that turns with a sensor at the end of an arm, m."""
    rng, (band, size) = np.random.default_rng(seed), MOTIONS[motion]
    first = Rotation.random(random_state=seed)
    middle = 2.0 * np.pi * np.sqrt(band[0] * band[1])
    vector = waves(rng, *band, size / middle)
    lean = waves(rng, 0.05, 0.4, 0.3 if motion == "multirotor" else 0.0, 4)

    def attitude(t):
        return first * Rotation.from_rotvec(vector(t) + lean(t))

    r = rng.standard_normal(3)
    r *= arm / np.linalg.norm(r)
    return Body(attitude=attitude, place=lambda t: attitude(t).apply(r))


def in_step(family, seed):
    """A body whose acceleration is in step with its turning."""
    rng = np.random.default_rng(seed)
    if family == "arm":  # of two parts, which move together and apart
        vector, own = waves(rng, 0.2, 1.5, 0.9), waves(rng, 0.2, 1.5, 0.35)
        lag = rng.uniform(-0.1, 0.1)

        def lower(t):
            return Rotation.from_rotvec(vector(t))

        def upper(t):
            return Rotation.from_rotvec(0.6 * vector(t - lag) + own(t))

        return Body(
            attitude=lower,
            place=lambda t: (
                upper(t).apply([0.3, 0.0, 0.0]) + lower(t).apply([0.25, 0, 0.02])
            ),
        )
    if family == "multirotor":  # pushed along its own axis, to hold its height
        vector = waves(rng, 0.2, 1.5, 0.4)
        pushed = Body(attitude=lambda t: Rotation.from_rotvec(vector(t)))

        def thrust(t):
            up = pushed.attitude(t).as_matrix()[:, 2, 2]
            return (G / np.maximum(up, 0.5))[:, None] * [0.0, 0.0, 1.0]

        return replace(pushed, felt=thrust)
    if family == "vehicle":  # which turns as it goes
        vector, speed = waves(rng, 0.05, 0.4, 1.0), rng.uniform(3.0, 15.0)
        going = Body(
            attitude=lambda t: Rotation.from_rotvec(vector(t) * [0.05, 0.05, 1.0])
        )

        def turning(t):
            level = going.attitude(t).inv().apply([0.0, 0.0, G])
            return level + np.cross(going.rate(t), [speed, 0.0, 0.0])

        return replace(going, felt=turning)
    pace = 2.0 * np.pi * rng.uniform(0.8, 1.1)
    size = {"gait": (0.15, 0.02), "foot": (0.3, 0.15)}[family]
    turn, lean = swings(rng, pace, size[0]), waves(rng, 0.02, 0.1, 0.5, 4)
    return Body(
        attitude=lambda t: Rotation.from_rotvec(turn(t) + lean(t)),
        place=swings(rng, pace, size[1]),
    )


def read(body, kind, rate, seed, *, seconds=60.0, delay=0.0, acceleration=0.0):
    """Stamps, rows of gyroscope and accelerometer with noise and a bias."""
    rng, h = np.random.default_rng([seed, 1]), 1.0 / rate
    t = np.arange(0.0, seconds, h)
    more = waves(rng, 0.2, 2.0, acceleration, 6)(t)
    gyro = body.rows(t, h, kind, delay) + rng.normal(0.0, 0.01, 3)
    gyro = gyro + 2e-4 * np.sqrt(rate) * rng.standard_normal(gyro.shape)
    force = body.force(t, more)
    return t, gyro, force + 0.02 * rng.standard_normal(force.shape)
