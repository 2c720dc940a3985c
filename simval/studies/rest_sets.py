"""Rests of sound and faulty sensors, drawn row by row, with the noise they show.

A sensor is a matrix and a bias; a fault changes its bias or scales with the rest, its
rows, or gravity's length. Sizes of faults are in m/s^2: of a scale, what it does to
gravity. Sound logs are of all kinds that a person records; in those of `SCATTERED`,
rests scatter beyond the noise of their rows, by the hold or by the sensor.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.geometry import normalize
from simval.imu.explain import RestMeans
from simval.imu.explain.explanation import Kind
from simval.shapes import Float

G = 9.80665  # m/s^2, standard gravity
FACES = np.array([[0, 0, 1], [0, 0, -1], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0]])
ROWS, SECONDS = 100, 5.0  # of a rest, and from one to the next
FACED = 1 / 3  # of the logs with faults: their poses are near the six faces
SWAY = 5  # rows over which a hand's direction stays
PART = (0.03, 0.015, 0.25)  # deviations of a part's scales, axes and bias, m/s^2

Random = np.random.Generator
Warp = Callable[[Array], Array]


def directions(n: int, rng: Random) -> Float[Array, "n 3"]:
    """Random directions in random order."""
    k = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * k / n, np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z**2)
    spiral = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    return rng.permutation(spiral) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]


def near_faces(n: int, rng: Random) -> Float[Array, "n 3"]:
    """Six faces and repeats of them, tilted by half a degree to thirty."""
    faces = np.concatenate([FACES, FACES[rng.integers(6, size=n - 6)]])
    tip = np.deg2rad(rng.choice([0.5, 2.0, 5.0, 30.0], (n, 1)))
    return rng.permutation(normalize(faces + tip * rng.normal(size=(n, 3))))


def course(n: int, rng: Random) -> Float[Array, " n"]:
    """Temperature of a room, or of a part that warms up."""
    warming = 1.0 - np.exp(-np.arange(n) / n / rng.uniform(0.1, 1.0))
    return 25.0 + rng.uniform(0.5, 10.0) * warming + 0.1 * rng.normal(size=n).cumsum()


def _unchanged(rows: Array) -> Array:
    return rows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestSet:
    """Directions of gravity in some rests, and how a sensor reads them."""

    up: Float[Array, "n 3"]
    noise: float | Float[Array, " 3"] = 0.02  # of a row, m/s^2
    tremor: float = 0.0  # of the direction, rad, over `SWAY` rows
    step: float = 0.0  # of a converter, m/s^2
    lowpass: int = 1  # rows over which the sensor averages its noise
    part: float = 1.0  # times `PART`
    bias: float | Float[Array, "n 3"] = 0.0  # change of the bias in each rest, m/s^2
    scale: float | Float[Array, "n 3"] = 0.0  # of the scales
    length: float | Float[Array, "n 1"] = 0.0  # of gravity
    warp: Warp = _unchanged  # of the rows
    temperature: Float[Array, " n"] | None = None

    def means(self, rng: Random) -> RestMeans:
        """Draw the means of the rests, with the noise that their rows show."""
        n = len(self.up)
        up = np.repeat(self.up[:, None], ROWS, axis=1)
        if self.tremor:
            sway = rng.normal(size=(n, ROWS // SWAY, 3)).repeat(SWAY, axis=1)
            up = normalize(up + self.tremor * np.cross(sway, up))
        up = up * (1.0 + np.broadcast_to(self.length, (n, 1))[:, None])
        scales, axes, bias = (self.part * sd for sd in PART)
        matrix = np.diag(rng.normal(1.0, scales, 3)) @ (
            np.eye(3) + np.triu(rng.normal(0.0, axes, (3, 3)), 1)
        )
        each = np.broadcast_to(self.scale, (n, 3))[:, None]
        offset = rng.normal(0.0, bias, 3) + np.broadcast_to(self.bias, (n, 3))
        y = self.warp((1.0 + each) * (G * up @ matrix.T) + offset[:, None])
        white = rng.normal(size=(n, ROWS + self.lowpass - 1, 3))
        windows = np.lib.stride_tricks.sliding_window_view(white, self.lowpass, axis=1)
        y = y + self.noise * windows.mean(axis=-1)
        if self.step:
            y = self.step * np.round(y / self.step)
        return measured(y, self.temperature, self.step)

    def with_bias(self, more: Float[Array, "n 3"]) -> "RestSet":
        """The same rests with this bias added in each, m/s^2."""
        return replace(self, bias=self.bias + more)

    def with_scale(self, more: Float[Array, "n 3"]) -> "RestSet":
        """The same rests with scales changed to add so much at gravity, m/s^2."""
        return replace(self, scale=self.scale + more / G)

    def with_length(self, more: Float[Array, " n"]) -> "RestSet":
        """The same rests with gravity longer by so much in each, m/s^2."""
        return replace(self, length=self.length + more[:, None] / G)

    def warped(self, act: Warp, since: int = 0, axis: int | None = None) -> "RestSet":
        """The same rests, with rows of an axis or all changed from some rest on."""
        before, which = self.warp, slice(None) if axis is None else axis

        def warp(y: Array) -> Array:
            y = before(y).copy()
            y[since:, :, which] = act(y[since:, :, which])
            return y

        return replace(self, warp=warp)


def measured(
    rows: Float[Array, "n k 3"],
    temperature: Float[Array, " n"] | None = None,
    step: float = 0.0,
) -> RestMeans:
    """Means of rests, their covariance by the rows, and a factor for slow noise.

    The factor is the variance of means of an eighth of a rest over what white noise
    would leave of it.
    """
    n, count, _ = rows.shape
    centred = rows - rows.mean(axis=1, keepdims=True)
    own = centred.mT @ centred / (count - 1)
    eighths = rows[:, : count // 8 * 8].reshape(n, 8, -1, 3).mean(axis=2)
    up = normalize(rows.mean(axis=1))
    slow = np.var(np.einsum("nka,na->nk", eighths, up), axis=1, ddof=1).mean() / 8
    white = np.einsum("na,nab,nb->n", up, own, up).mean() / count
    cov = own / count * (slow / white) + step**2 / 12.0 * np.eye(3)
    time = SECONDS * np.arange(n)
    return RestMeans.of(rows.mean(axis=1), cov, time, temperature, freedom=count - 1)


# sound logs


def _sound(up: Array, rng: Random, **more: Any) -> RestMeans:
    warm = course(len(up), rng) if rng.random() < 0.5 else None
    return RestSet(up=up, temperature=warm, **more).means(rng)


def _any(rng: Random, low: int = 12, high: int = 31) -> Array:
    return directions(int(rng.integers(low, high)), rng)


def _ordered(rng: Random) -> Array:
    # all over the sphere, one after the other: axes are tipped in turn
    up = _any(rng, 12, 36)
    return up[np.argsort(up @ normalize(rng.normal(size=3)))]


def _half(rng: Random) -> Array:
    # as of a body that stands on a table: nothing from below the horizon
    up = _any(rng, 24, 61)
    return up[up[:, 2] > -0.1]


def _twice(rng: Random) -> Array:
    return rng.permutation(
        normalize(np.repeat(FACES, 2, 0) + 2e-3 * rng.normal(size=(12, 3)))
    )


def _knocked(rng: Random) -> Array:
    first = np.repeat(FACES[:1], rng.integers(4, 12), 0)
    return np.concatenate([first, _any(rng, 10, 16)])


def _scattered(rng: Random, off: Callable[[int], Array]) -> RestMeans:
    up = _any(rng)
    return _sound(up, rng, noise=0.01, bias=off(len(up)))


SOUND: Mapping[str, Callable[[Random], RestMeans]] = {
    "table": lambda r: _sound(_any(r, 12, 41), r, noise=10 ** r.uniform(-2.7, -0.8)),
    "hand": lambda r: _sound(_any(r), r, noise=0.01, tremor=r.uniform(0.001, 0.012)),
    "six faces": lambda r: _sound(_twice(r), r, noise=0.03),
    "near faces": lambda r: _sound(near_faces(int(r.integers(12, 20)), r), r),
    "few": lambda r: _sound(_any(r, 8, 12), r),
    "ordered": lambda r: _sound(_ordered(r), r),
    "knocked": lambda r: _sound(_knocked(r), r, noise=0.03),
    "coarse": lambda r: _sound(
        _any(r), r, noise=0.01, step=float(r.choice([0.02, 0.04, 0.08]))
    ),
    "unequal": lambda r: _sound(_any(r), r, noise=0.01 * r.permutation([1, 3, 10])),
    "half a sphere": lambda r: _sound(_half(r), r),
    "many": lambda r: _sound(_any(r, 60, 100), r),
    "poor part": lambda r: _sound(_any(r), r, part=r.uniform(3.0, 6.0)),
    "filtered": lambda r: _sound(_any(r), r, lowpass=int(r.integers(2, 6))),
}
"""Sound logs whose rests have the noise of their rows."""

SCATTERED: Mapping[str, Callable[[Random], RestMeans]] = {
    "scatter": lambda r: _scattered(r, lambda n: 0.003 * r.normal(size=(n, 3))),
    "heavy": lambda r: _scattered(r, lambda n: 0.002 * r.standard_t(3, (n, 3))),
}
"""Sound logs whose holds scatter beyond the noise of their rows."""


# faults


class Where(NamedTuple):
    """Size and place of a fault."""

    size: float  # m/s^2
    rest: int  # since which
    axis: int


Act = Callable[[RestSet, Where, Random], RestSet]


class Fault(NamedTuple):
    """A fault, and how it changes a sensor's rests."""

    kinds: frozenset[Kind]  # none where no explanation is right
    act: Act


