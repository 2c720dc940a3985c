"""Rows of rests of sound and of faulty sensors, and what their noise is measured to be.

A sensor is a matrix and a bias; a fault changes its bias or scales with the rest, its
rows, or where gravity is. Sizes of faults are in m/s^2 or relative, where the noise of
a mean is 0.002 m/s^2.
"""

from dataclasses import dataclass, field

import numpy as np

from simval.imu.explain import RestMeans

G = 9.80665
FACES = np.array([[0, 0, 1], [0, 0, -1], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0]])
ROWS, SECONDS = 100, 5.0


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def directions(n, rng):
    """Directions all over the sphere, in an order of chance."""
    k = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * k / n, np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z**2)
    spiral = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    return rng.permutation(spiral) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]


def near_faces(n, rng):
    """Six faces and repeats of them, tipped by half a degree to thirty."""
    faces = np.concatenate([FACES, FACES[rng.integers(6, size=n - 6)]])
    tip = np.deg2rad(rng.choice([0.5, 2.0, 5.0, 30.0], (n, 1)))
    return rng.permutation(unit(faces + tip * rng.normal(size=(n, 3))))


@dataclass
class Log:
    """Directions of gravity in the rests, and what a sensor makes of them."""

    up: np.ndarray
    rng: np.random.Generator
    noise: np.ndarray | float = 0.02  # of a row
    tremor: float = 0.0  # of the direction, rad, over five rows
    step: float = 0.0  # of a converter
    bias: np.ndarray | float = 0.0  # change of the bias in each rest, (n, 3)
    scale: np.ndarray | float = 0.0  # of the scales, (n, 3)
    length: np.ndarray | float = 0.0  # of gravity, (n, 1)
    warp: object = staticmethod(lambda y: y)  # of the rows
    temperature: np.ndarray | None = None
    names: frozenset = field(default_factory=frozenset)

    def rests(self):
        """Means of the rests, with the noise that their rows show."""
        n, rng = len(self.up), self.rng
        up = np.repeat(self.up[:, None] * (1.0 + np.atleast_2d(self.length)[..., None]
                       if np.ndim(self.length) else 1.0), ROWS, axis=1)  # fmt: skip
        if self.tremor:
            sway = rng.normal(size=(n, ROWS // 5, 3)).repeat(5, axis=1)
            up = unit(up + self.tremor * np.cross(sway, up))
        matrix = np.diag(rng.normal(1.0, 0.03, 3)) @ (
            np.eye(3) + np.triu(rng.normal(0.0, 0.015, (3, 3)), 1)
        )
        each = np.broadcast_to(self.scale, (n, 3))[:, None]
        offset = rng.normal(0.0, 0.25, 3) + np.broadcast_to(self.bias, (n, 3))
        y = self.warp((1.0 + each) * (G * up @ matrix.T) + offset[:, None])
        y = y + self.noise * rng.normal(size=y.shape)
        if self.step:
            y = self.step * np.round(y / self.step)
        return measured(y, self.temperature, self.step)


def measured(rows, temperature=None, step=0.0):
    """Means, their covariance by the rows of each, and one factor for slow noise.

    The factor is the variance of means of an eighth of a rest over what white noise
    would leave of it.
    """
    n, count, _ = rows.shape
    centred = rows - rows.mean(axis=1, keepdims=True)
    own = np.swapaxes(centred, 1, 2) @ centred / (count - 1)
    eighths = rows[:, : count // 8 * 8].reshape(n, 8, -1, 3).mean(axis=2)
    up = unit(rows.mean(axis=1))
    slow = np.var(np.einsum("nka,na->nk", eighths, up), axis=1, ddof=1).mean() / 8
    white = np.einsum("na,nab,nb->n", up, own, up).mean() / count
    cov = own / count * (slow / white) + step**2 / 12.0 * np.eye(3)
    time = SECONDS * np.arange(n)
    return RestMeans.of(rows.mean(axis=1), cov, time, temperature, freedom=count - 1)


def course(n, rng):
    """Temperature of a room or of a part that warms up."""
    warming = 1.0 - np.exp(-np.arange(n) / n / rng.uniform(0.1, 1.0))
    return 25.0 + rng.uniform(0.5, 10.0) * warming + 0.1 * rng.normal(size=n).cumsum()


def _sound(up, rng, **fields):
    warm = course(len(up), rng) if rng.random() < 0.5 else None
    return Log(up, rng, temperature=warm, **fields).rests()


def _ordered(rng):
    # all over the sphere, one after the other: axes are tipped in turn
    n = int(rng.integers(12, 36))
    up = directions(n, rng)
    return up[np.argsort(up @ unit(rng.normal(size=3)))]


def _any(rng, low=12, high=31):
    return directions(int(rng.integers(low, high)), rng)


SOUND = {
    "table": lambda r: _sound(_any(r, 12, 41), r, noise=10 ** r.uniform(-2.7, -0.8)),
    "hand": lambda r: _sound(_any(r), r, noise=0.01, tremor=r.uniform(0.001, 0.012)),
    "six faces": lambda r: _sound(
        r.permutation(unit(np.repeat(FACES, 2, 0) + 2e-3 * r.normal(size=(12, 3)))), r,
        noise=0.03,
    ),
    "near faces": lambda r: _sound(near_faces(int(r.integers(12, 20)), r), r),
    "few": lambda r: _sound(_any(r, 8, 12), r),
    "ordered": lambda r: _sound(_ordered(r), r),
    "knocked": lambda r: _sound(
        np.concatenate([np.repeat(FACES[:1], r.integers(4, 12), 0), _any(r, 10, 16)]),
        r, noise=0.03,
    ),
    "coarse": lambda r: _sound(
        _any(r), r, noise=0.01, step=r.choice([0.02, 0.04, 0.08]),
    ),
    "unequal": lambda r: _sound(_any(r), r, noise=0.01 * r.permutation([1, 3, 10])),
    "scatter": lambda r: _scattered(r, lambda n: 0.003 * r.normal(size=(n, 3))),
    "heavy": lambda r: _scattered(r, lambda n: 0.002 * r.standard_t(3, (n, 3))),
}  # fmt: skip
"""Sound logs; in the last two, holds scatter beyond the noise of their rows."""


def _scattered(rng, off):
    up = _any(rng)
    return _sound(up, rng, noise=0.01, bias=off(len(up)))


# faults: what of a log they change, at a size, from a rest on, on an axis


def _since(n, k, a=None):
    each = np.zeros((n, 3))
    each[k:, slice(None) if a is None else a] = 1.0
    return each


def _rising(n, a=None):
    each = np.zeros((n, 3))
    each[:, slice(None) if a is None else a] = np.linspace(0.0, 1.0, n)[
        :, None if a is None else ...
    ]
    return each


def _later(k, act):
    def warp(y):
        y = y.copy()
        y[k:] = act(y[k:])
        return y

    return warp


def _axis(a, act):
    def warp(y):
        y = y.copy()
        y[..., a] = act(y[..., a])
        return y

    return warp


def _off(n, rests, size):
    each = np.zeros((n, 1))
    each[rests, 0] = size / G
    return each


def _warm(log, size, a):
    log.temperature = course(len(log.up), log.rng)
    t = log.temperature - log.temperature.mean()
    return size * np.outer(t / np.abs(t).max(), np.eye(3)[a])


FAULTS = {
    "sign": ("sign", (1, 1, 1), lambda L, s, k, a: {
        "warp": _later(k, lambda y: y * np.where(np.arange(3) == a, -1, 1))}),
    "exchange": ("exchange", (1, 1, 1), lambda L, s, k, a: {
        "warp": _later(k, lambda y: y[..., [(1, 0, 2), (0, 2, 1), (1, 2, 0)][a]])}),
    "factor": ("unit or range", (2, 1 / 16, 1 / G), lambda L, s, k, a: {
        "warp": _later(k, lambda y: s * y)}),
    "wrap": ("wrap", (2, 4, 16), lambda L, s, k, a: {
        "warp": _axis(a, lambda y: np.where(y < 0, y + 2 * s * G, y))}),
    "bias step": ("bias step", (0.02, 0.1, 1.0), lambda L, s, k, a: {
        "bias": s * _since(len(L.up), k, a)}),
    "bias steps": ("bias step", (0.02, 0.1, 1.0), lambda L, s, k, a: {
        "bias": s * _since(len(L.up), k) * L.rng.choice([-1, 1], 3)}),
    "scale step": ("scale step", (0.003, 0.01, 0.1), lambda L, s, k, a: {
        "scale": s * _since(len(L.up), k, a)}),
    "bias drift": ("bias drift", (0.03, 0.1, 0.5), lambda L, s, k, a: {
        "bias": s * _rising(len(L.up), a)}),
    "gain drift": ("scale drift", (0.003, 0.01, 0.05), lambda L, s, k, a: {
        "scale": s * _rising(len(L.up))}),
    "rest off": ("rest off", (0.02, 0.1, 1.0), lambda L, s, k, a: {
        "length": _off(len(L.up), [k], s)}),
    "two rests off": ("rest off", (0.02, 0.1, 1.0), lambda L, s, k, a: {
        "length": _off(len(L.up), [k], s) - _off(len(L.up), [k - 2], s)}),
    "bend": ("curvature", (0.003, 0.01, 0.05), lambda L, s, k, a: {
        "warp": _axis(a, lambda y: y + s * y**2 / G)}),
}  # fmt: skip
"""Faults of the note: kind, three sizes, and what they change of a log."""

FURTHER = {
    "warming": ("bias drift", (0.03, 0.1, 0.5), lambda L, s, k, a: {
        "bias": s * np.outer(np.exp(-np.arange(len(L.up)) / 3.0), np.eye(3)[a])}),
    "bias in temperature": ("bias in temperature", (0.03, 0.1, 0.5),
        lambda L, s, k, a: {
        "bias": _warm(L, s, a)}),
    "scale in temperature": ("scale in temperature", (0.003, 0.01, 0.05),
        lambda L, s, k, a: {"scale": _warm(L, s, a)}),
    "noisy axis": ("noise", (3, 10, 50), lambda L, s, k, a: {
        "bias": 0.002 * s * np.outer(L.rng.normal(size=len(L.up)), np.eye(3)[a])}),
}  # fmt: skip
"""Faults of the catalogue that the note did not count."""

UNLISTED = {
    "clipping": ((0.01, 0.1), lambda L, s, a: {
        "warp": _axis(a, lambda y: np.minimum(y, (1.0 - s) * G))}),
    "hysteresis": ((0.001, 0.01), lambda L, s, a: {"bias": s * G * np.sign(
        np.diff(L.up, axis=0, prepend=L.up[:1])) * (np.arange(3) == a)}),
    "walking bias": ((0.001, 0.01), lambda L, s, a: {
        "bias": s * G * L.rng.normal(size=L.up.shape).cumsum(axis=0) / 4}),
}  # fmt: skip
"""Faults that are in no catalogue, at two sizes relative to gravity."""


def log_of(rng, where="sphere"):
    """A log of 14 to 30 rests, few of them, or near the faces, for a fault."""
    n = int(
        rng.integers(*{"sphere": (14, 31), "few": (10, 14), "faces": (12, 19)}[where])
    )
    return Log(near_faces(n, rng) if where == "faces" else directions(n, rng), rng)


def faulty(fault, size, rng, where="sphere"):
    """Rests of a log with one fault at one of its sizes, and the right kind."""
    kind, sizes, act = fault
    log = log_of(rng, where)
    k, a = int(rng.integers(3, len(log.up) - 2)), int(rng.integers(3))
    for name, value in act(log, sizes[size], k, a).items():
        setattr(log, name, value)
    return log.rests(), kind
