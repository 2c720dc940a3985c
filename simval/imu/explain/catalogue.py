"""The explanations that are tried on a log; a new one takes a few lines here.

Changes of a cable, a driver or a range are maps of the readings since a rest, a
counter's laps a map of those beyond a gap. What a sensor does by itself are columns,
whose prior sizes are orders of magnitude: `simval.imu.explain.likelihood` spreads each
over three decades.
"""

from collections.abc import Iterable, Iterator
from itertools import permutations, product

import numpy as np

from simval.arrays import Array
from simval.imu.explain.explanation import (
    BIAS,
    GAIN,
    LENGTH,
    ROWS,
    SCALE,
    Explanation,
    Kind,
    RestMeans,
)
from simval.shapes import Float

AXES = "xyz"
# prior standard deviations, the greatest of three decades, of gravity or of a scale:
# what a shock or a minute of warming does to a bad part
STEP, DRIFT, BEND, OFF = 0.2, 0.1, 0.1, 0.2
# time constants of a part that warms up, of the log
WARMING = (0.025, 0.05, 0.1, 0.2, 0.4)
NOISES = (3.0, 10.0, 30.0, 100.0)  # of an axis, times the measured
FACTORS = (2.0, 4.0, 8.0, 16.0, 9.80665, 1000.0 / 9.80665)  # of ranges and units
SIDE = 2  # rests on either side of a step: one alone is a rest that is off
_GAP = 0.25  # of an axis's span: a counter's laps leave such a gap
_LAP = 1.05  # of the span seen, the lap that is expected
_LAP_SD = 0.05
# axes that an effect acts on, with a column for each: one, all alike, each by itself
_SINGLES = [(a, np.eye(3)[:, [k]]) for k, a in enumerate(AXES)]
_ALIKE, _ALL = ("", np.ones((3, 1))), (AXES, np.eye(3))


def explanations(rests: RestMeans) -> Iterator[Explanation]:
    """Everything that is tried on the rests of a log."""
    yield from maps(rests)
    yield from laps(rests)
    yield from effects(rests)


def maps(rests: RestMeans) -> Iterator[Explanation]:
    """Wrong signs, exchanged axes and wrong factors, from any rest but the first."""
    n, eye = len(rests.readings), np.eye(3)
    every: list[tuple[Kind, str, float, Array]] = []
    for signs in product((1.0, -1.0), repeat=3):
        turned = "".join(a for a, sign in zip(AXES, signs, strict=True) if sign < 0.0)
        every.append(("sign", turned, np.nan, np.diag(signs)))
    for order in permutations(range(3)):
        moved = "".join(AXES[a] for a in range(3) if order[a] != a)
        every.append(("exchange", moved, np.nan, eye[list(order)]))
    for factor in FACTORS:
        every += [("unit or range", "", f, eye / f) for f in (factor, 1.0 / factor)]
    centred = rests.readings - rests.zero
    for kind, axes, size, undo in every:
        if np.array_equal(undo, eye):
            continue
        undone = centred @ undo.T + rests.zero
        unit = abs(np.linalg.det(undo)) ** (1.0 / 3.0)
        for k in range(1, n):
            later = np.arange(n) >= k
            yield explanation(
                rests, kind, axes, tuple(range(k, n)), size,
                readings=np.where(later[:, None], undone, rests.readings),
                unit=np.where(later, unit, 1.0),
            )  # fmt: skip


def laps(rests: RestMeans) -> Iterator[Explanation]:
    """Readings above a gap that a counter should have put below all others."""
    y, gaps = rests.readings, []
    for a in range(3):
        order, span = np.argsort(y[:, a]), float(np.ptp(y[:, a]))
        wide = np.flatnonzero(np.diff(y[order, a]) > _GAP * span) + 1
        gaps.append([None, *((order[k:], _LAP * span) for k in wide)])
    for choice in product(*gaps):
        chosen = {a: gap for a, gap in enumerate(choice) if gap}
        if not chosen:
            continue
        lap = max(span for _, span in chosen.values())  # of one counter
        turns = np.zeros_like(y)
        for a, (rows, _) in chosen.items():
            turns[rows, a] = 1.0
        yield wrapped(rests, turns, lap)


def wrapped(rests: RestMeans, turns: Float[Array, "n 3"], lap: float) -> Explanation:
    """Readings that are too high by so many laps of a counter, known to 5 %."""
    axes = "".join(a for a, moved in zip(AXES, turns.T, strict=True) if moved.any())
    columns = np.zeros((len(turns), ROWS, 1))
    columns[:, BIAS:SCALE, 0] = turns
    return explanation(
        rests, "wrap", axes, tuple(map(int, np.flatnonzero(turns.any(axis=1)))), lap,
        readings=rests.readings - lap * turns,
        columns=columns, sd=_LAP_SD * lap,
    )  # fmt: skip