def _one(a: int) -> Float[Array, "3"]:
    return np.eye(3)[a]


def _since(log: RestSet, at: Where) -> Float[Array, "n 1"]:
    return at.size * (np.arange(len(log.up)) >= at.rest)[:, None]


def _rising(log: RestSet, at: Where) -> Float[Array, "n 1"]:
    return at.size * np.linspace(0.0, 1.0, len(log.up))[:, None]


def _off(log: RestSet, at: Where, back: int = 0) -> Float[Array, " n"]:
    return at.size * (np.arange(len(log.up)) == at.rest - back)


def _warmed(changed: Callable[[RestSet, Array], RestSet]) -> Act:
    """A change of an axis with temperature, which the log then has."""

    def act(log: RestSet, at: Where, rng: Random) -> RestSet:
        temperature = course(len(log.up), rng)
        t = temperature - temperature.mean()
        more = at.size * (t / np.abs(t).max())[:, None] * _one(at.axis)
        return changed(replace(log, temperature=temperature), more)

    return act


def _signed(log: RestSet, at: Where, rng: Random) -> RestSet:
    return log.warped(np.negative, at.rest, at.axis)


def _exchanged(log: RestSet, at: Where, rng: Random) -> RestSet:
    order = [(1, 0, 2), (0, 2, 1), (1, 2, 0)][at.axis]
    return log.warped(lambda y: y[..., order], at.rest)


