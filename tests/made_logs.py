"""Random logs: rests joined by turns, of one sensor or of three, whole or damaged.

`Motion` is a law of time, so that the same motion can be recorded at any rate. `good`
draws a log of an accelerometer; each of `FAULTS` damages one as one kind of broken
sensor, cable or logger would, where it can do harm: in the holds. `three` draws a log
of all sensors, in some rests of which the body turns; its twin has no such rest.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from simval.geometry import normalize
from simval.imu.logs import Log
from simval.imu.sensor import AccelerometerModel, GyroscopeModel, load_imu, read_imu
from simval.poses import fibonacci_sphere, random_directions
from simval.scene import simulate
from simval.scene.trajectory import motion_of, write_signal

G = 9.80665
RATE = 100.0
FIELD = np.array([0.0, 20e-6, -44e-6])  # T, world axes


class Motion:
    """Holds and turns of random length, s; the force points in some directions."""

    def __init__(self, rng, up=24, hold=(2.3, 4.0), turn=(0.5, 2.0), first=4.0):
        if np.ndim(up) == 0:
            up = fibonacci_sphere(up) @ Rotation.random(rng=rng).as_matrix()
            up = rng.permutation(up)
        n = self.count = len(up)
        self.hold, turns = rng.uniform(*hold, n), rng.uniform(*turn, n - 1)
        self.hold[0] = first
        self.start = np.concatenate([[0.0], np.cumsum(self.hold[:-1] + turns)])
        self.stop = self.start + self.hold
        self.push = 0.5 * rng.normal(size=(n - 1, 3))  # m/s^2, while turning
        z = [[0.0, 0.0, 1.0]]
        level = [Rotation.align_vectors(z, each[None])[0] for each in up]
        heading = np.zeros((n, 3))
        heading[:, 2] = rng.uniform(-np.pi, np.pi, n)
        self.rest = Rotation.from_rotvec(heading) * Rotation.concatenate(level)
        # what turns unseen in a hold: about which axis, how fast, from when, how long
        self.slow = np.zeros((n, 3)), np.zeros(n), np.zeros(n)

    def _slow(self, k, t):
        rate, begin, span = (each[k] for each in self.slow)
        return Rotation.from_rotvec(rate * np.clip(t - begin, 0.0, span)[:, None])

    def attitude(self, t):
        """Body to world, and how far a turn is, 0 in a hold."""
        every = np.arange(self.count)
        ends = self._slow(every, self.stop) * self.rest
        step = (self.rest[1:] * ends[:-1].inv()).as_rotvec()
        k = np.clip(np.searchsorted(self.start, t, side="right") - 1, 0, None)
        q = (self._slow(k, t) * self.rest[k]).as_quat()
        s, moves = np.zeros(len(t)), (t > self.stop[k]) & (k < self.count - 1)
        m = k[moves]
        s[moves] = (t[moves] - self.stop[m]) / (self.start[m + 1] - self.stop[m])
        share = s[moves] - np.sin(2 * np.pi * s[moves]) / (2 * np.pi)  # rests at ends
        q[moves] = (Rotation.from_rotvec(share[:, None] * step[m]) * ends[m]).as_quat()
        return Rotation.from_quat(q), s, np.minimum(k, self.count - 2)

    def force(self, t):
        """Specific force in the body's axes, m/s^2."""
        R, s, k = self.attitude(t)
        return (
            R.inv().apply([0.0, 0.0, G])
            + np.sin(np.pi * s)[:, None] ** 2 * (self.push[k])
        )

    def times(self, rate):
        """Times of the rows, and the holds as [start, stop) rows."""
        t = np.arange(0.0, self.stop[-1], 1.0 / rate)
        ends = np.searchsorted(t, [self.start, self.stop + 1e-9])
        return t, ends.T


def noise(rng, n, rate, sigma=0.01, band=None):
    """White noise per row, or of a first-order low-pass of `band` Hz."""
    if band is None:
        return sigma * rng.standard_normal((n, 3))
    keep = np.exp(-2 * np.pi * band / rate)
    lead = int(5 * rate / band)
    white = rng.standard_normal((n + lead, 3))
    return sigma * lfilter([np.sqrt(1 - keep**2)], [1, -keep], white, axis=0)[lead:]