def effects(rests: RestMeans) -> Iterator[Explanation]:
    """Steps, drifts, bends, extra noise, and single rests that are off."""
    y, n = rests.readings - rests.zero, len(rests.readings)
    radius = radius_of(y)
    biases, scales = [*_SINGLES, _ALL], [*_SINGLES, _ALIKE]
    for k in range(SIDE, n - SIDE + 1):
        later = (np.arange(n) >= k).astype(float)
        since = tuple(range(k, n))
        yield from _courses(rests, "bias step", later, biases, STEP * radius, since)
        yield from _courses(rests, "scale step", later, [*scales, _ALL], STEP, since)
    for tau, course in _times(rests.time):
        yield from _courses(
            rests, "bias drift", course, biases, DRIFT * radius, size=tau
        )
        if np.isnan(tau):
            yield from _courses(rests, "scale drift", course, scales, DRIFT)
    yield from in_temperature(rests)
    for power, k in product((2.0, 3.0), range(3)):
        course = radius * (y[:, k] / radius) ** power
        yield from _courses(rests, "curvature", course, [_SINGLES[k]], BEND, size=power)
    yield from (off(rests, (k,)) for k in range(n))
    up = y / np.maximum(np.linalg.norm(y, axis=1, keepdims=True), np.finfo(float).tiny)
    for (k, a), times in product(enumerate(AXES), NOISES):
        noise = np.hypot(1.0, times * up[:, k])
        yield explanation(rests, "noise", a, size=times, noise=noise)


def in_temperature(rests: RestMeans) -> Iterator[Explanation]:
    """Bias and scale that follow temperature or its square, by axis and together."""
    radius, axes = radius_of(rests.readings - rests.zero), [*_SINGLES, _ALL]
    for power, course in _powers(rests.temperature):
        yield from _courses(
            rests, "bias in temperature", course, axes, DRIFT * radius, size=power
        )
        yield from _courses(
            rests, "scale in temperature", course, [*axes, _ALIKE], DRIFT, size=power
        )


def plain(rests: RestMeans) -> Explanation:
    """Nothing wrong: the ellipsoid alone."""
    return explanation(rests, "noise", size=1.0)


def off(rests: RestMeans, some: tuple[int, ...]) -> Explanation:
    """Some rests that are off, each by a distance of its own."""
    columns = np.zeros((len(rests.readings), ROWS, len(some)))
    columns[some, LENGTH, range(len(some))] = 1.0
    return explanation(rests, "rest off", rests=some, columns=columns, sd=OFF)


def _times(time: Array) -> Iterator[tuple[float, Array]]:
    # courses of a drift: even, and of warming with a time constant, s
    span = float(np.ptp(time))
    if span > 0.0:
        yield np.nan, 2.0 * (time - time.mean()) / span
        for tau in WARMING:
            yield tau * span, np.exp((time[0] - time) / (tau * span))


def _powers(temperature: Array | None) -> Iterator[tuple[float, Array]]:
    if temperature is not None and np.ptp(temperature) > 0.0:
        t = temperature - temperature.mean()
        t = t / np.abs(t).max()
        yield from ((1.0, t), (2.0, t**2 - np.mean(t**2)))


def _courses(
    rests: RestMeans,
    kind: Kind,
    course: Float[Array, " n"],
    which: Iterable[tuple[str, Array]],
    sd: float,
    since: tuple[int, ...] = (),
    *,
    size: float = np.nan,
) -> Iterator[Explanation]:
    # a bias or a scale that follows a course, of each set of axes
    first = (SCALE, GAIN) if kind.startswith("scale") else (BIAS,)
    for (axes, basis), row in product(which, first):
        columns = np.zeros((len(course), ROWS, basis.shape[1]))
        columns[:, row : row + 3] = course[:, None, None] * basis
        yield explanation(rests, kind, axes, since, size, columns=columns, sd=sd)


def explanation(
    of: RestMeans,
    kind: Kind,
    axes: str = "",
    rests: tuple[int, ...] = (),
    size: float = np.nan,
    *,
    readings: Array | None = None,
    unit: Array | None = None,
    noise: Array | None = None,
    columns: Array | None = None,
    sd: float = 1.0,
) -> Explanation:
    """Make an explanation of some rests; what is not given changes nothing."""
    n = len(of.readings)
    columns = np.empty((n, ROWS, 0)) if columns is None else columns
    even = np.ones(n)
    return Explanation(
        kind=kind, axes=axes, rests=rests, size=size,
        readings=of.readings if readings is None else readings,
        unit=even if unit is None else unit, noise=even if noise is None else noise,
        columns=columns, sd=np.full(columns.shape[-1], sd),
    )  # fmt: skip


def radius_of(z: Float[Array, "n 3"]) -> float:
    """Root mean square length of readings about a zero: gravity, roughly."""
    return float(np.sqrt(np.mean(np.sum(z**2, axis=1)))) or 1.0