def _scaled(log: RestSet, at: Where, rng: Random) -> RestSet:
    factor = rng.choice([2.0, 0.25, 1 / 16, 1 / G, 1000.0 / G])
    return log.warped(lambda y: factor * y, at.rest)


def _wrapped(log: RestSet, at: Where, rng: Random) -> RestSet:
    lap = 4.0 * G * 8.0 ** rng.random()
    return log.warped(lambda y: np.where(y < 0.0, y + lap, y), axis=at.axis)


def _bent(log: RestSet, at: Where, rng: Random) -> RestSet:
    return log.warped(lambda y: y + at.size * (y / G) ** 2, axis=at.axis)


def _clipped(log: RestSet, at: Where, rng: Random) -> RestSet:
    return log.warped(lambda y: np.minimum(y, y.max() - at.size), axis=at.axis)


def _walking(log: RestSet, at: Where, rng: Random) -> RestSet:
    steps = rng.normal(size=log.up.shape) / len(log.up) ** 0.5
    return log.with_bias(at.size * steps.cumsum(axis=0))


def _lagging(log: RestSet, at: Where, rng: Random) -> RestSet:
    turned = np.sign(np.diff(log.up, axis=0, prepend=log.up[:1]))
    return log.with_bias(0.5 * at.size * turned * _one(at.axis))


def _kind(kind: Kind, act: Act) -> Fault:
    return Fault(frozenset({kind}), act)


READINGS: Mapping[str, Fault] = {
    "sign": _kind("sign", _signed),
    "exchange": _kind("exchange", _exchanged),
    "factor": _kind("unit or range", _scaled),
    "wrap": _kind("wrap", _wrapped),
}
"""Changes of what is read, which have no size."""

