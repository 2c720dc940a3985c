"""Random logs, good and bad: a tumble of holds, and what real hardware does to it.

`good(rng)` draws a sensor, a pose set and its recording; each of `FAULTS`
damages one as one kind of broken sensor, cable or logger would. A fault leaves its
mark where it can do harm: in the holds.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from simval.geometry import normalize
from simval.logs import Log
from simval.poses import fibonacci_sphere, random_directions
from simval.sensor import AccelerometerModel

G = 9.80665
RATE = 100.0


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A recording, the sensor that made it, and its holds as [start, stop) rows."""

    samples: np.ndarray
    sensor: AccelerometerModel
    holds: np.ndarray
    sigma: float

    @property
    def log(self):
        time = np.arange(len(self.samples)) / RATE
        return Log(
            path="log",
            time=time,
            accelerometer=self.samples,
            gyro=None,
            rate=RATE,
        )


def sensor_of(rng, gain=1.0, size=1.0):
    """K within 20 %, misalignments of 0.03, biases of 0.5 m/s^2, both times `size`."""
    angles = 0.03 * size * rng.standard_normal(3)
    scale = rng.uniform(0.8, 1.25, 3) / gain
    bias = rng.uniform(-0.5, 0.5, 3) * gain * size
    return AccelerometerModel.from_parameters(np.concatenate([angles, scale, bias]))


def spread_poses(rng):
    """16 to 36 directions all over the sphere, turned at random, by hand."""
    count = int(rng.integers(16, 37))
    if rng.random() < 0.3:
        directions = random_directions(count + 8, rng)
    else:
        turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        directions = normalize(
            fibonacci_sphere(count) @ turn + 0.1 * rng.standard_normal((count, 3))
        )
    return directions[rng.permutation(len(directions))]


def path_of(directions, rng):
    """Directions of the force, (n, 3): holds of 2 to 4 s, turns of 0.4 to 1 s."""
    first = int(rng.integers(400, 800))
    parts, holds, row = [np.repeat(directions[:1], first, axis=0)], [(0, first)], first
    for before, after in itertools.pairwise(directions):
        steps, hold = int(rng.integers(40, 100)), int(rng.integers(200, 400))
        blend = (1 - np.cos(np.linspace(0, np.pi, steps)))[:, None] / 2
        swing = np.sin(np.pi * blend) * rng.normal(size=3)
        turn = normalize(before + blend * (after - before) + 0.3 * swing)
        parts += [turn + 0.2 * swing, np.repeat(after[None], hold, axis=0)]
        holds.append((row + steps, row + steps + hold))
        row += steps + hold
    return np.concatenate(parts), np.array(holds)


def good(rng, size=1.0, poses=spread_poses):
    """A good log: m/s^2, or counts of 12 to 16 bits over 2 to 8 g.

    Its noise is a third of a count or more; of less see `coarse`.
    """
    counts = rng.random() < 0.5
    gain = 2.0 ** rng.integers(11, 16) / (rng.choice([2, 4, 8]) * G) if counts else 1.0
    sensor = sensor_of(rng, gain, size)
    # less leaves rests of one value, which set no threshold
    sigma = max(10 ** rng.uniform(-2.5, -1.3), 0.3 / gain if counts else 0.0)
    force, holds = path_of(poses(rng), rng)
    raw = sensor.distort(G * force, rng)
    raw = raw + sigma * gain * rng.standard_normal(raw.shape)
    if counts:
        raw = np.round(raw) + (32768.0 if rng.random() < 0.3 else 0.0)
        shift = raw.mean() > 16000
        bias = sensor.B + (32768.0 if shift else 0.0)
        sensor = AccelerometerModel(T=sensor.T, K=sensor.K, B=bias)
    return Recorded(samples=raw, sensor=sensor, holds=holds, sigma=sigma * gain)


def coarse(rng, least, most):
    """A log in counts whose noise is far below one, `least` to `most` of it."""
    gain = 2.0 ** rng.integers(11, 16) / (rng.choice([2, 4, 8]) * G)
    sensor = sensor_of(rng, gain)
    sigma = rng.uniform(least, most)
    force, holds = path_of(spread_poses(rng), rng)
    raw = sensor.distort(G * force, rng)
    raw = np.round(raw + sigma * rng.standard_normal(raw.shape))
    return Recorded(samples=raw, sensor=sensor, holds=holds, sigma=sigma)


FAULTS = {}
"""By name: what damages a recording; it is given a copy of the rows."""


def with_rows(rec, rows):
    """The same recording with other rows."""
    return replace(rec, samples=rows)