def log_of(time, samples, gyro=None, magnetometer=None):
    """A log of these rows."""
    return Log(
        path="log", time=time, accelerometer=samples, gyro=gyro,
        magnetometer=magnetometer, rate=(len(time) - 1) / (time[-1] - time[0]),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """A recording at 100 Hz, its sensor, and its holds as [start, stop) rows."""

    samples: np.ndarray
    sensor: AccelerometerModel
    holds: np.ndarray
    sigma: float

    @property
    def log(self):
        return log_of(np.arange(len(self.samples)) / RATE, self.samples)


def good(rng, size=1.0, up=None, sigma=None):
    """A good log: m/s^2, or counts of 12 to 16 bits over 2 to 8 g.

    K within 20 %, misalignments of 0.03, biases of 0.5 m/s^2, both times `size`; 16 to
    36 rests all over the sphere, by hand. Its noise is a third of a count or more, or
    `sigma` counts.
    """
    counts = sigma is not None or rng.random() < 0.5
    gain = 2.0 ** rng.integers(11, 16) / (rng.choice([2, 4, 8]) * G) if counts else 1.0
    values = 0.03 * size * rng.standard_normal(3), rng.uniform(0.8, 1.25, 3) / gain
    bias = rng.uniform(-0.5, 0.5, 3) * gain * size
    if up is None:
        count = int(rng.integers(16, 37))
        even = fibonacci_sphere(count) @ Rotation.random(rng=rng).as_matrix()
        by_hand = normalize(even + 0.1 * rng.standard_normal((count, 3)))
        some = random_directions(count + 8, rng) if rng.random() < 0.3 else by_hand
        up = rng.permutation(some)
    motion = Motion(rng, up, (2.0, 4.0), (0.4, 1.0), rng.uniform(4.0, 8.0))
    time, holds = motion.times(RATE)
    sensor = AccelerometerModel.from_parameters(np.concatenate([*values, bias]))
    # less leaves rests of one value, which set no threshold
    least = max(gain * 10 ** rng.uniform(-2.5, -1.3), 0.3 if counts else 0.0)
    sigma = least if sigma is None else sigma
    raw = sensor.distort(motion.force(time), rng)
    raw = raw + sigma * rng.standard_normal(raw.shape)
    if counts:
        offset = 32768.0 if rng.random() < 0.3 else 0.0
        raw, bias = np.round(raw) + offset, bias + offset
        sensor = AccelerometerModel.from_parameters(np.concatenate([*values, bias]))
    return Recorded(samples=raw, sensor=sensor, holds=holds, sigma=sigma)


# what real hardware does to a log

FAULTS = {}
"""By name: what damages a recording; it is given a copy of the rows."""


def _whole(rec, rng, x):
    return x


def _late(rec, rng, x):
    """The rows from somewhere between a third and two thirds of the holds."""
    k = int(rng.integers(len(rec.holds) // 3, 2 * len(rec.holds) // 3))
    return x[int(rec.holds[k, 0]) - 20 :]


def _holds(rec, rng):
    """One to three holds, but the first."""
    count = int(rng.integers(1, 4))
    return rec.holds[1 + rng.choice(len(rec.holds) - 1, count, replace=False)]


def _fault(where):
    """A fault of some rows, which it changes in place, or gives others instead."""

    def named(damage):
        def damaged(rec, rng):
            samples = rec.samples.copy()
            found = damage(rec, rng, where(rec, rng, samples), _gain(rec))
            return replace(rec, samples=samples if found is None else found)

        FAULTS[damage.__name__] = damaged
        return damage

    return named


def _gain(rec):
    return 1.0 / float(np.mean(np.abs(rec.sensor.K)))  # raw units per m/s^2


def _axes(rng, one=0.5):
    """One axis or all."""
    return [int(rng.integers(3))] if rng.random() < one else [0, 1, 2]


@_fault(_whole)
def dead_axis(rec, rng, x, unit):
    """One axis shows electrical noise about a constant, white or wandering."""
    axis, n = rng.integers(3), len(x)
    noise = 10 ** rng.uniform(-3, 0) * unit * rng.standard_normal(n)
    kind = rng.integers(3)
    if kind == 1:
        walk = np.cumsum(rng.standard_normal(n)) / np.sqrt(RATE)
        noise += 10 ** rng.uniform(-3, -1) * unit * walk
    if kind == 2:
        other = x[:, (axis + 1) % 3]
        noise += 10 ** rng.uniform(-3, -1) * (other - other.mean())
    x[:, axis] = rng.uniform(-10, 10) * unit + noise


@_fault(_whole)
def stuck_axis(rec, rng, x, unit):
    """One axis shows one value for ever."""
    x[:, rng.integers(3)] = rng.choice([0.0, 1.0, -32768.0, 5.3 * unit])


@_fault(_late)
def stuck_from(rec, rng, x, unit):
    """One axis stops at a value."""
    axis = rng.integers(3)
    x[:, axis] = x[0, axis]


@_fault(_whole)
def wrap(rec, rng, x, unit):
    """Some axes wrap around at a span from 0.6 of the sphere's to eight times it."""
    axes = rng.choice(3, int(rng.integers(1, 4)), replace=False)
    span = 2 * G * unit * rng.uniform(0.6, 8)
    counts = unit >= 10
    span = 2.0 ** np.ceil(np.log2(span)) if counts else span
    for axis in axes:
        start = rng.uniform(*np.quantile(x[:, axis], [0.02, 0.98]))
        start = np.round(start) if counts else start
        x[:, axis] = (x[:, axis] - start) % span + rng.choice([start, -span / 2, 0.0])


@_fault(_whole)
def clipped(rec, rng, x, unit):
    """One axis, or all, cut at 0.7 to 0.97 of g, in numbers or before the noise."""
    axes = _axes(rng)
    level = rng.uniform(0.7, 0.97) * G * unit
    for axis in axes:
        b = rec.sensor.B[axis]
        x[:, axis] = np.clip(x[:, axis], b - level, b + level)
        if rng.random() < 0.5:
            x[:, axis] += rec.sigma * rng.standard_normal(len(x))


@_fault(_late)
def units(rec, rng, x, unit):
    """m/s^2 become g, mg, ft/s^2 or the reverse."""
    x *= rng.choice([1 / G, 1000 / G, 3.28084, G, 1 / 16.0])


@_fault(_late)
def gain_change(rec, rng, x, unit):
    """The gain of one axis, or of all, changes by 2 % to a factor of 4."""
    x[:, _axes(rng)] *= np.exp(rng.choice([-1, 1]) * 10 ** rng.uniform(-1.7, 0.14))


@_fault(_late)
def bias_jump(rec, rng, x, unit):
    """The bias of one axis jumps by 0.2 to 5 m/s^2."""
    x[:, rng.integers(3)] += rng.choice([-1, 1]) * 10 ** rng.uniform(-0.7, 0.7) * unit


@_fault(_late)
def sign_flip(rec, rng, x, unit):
    """One axis, or all, change sign."""
    x[:, _axes(rng, 0.7)] *= -1


@_fault(_whole)
def same_channel(rec, rng, x, unit):
    """Two axes are the same wire, with a gain and noise of their own."""
    one, two = rng.choice(3, 2, replace=False)
    x[:, two] = x[:, one]
    if rng.random() < 0.6:
        x[:, two] = rng.choice([1.0, -1.0, 0.9]) * x[:, one]
        x[:, two] += 2 * rec.sigma * rng.standard_normal(len(x))


@_fault(_late)
def swapped_axes(rec, rng, x, unit):
    """Two axes change places."""
    one, two = rng.choice(3, 2, replace=False)
    x[:, [one, two]] = x[:, [two, one]]


@_fault(_whole)
def repeated_block(rec, rng, x, unit):
    """A buffer of 1 to 20 s is written twice, over what came later."""
    size = int(rng.integers(100, 2000))
    a, b = rng.integers(0, len(x) - size, 2)
    x[b : b + size] = rec.samples[a : a + size]


@_fault(_whole)
def frozen(rec, rng, x, unit):
    """The sensor, or one axis, stops in a turn and stays there for some seconds."""
    axes = _axes(rng)
    for start, stop in _holds(rec, rng):
        row = int(start - rng.integers(10, 30))
        x[row:stop, axes] = x[row, axes]


@_fault(_whole)
def zero_rows(rec, rng, x, unit):
    """Lost packets are written as zeros: single rows, or seconds of them."""
    if rng.random() < 0.5:
        x[rng.random(len(x)) < 10 ** rng.uniform(-4, -1)] = 0.0
    else:
        for start, stop in _holds(rec, rng):
            x[start - 10 : stop + 10] = 0.0


@_fault(_whole)
def spikes(rec, rng, x, unit):
    """Single rows far off, on one axis."""
    axis, hit = rng.integers(3), rng.random(len(x)) < 10 ** rng.uniform(-4, -1.5)
    x[hit, axis] += 10 ** rng.uniform(-1, 2) * unit * rng.choice([-1, 1])


@_fault(_whole)
def lost_packets(rec, rng, x, unit):
    """Rows are missing, and nobody counted them."""
    keep = rng.random(len(x)) > 0.1
    for start, stop in _holds(rec, rng):
        keep[start - 40 : stop - 120] = False
    return x[keep]


@_fault(_whole)
def pushed(rec, rng, x, unit):
    """One to three holds pushed, dropped or on a shaking table: 0.5 to 5 m/s^2 off."""
    for start, stop in _holds(rec, rng):
        push = normalize(rng.standard_normal(3)) * rng.uniform(0.5, 5) * unit
        x[start:stop] += np.round(push) if unit > 10 else push


def wrong(rec, fit):
    """Whether the answer is wrong beyond its error bars: any true value farther off
    than six of its standard deviations and than 0.3 % of K, 0.003 rad, 0.03 m/s^2."""
    K = np.abs(rec.sensor.K)
    floor = np.concatenate([np.full(3, 3e-3), 3e-3 * K, 0.03 / K])
    off = np.abs(fit.parameters - rec.sensor.parameters)
    # the sign of an axis cannot be seen: a mirrored sensor is the same ellipsoid
    return bool(np.any((off > 6 * fit.sd) & (off > floor)))


# three sensors


@dataclass(frozen=True, kw_only=True)
class Three:
    """A log, its sensors, its holds as [start, stop) rows, and where these turn."""

    log: Log
    accelerometer: AccelerometerModel
    gyroscope: GyroscopeModel
    holds: np.ndarray
    turning: np.ndarray  # bool, of each row: in a hold, and turned by what is hidden
    rate_std: float  # rad/s, noise of a row


def three(seed, *, turning=True):
    """Log of a seed, some rests of which turn; its twin is that of the same seed."""
    rng = np.random.default_rng([320, seed])
    hz = float(rng.choice([50.0, 100.0, 200.0]))
    motion = Motion(
        rng, int(rng.integers(16, 31)), (2.4, 5.0), (0.6, 2.0), rng.uniform(5.0, 10.0)
    )
    n = motion.count
    motion.push *= 0.0
    # a turn from 0.3 to 12 degrees a second, all the time or at one end only
    tilt = np.c_[np.radians(rng.normal(0.0, 0.3, (n, 2))), np.ones(n)]
    speed = np.radians(0.3 * 40.0 ** rng.random(n)) * rng.choice([-1.0, 1.0], n)
    span = motion.hold * rng.choice([1.0, 0.2, 0.5], n)
    begin = np.where(rng.random(n) < 0.5, motion.start, motion.stop - span)
    some = np.isin(np.arange(n), rng.choice(n, int(rng.integers(1, 6)), replace=False))
    if turning:
        motion.slow = (some * speed)[:, None] * tilt, begin, span
    time, holds = motion.times(hz)
    path, _, _ = motion.attitude(time)
    inside = np.zeros(len(time), bool)
    for k in np.flatnonzero(some & turning):
        inside |= (time > begin[k]) & (time <= begin[k] + span[k])
    rate = np.zeros((len(time), 3))
    rate[1:] = (path[:-1].inv() * path[1:]).as_rotvec() * hz
    return _read(rng, hz, time, path, rate, holds, inside)


def _read(rng, hz, time, path, rate, holds, turning):
    def linear():
        return np.eye(3) + 0.03 * rng.standard_normal((3, 3))

    n = len(time)
    values = 0.02 * rng.standard_normal(3), rng.uniform(0.95, 1.05, 3)
    acc = AccelerometerModel.from_parameters(np.r_[*values, rng.normal(0, 0.2, 3)])
    gyro = GyroscopeModel(M=linear(), B=np.radians(rng.normal(0.0, 1.0, 3)))
    rate_std = np.radians(10 ** rng.uniform(-2.0, -0.4)) * np.sqrt(hz / 100.0)
    rates = gyro.distort(rate, rng) + rate_std * rng.standard_normal((n, 3))
    raw = acc.distort(path.inv().apply([0.0, 0.0, G]), rng)
    raw += 10 ** rng.uniform(-2.5, -1.3) * rng.standard_normal((n, 3))
    kind = rng.integers(4)
    if kind == 1:  # the bias drifts: a line, a warming up, a random walk
        rates += np.radians(rng.normal(0.0, 0.3, 3)) * (time / time[-1])[:, None]
        rates += np.radians(rng.normal(0.0, 0.2, 3)) * np.exp(-time / 40.0)[:, None]
    walk = np.radians(10 ** rng.uniform(-3.5, -2.5)) * rng.standard_normal((n, 3))
    if kind == 2:
        rates += np.cumsum(walk, axis=0) / np.sqrt(hz)
    if kind == 3:  # a table that shakes, in some holds more than in others
        size = 10 ** rng.uniform(-2, 0.5, len(holds))
        f, phase = rng.uniform(0.15, 0.45, 3) * hz, rng.uniform(0, 6.3, 3)
        for own, (a, b) in zip(size, holds, strict=True):
            wave = np.sin(2 * np.pi * f * time[a:b, None] + phase)
            rates[a:b] += rate_std * own * wave
    field = path.inv().apply(FIELD) @ linear().T + 1e-5 * rng.standard_normal(3)
    field += 10 ** rng.uniform(-7.5, -6.3) * rng.standard_normal((n, 3))
    log = log_of(time, raw, rates, field if rng.random() < 0.5 else None)
    return Three(
        log=log, accelerometer=acc, gyroscope=gyro, holds=holds, turning=turning,
        rate_std=rate_std,
    )  # fmt: skip


def far(fit, truth):
    """The greatest error of a fit, in its standard deviations."""
    return np.abs((fit.parameters - truth) / fit.sd).max()


# a tumble of the scene

SENSORS = """
T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
K = [0.0024, 0.0025, 0.0023]
B = [100, -50, 30]
noise_std_raw = 4.0
[gyroscope]
T = [[1, 0.01, 0], [0, 1, 0.02], [-0.01, 0, 1]]
K = [1.1e-3, 1.12e-3, 1.05e-3]
B = [12, -30, 5]
white_raw_per_sqrt_hz = 0.15
[magnetometer]
T = [[1, 0, 0], [0.02, 1, 0], [0.01, -0.03, 1]]
K = [1.5e-7, 1.5e-7, 1.6e-7]
B = [120, -40, 60]
noise_std_raw = 3.0
"""
"""Of a log in counts, as `load_imu` takes them."""


def of_scene(folder):
    """Path of a log of nine axes at 100 Hz, with the truth and `imu.toml` beside it."""
    (folder / "imu.toml").write_text(SENSORS)
    run = simulate("gimbal", poses=16, first_hold=12.0, hold_time=1.6, move_time=1.5)
    imu = load_imu(folder / "imu.toml")
    readings = read_imu(imu, motion_of(run, 5), np.random.default_rng(8))
    write_signal(folder / "log.csv", run, readings, 5)
    return folder / "log.csv"