BIASES: Mapping[str, Fault] = {
    "bias step": _kind(
        "bias step", lambda L, at, r: L.with_bias(_since(L, at) * _one(at.axis))
    ),
    "bias steps": _kind(
        "bias step",
        lambda L, at, r: L.with_bias(_since(L, at) * r.choice([-1.0, 1.0], 3)),
    ),
    "bias drift": _kind(
        "bias drift", lambda L, at, r: L.with_bias(_rising(L, at) * _one(at.axis))
    ),
    "warming": _kind(
        "bias drift",
        lambda L, at, r: L.with_bias(
            at.size * np.outer(np.exp(-np.arange(len(L.up)) / 3.0), _one(at.axis))
        ),
    ),
    "bias in temperature": _kind("bias in temperature", _warmed(RestSet.with_bias)),
}
"""Changes of a bias."""

SCALES: Mapping[str, Fault] = {
    "scale step": _kind(
        "scale step", lambda L, at, r: L.with_scale(_since(L, at) * _one(at.axis))
    ),
    "gain drift": _kind(
        "scale drift", lambda L, at, r: L.with_scale(_rising(L, at) * np.ones(3))
    ),
    "scale in temperature": _kind("scale in temperature", _warmed(RestSet.with_scale)),
    "bend": _kind("curvature", _bent),
}
"""Changes of a scale."""

HOLDS: Mapping[str, Fault] = {
    "rest off": _kind("rest off", lambda L, at, r: L.with_length(_off(L, at))),
    "two rests off": _kind(
        "rest off", lambda L, at, r: L.with_length(_off(L, at) - _off(L, at, 2))
    ),
    "noisy axis": _kind(
        "noise",
        lambda L, at, r: L.with_bias(
            at.size * np.outer(r.normal(size=len(L.up)), _one(at.axis))
        ),
    ),
}
"""Rests that are off, and noise beyond that of the rows."""

UNLISTED: Mapping[str, Fault] = {
    "clipping": Fault(frozenset(), _clipped),
    "hysteresis": Fault(frozenset(), _lagging),
    "walking bias": Fault(frozenset(), _walking),
}
"""Faults that are in no catalogue."""

SINGLE: Mapping[str, Fault] = {**READINGS, **BIASES, **SCALES, **HOLDS}


def _both(one: str, other: str) -> Fault:
    first, second = SINGLE[one], SINGLE[other]

    def act(log: RestSet, at: Where, rng: Random) -> RestSet:
        moved = at._replace(axis=(at.axis + 1) % 3)
        return second.act(first.act(log, at, rng), moved, rng)

    return Fault(first.kinds | second.kinds, act)


PAIRS: Mapping[str, Fault] = {
    f"{one} and {other}": _both(one, other)
    for one, other in (
        ("bias drift", "sign"),
        ("bias step", "rest off"),
        ("scale in temperature", "exchange"),
    )
}
"""Two at once, on different axes; what the sensor does, before its readings change."""


def _lying(fault: Fault) -> Fault:
    # of a body on a table, that shows it no side from below
    def act(log: RestSet, at: Where, rng: Random) -> RestSet:
        above = np.where(log.up[:, 2:] < 0.0, -1.0, 1.0)
        return fault.act(replace(log, up=above * log.up), at, rng)

    return Fault(fault.kinds, act)


LYING: Mapping[str, Fault] = {
    f"{name} in half a sphere": _lying(fault) for name, fault in SINGLE.items()
}
"""Faults of logs with no pose from below the horizon."""


def unharmed(rng: Random) -> RestSet:
    """Random directions and a sound sensor, to which a fault is added."""
    n = int(rng.integers(13, 18))
    up = near_faces(n, rng) if rng.random() < FACED else directions(n, rng)
    return RestSet(
        up=up,
        noise=10.0 ** rng.uniform(-2.3, -1.3),
        tremor=rng.choice([0.0, 0.005]),
        part=rng.uniform(1.0, 4.0),
        temperature=course(len(up), rng) if rng.random() < 0.5 else None,
    )


def faulty(fault: Fault, times: float, rng: Random, log: RestSet) -> RestMeans:
    """Rests of a log with a fault, of so many times the noise of a mean."""
    k, a = int(rng.integers(3, len(log.up) - 2)), int(rng.integers(3))
    size = times * np.max(log.noise) / ROWS**0.5
    return fault.act(log, Where(size, k, a), rng).means(rng)