def _fault(damage):
    def damaged(rec, rng):
        found = damage(rec, rng, rec.samples.copy())
        return found if isinstance(found, Recorded) else with_rows(rec, found)

    FAULTS[damage.__name__] = damaged
    return damaged


def _gain(rec):
    return 1.0 / float(np.mean(np.abs(rec.sensor.K)))  # raw units per m/s^2


def _middle(rec, rng):
    # a row somewhere between a third and two thirds of the holds
    k = int(rng.integers(len(rec.holds) // 3, 2 * len(rec.holds) // 3))
    return int(rec.holds[k, 0]) - 20


def _some(rec, rng, count=None):
    count = int(rng.integers(1, 4)) if count is None else count
    return rec.holds[1 + rng.choice(len(rec.holds) - 1, count, replace=False)]


@_fault
def dead_axis(rec, rng, x):
    """One axis shows electrical noise about a constant, white or wandering."""
    axis = rng.integers(3)
    n, unit = len(x), _gain(rec)
    noise = 10 ** rng.uniform(-3, 0) * unit * rng.standard_normal(n)
    kind = rng.integers(3)
    if kind == 1:
        noise += (
            10 ** rng.uniform(-3, -1)
            * unit
            * np.cumsum(rng.standard_normal(n))
            / np.sqrt(RATE)
        )
    if kind == 2:
        leak = 10 ** rng.uniform(-3, -1)
        noise += leak * (x[:, (axis + 1) % 3] - x[:, (axis + 1) % 3].mean())
    x[:, axis] = rng.uniform(-10, 10) * unit + noise
    return x


@_fault
def stuck_axis(rec, rng, x):
    """One axis shows one value for ever."""
    x[:, rng.integers(3)] = rng.choice([0.0, 1.0, -32768.0, 5.3 * _gain(rec)])
    return x


@_fault
def stuck_from(rec, rng, x):
    """One axis stops at a value half-way."""
    row, axis = _middle(rec, rng), rng.integers(3)
    x[row:, axis] = x[row, axis]
    return x


@_fault
def wrap(rec, rng, x):
    """Some axes wrap around at a span from 0.6 of the sphere's to eight times it."""
    axes = rng.choice(3, int(rng.integers(1, 4)), replace=False)
    if _gain(rec) < 10:  # m/s^2: any span
        span = 2 * G * rng.uniform(0.6, 8)
    else:
        span = 2.0 ** np.ceil(np.log2(2 * G * _gain(rec) * rng.uniform(0.6, 8)))
    for axis in axes:
        low, high = np.quantile(x[:, axis], [0.02, 0.98])
        start = rng.uniform(low, high)
        if _gain(rec) >= 10:
            start = np.round(start)
        x[:, axis] = (x[:, axis] - start) % span + rng.choice([start, -span / 2, 0.0])
    return x


@_fault
def wrap_signed(rec, rng, x):
    """Unsigned counts of 8, 12 or 16 bits read as signed ones."""
    bits = int(rng.choice([8, 12, 16]))
    full = 2.0**bits
    reach = rng.choice([1.5, 2.0, 4.0]) * G  # m/s^2 at full scale
    counts = np.round((rec.samples - rec.sensor.B) / _gain(rec) / reach * full / 2)
    counts += np.round(rng.normal(0, 0.02, 3) * full)
    scale = rec.sensor.K * _gain(rec) * reach / full * 2
    sensor = AccelerometerModel(T=rec.sensor.T, K=scale, B=np.zeros(3))
    wrapped = counts % full - rng.choice([0.0, full / 2])
    return replace(rec, samples=wrapped, sensor=sensor)


@_fault
def clipped(rec, rng, x):
    """One axis, or all, cut at 0.7 to 0.97 of g, in numbers or before the noise."""
    x -= rec.sensor.B
    axes = [int(rng.integers(3))] if rng.random() < 0.5 else [0, 1, 2]
    level = rng.uniform(0.7, 0.97) * G * _gain(rec)
    for axis in axes:
        x[:, axis] = np.clip(x[:, axis], -level, level)
        if rng.random() < 0.5:
            x[:, axis] += rec.sigma * rng.standard_normal(len(x))
    return x + rec.sensor.B


@_fault
def units(rec, rng, x):
    """m/s^2 become g, mg, ft/s^2 or the reverse half-way."""
    row = _middle(rec, rng)
    x[row:] = x[row:] * rng.choice([1 / G, 1000 / G, 3.28084, G, 1 / 16.0])
    return x


@_fault
def gain_change(rec, rng, x):
    """The gain of one axis, or of all, changes half-way by 2 % to a factor of 4."""
    row = _middle(rec, rng)
    axes = [int(rng.integers(3))] if rng.random() < 0.5 else [0, 1, 2]
    x[row:, axes] *= np.exp(rng.choice([-1, 1]) * 10 ** rng.uniform(-1.7, 0.14))
    return x


@_fault
def bias_jump(rec, rng, x):
    """The bias of one axis jumps half-way by 0.2 to 5 m/s^2."""
    row = _middle(rec, rng)
    x[row:, rng.integers(3)] += (
        rng.choice([-1, 1]) * 10 ** rng.uniform(-0.7, 0.7) * (_gain(rec))
    )
    return x


@_fault
def sign_flip(rec, rng, x):
    """One axis, or all, change sign half-way."""
    row = _middle(rec, rng)
    axes = [int(rng.integers(3))] if rng.random() < 0.7 else [0, 1, 2]
    x[row:, axes] *= -1
    return x


@_fault
def same_channel(rec, rng, x):
    """Two axes are the same wire, with a gain and noise of their own."""
    one, two = rng.choice(3, 2, replace=False)
    x[:, two] = x[:, one]
    if rng.random() < 0.6:
        x[:, two] = rng.choice([1.0, -1.0, 0.9]) * x[:, one]
        x[:, two] += 2 * rec.sigma * rng.standard_normal(len(x))
    return x


@_fault
def swapped_axes(rec, rng, x):
    """Two axes change places half-way."""
    row = _middle(rec, rng)
    one, two = rng.choice(3, 2, replace=False)
    x[row:, [one, two]] = x[row:, [two, one]]
    return x


@_fault
def repeated_block(rec, rng, x):
    """A buffer of 1 to 20 s is written twice, over what came later."""
    size = int(rng.integers(100, 2000))
    a, b = rng.integers(0, len(x) - size, 2)
    x[b : b + size] = rec.samples[a : a + size]
    return x


@_fault
def frozen_sensor(rec, rng, x):
    """The sensor stops in a turn and stays there for some seconds."""
    for start, stop in _some(rec, rng):
        row = int(start - rng.integers(10, 30))
        x[row:stop] = x[row]
    return x


@_fault
def frozen_axis(rec, rng, x):
    """One axis stops in a turn and stays there for some seconds."""
    axis = rng.integers(3)
    for start, stop in _some(rec, rng):
        row = int(start - rng.integers(10, 30))
        x[row:stop, axis] = x[row, axis]
    return x


@_fault
def zero_rows(rec, rng, x):
    """Lost packets are written as zeros: single rows, or seconds of them."""
    if rng.random() < 0.5:
        x[rng.random(len(x)) < 10 ** rng.uniform(-4, -1)] = 0.0
    else:
        for start, stop in _some(rec, rng):
            x[start - 10 : stop + 10] = 0.0
    return x


@_fault
def spikes(rec, rng, x):
    """Single rows far off, on one axis."""
    axis = rng.integers(3)
    hit = rng.random(len(x)) < 10 ** rng.uniform(-4, -1.5)
    x[hit, axis] += 10 ** rng.uniform(-1, 2) * _gain(rec) * rng.choice([-1, 1])
    return x


@_fault
def lost_packets(rec, rng, x):
    """Rows are missing, and nobody counted them."""
    keep = rng.random(len(rec.samples)) > 0.1
    for start, stop in _some(rec, rng):
        keep[start - 40 : stop - 120] = False
    return x[keep]


@_fault
def pushed(rec, rng, x):
    """One to three holds pushed, dropped or on a shaking table: 0.5 to 5 m/s^2 off."""
    for start, stop in _some(rec, rng):
        push = normalize(rng.standard_normal(3)) * rng.uniform(0.5, 5) * _gain(rec)
        x[start:stop] += np.round(push) if _gain(rec) > 10 else push
    return x


def wrong(rec, fit):
    """Whether the answer is wrong beyond its error bars: any true value farther off
    than six of its standard deviations and than 0.3 % of K, 0.003 rad, 0.03 m/s^2."""
    K = np.abs(rec.sensor.K)
    floor = np.concatenate([np.full(3, 3e-3), 3e-3 * K, 0.03 / K])
    off = np.abs(fit.parameters - rec.sensor.parameters)
    # the sign of an axis cannot be seen: a mirrored sensor is the same ellipsoid
    return bool(np.any((off > 6 * fit.sd) & (off > floor)))
