"""One sensor of a recording, judged: the fewest wrong things that explain it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import RefusedError
from simval.geometry import from_rotation_vector
from simval.imu.audit.regression import (
    Explained,
    Regression,
    TermFit,
    TermRows,
    bands_of,
)
from simval.imu.audit.terms import BIAS, ENDS, Expansion, Piece, SensorTerms
from simval.path import in_body, to_world
from simval.shapes import Float

Flags = NDArray[np.bool_]
INSTANTS: Final = (0.0, 0.5, -0.5)
"""Steps that a row may be late by: of its instant, the mean over the step before, and
over the step after."""
ROUNDS: Final = 6
FARTHEST: Final = 64  # steps of delay that are looked at
NEAR: Final = 2.0  # steps within which a delay needs no look around
HALF: Final = 0.5  # of the squares: another frame must leave less
THIN: Final = 600  # rows for a look
SILENT: Final = 1e-6  # of a reading: one that is zero has no time
FAINT: Final = 1e-3  # of a direction: below it a mount is the declared axes'
SPIKE: Final = 12.0  # times the noise
SPIKE_SHARE: Final = 0.02  # of the reading, and of the rows
BOUND: Final = 3.0
PRESENT: Final = 0.5  # a term is judged where its absence would be seen


class Item(NamedTuple):
    """One thing that was asked.

    Attributes
    ----------
    name : str
        Of the term.
    value, sd, allowed : Array
        Deviation from what is right, its standard deviation, and how far it may be off:
        chance at the stated rate and the error of the ideal.
    wrong : bool
        Whether it is one of the fewest that explain the readings.
    judged : Array
        Of each number, whether the motion tells it.
    """

    name: str
    value: Float[Array, " m"]
    sd: Float[Array, " m"]
    allowed: Float[Array, " m"]
    wrong: bool
    judged: Flags


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorAudit:
    """What was found of one sensor.

    Attributes
    ----------
    name : str
        Of the sensor.
    items : dict of Item
        By name, what was asked.
    fitted : dict of (value, sd)
        What was not declared.
    instant : float
        Steps that a row is late by convention: 0, 0.5 or -0.5.
    delay, delay_sd : float
        In all, steps.
    mount : Array
        Body to sensor, (3, 3).
    frame : str
        Axes of the readings.
    deviation : Array
        What the fit leaves of a row on each axis of the sensor, root mean square, (3,).
    spikes : Array
        Times of readings far off, s.
    left : list of (time, rows)
        What the fit leaves of each piece, body axes.
    corrected : list of Array
        Readings of each piece in body axes, less the bias.
    bound : float
        Root mean square of the error of the ideal.
    size : float
        Root mean square of the ideal reading.
    unexplained : float
        Share of it that is left where no few wrong things explain the readings; 0
        where some do.
    """

    name: str
    items: dict[str, Item]
    fitted: dict[str, tuple[Array, Array]]
    instant: float
    delay: float
    delay_sd: float
    mount: Float[Array, "3 3"]
    frame: str
    deviation: Float[Array, "3"]
    spikes: Float[Array, " s"]
    left: list[tuple[Array, Array]]
    corrected: Sequence[Array]
    bound: float
    size: float
    unexplained: float

    @property
    def wrong(self) -> list[str]:
        """Names of what is wrong."""
        return [each.name for each in self.items.values() if each.wrong]


def judged(
    sensor: SensorTerms,
    pieces: Sequence[Piece],
    rate: float,
    start: Expansion,
    frame: str,
) -> SensorAudit:
    """Judge a sensor: fewest wrong things, at a rate of false alarms."""
    search = Search(sensor)
    state, filled = start, None
    for turn in range(ROUNDS):
        rows = [sensor.rows(each, state) for each in pieces]
        nulls = search.nulls(state)
        if filled is not None:
            search.fill(pieces, rows, filled)
        regression = Regression(bands_of(rows), search.terms, nulls[0])
        if filled is None:
            search.mark(pieces, rows, search.wide @ regression.whole.value, ENDS)
        explained, which, fit = regression.fewest(nulls, rate)
        value = nulls[which].copy()
        for term in fit.terms:
            value[search.place[term.name]] = fit.of(term.name)[0]
        filled = search.wide @ value
        search.mark(pieces, rows, filled)
        after = search.moved(state, value)
        if turn and after.near(state):
            break
        state = after
    if explained == "no":  # no name is better than a guess
        right = [each for each in search.terms if not each.wrong]
        fit, value = regression.fit(right, nulls[which]), nulls[which].copy()
        for term in right:
            value[search.place[term.name]] = fit.of(term.name)[0]
    end = Converged(
        regression, fit, nulls[which], value, state, rows, INSTANTS[which], explained
    )
    return _told(sensor, pieces, end, rate, frame)


class Search:
    """Terms of a sensor, and their places among all parameters."""

    def __init__(self, sensor: SensorTerms) -> None:
        self._sensor, self.terms = sensor, sensor.terms()
        self.wide = np.hstack([each.basis for each in self.terms])
        ends = np.cumsum([each.basis.shape[1] for each in self.terms]).tolist()
        self.place = {
            each.name: slice(end - each.basis.shape[1], end)
            for each, end in zip(self.terms, ends, strict=True)
        }

    def first(self, name: str, value: Array) -> float:
        """First parameter of a term; 0 of a term that the sensor has not."""
        return float(value[self.place[name]][0]) if name in self.place else 0.0

    def nulls(self, state: Expansion) -> list[Array]:
        """Parameters of right readings, of each convention of rows."""
        found: list[Array] = []
        for instant in INSTANTS:
            null = np.zeros(self.wide.shape[1])
            for name, late in _now(state).items():
                if name in self.place:
                    right = instant if name == "delay" else 0.0
                    null[self.place[name].start] = right - late
            found.append(null)
        return found

    def fill(
        self, pieces: Sequence[Piece], rows: list[TermRows], filled: Array
    ) -> None:
        """Put what the model has in place of readings far off."""
        for piece, each in zip(pieces, rows, strict=True):
            bad = piece.bad[self._sensor.name]
            each.columns[bad, :, -1] = each.columns[bad, :, :-1] @ filled

    def mark(
        self,
        pieces: Sequence[Piece],
        rows: list[TermRows],
        filled: Array,
        ends: int = 0,
    ) -> None:
        """Mark readings far off, but not at ends, where columns of time are poor."""
        name = self._sensor.name
        for piece, each in zip(pieces, rows, strict=True):
            found = _spikes(each, filled)
            found[:ends] = found[len(found) - ends :] = False
            piece.bad[name] = found | piece.bad.get(name, np.zeros_like(found))

    def moved(self, state: Expansion, value: Array) -> Expansion:
        """Where the model is made linear next."""
        step = np.clip(value, -2.0, 2.0)
        mount = state.mount
        if "mount" in self.place:
            turn = from_rotation_vector(value[self.place["mount"]])
            mount = mount @ to_world(turn[None])[0]
        size = 1.0 + self.first("scale", value)
        motion = self._sensor.nominal() * (size if abs(size) > SILENT else 1.0)
        if self._sensor.motions:
            motion = motion + (self.wide @ value)[: self._sensor.motions]
        return Expansion(
            delay=state.delay + self.first("delay", step),
            late=state.late + self.first("instants", step),
            slow=state.slow + self.first("rate", step),
            past=state.past + self.first("difference", step),
            mount=mount, world=state.world, motion=motion,
        )  # fmt: skip


def _now(state: Expansion) -> dict[str, float]:
    return {
        "delay": state.delay, "instants": state.late, "rate": state.slow,
        "difference": state.past,
    }  # fmt: skip


def _spikes(rows: TermRows, filled: Array) -> Flags:
    left = rows.columns[:, :, -1] - rows.columns[:, :, :-1] @ filled
    noise = 1.4826 * np.median(np.abs(left - np.median(left, axis=0)), axis=0)
    size = np.sqrt(np.mean(rows.ideal**2) + np.mean(rows.reading**2))
    off = np.sum(np.abs(rows.errors), axis=0)
    for draws in rows.rounding:  # which a spline has more of at its ends
        off = off + np.abs(draws).max(axis=1, keepdims=True)
    far = np.abs(left) > SPIKE * noise + BOUND * off + SPIKE_SHARE * size
    found: Flags = far.any(axis=1)
    return found if found.mean() <= SPIKE_SHARE else np.zeros_like(found)


RESOLUTION: Final = {
    "scale": 1.0, "axes": 0.5, "delay": 1.0, "constant": 9.8, "linear": 1.0,
    "gravity": 1.0, "transport": 1.0, "instants": 1.0, "difference": 1.0, "rate": 2.0,
}  # fmt: skip
"""What is wholly wrong: without the term, turned by a third of a right angle, a step
late."""


class Converged(NamedTuple):
    """The last round of a search."""

    regression: Regression
    fit: TermFit
    null: Array  # values of what is right
    value: Array  # of all parameters
    state: Expansion
    rows: list[TermRows]
    instant: float
    explained: Explained


def _whole(name: str, sensor: SensorTerms, fit: TermFit) -> float:
    # size of a term that is wholly wrong
    if name == "constant" and sensor.name == "gyroscope":
        return 1.0
    if name in RESOLUTION:
        return RESOLUTION[name]
    arm = sensor.declared.lever  # a term of a lever arm
    if arm is None and "lever" in [each.name for each in fit.terms]:
        arm = fit.of("lever")[0]
    return max(0.0 if arm is None else float(np.linalg.norm(arm)), LEAST_ARM)


def _told(
    sensor: SensorTerms,
    pieces: Sequence[Piece],
    end: Converged,
    rate: float,
    frame: str,
) -> SensorAudit:
    regression, fit, null, value, state, rows, instant, explained = end
    wide = np.hstack([each.basis for each in regression.terms])
    wrong = [each for each in regression.terms if each.wrong]
    z = float(scipy.special.ndtri(1.0 - rate / 2.0 / len(wrong)))
    items: dict[str, Item] = {}
    for term in wrong:
        chosen = term in fit.terms
        own = fit if chosen else regression.fit((*fit.terms, term), null)
        got, sd, bound = own.of(term.name)
        got = got.copy()
        got[0] += _now(state).get(term.name, 0.0) - instant * (term.name == "delay")
        allowed = np.maximum(z * sd + bound, HELD.get(term.name, 0.0))
        keep = slice(0, 1) if term.name in TIMES else slice(None)
        size = _whole(term.name, sensor, fit)
        if abs(got[0]) < HELD.get(term.name, 0.0):
            chosen = False  # an instant within a step is nobody's
        items[term.name] = Item(
            term.name, got[keep], sd[keep], allowed[keep], chosen,
            allowed[keep] < PRESENT * size,
        )  # fmt: skip
    fitted = {each.name: fit.of(each.name)[:2] for each in fit.terms if not each.wrong}
    bias, of = fitted["bias"], items["constant"]
    items["constant"] = of._replace(judged=np.ones(3, bool))  # what is not seen is none
    if not of.wrong and np.linalg.norm(bias[0]) > LARGE * BIAS[sensor.name]:
        items["constant"] = Item(
            "constant", bias[0], bias[1], z * bias[1], True, np.ones(3, bool)
        )
    delay = items["delay"]
    left = [each.columns[:, :, -1] - each.columns[:, :, :-1] @ (wide @ value)
            for each in rows]  # fmt: skip
    constant = (wide @ value)[sensor.place["constant"]]
    corrected = [each.reading - constant for each in rows]
    held = np.zeros(len(value))
    for name in HELD:
        if (
            name in items
            and not items[name].wrong
            and name in [e.name for e in fit.terms]
        ):
            held[regression.place[name]] = fit.of(name)[0]
    error = [
        np.sqrt(np.mean(np.sum(np.abs(each.errors), axis=0) ** 2))
        + np.sqrt(sum(np.mean(x**2) for x in each.rounding))
        + np.sqrt(np.mean((each.columns[:, :, :-1] @ (wide @ held)) ** 2))
        for each in rows
    ]
    spikes = np.concatenate([p.time[p.bad[sensor.name]] for p in pieces])
    total = instant if not delay.wrong else float(state.delay)
    size = float(np.sqrt(np.mean([np.mean(each.ideal**2) for each in rows])))
    every = np.concatenate(left) @ state.mount.T
    rest = float(np.sqrt(np.mean(every**2)))
    return SensorAudit(
        name=sensor.name, items=items, fitted=fitted, instant=instant, delay=total,
        delay_sd=float(delay.sd[0]), mount=state.mount, frame=frame,
        deviation=np.sqrt(np.mean(every**2, axis=0)), spikes=spikes,
        left=[(p.time, each) for p, each in zip(pieces, left, strict=True)],
        corrected=corrected, bound=float(max(error)),
        size=size, unexplained=0.0 if explained == "all" else rest / max(size, 1e-300),
    )  # fmt: skip


TIMES: Final = ("delay", "instants", "difference")
HELD: Final = {"delay": 0.1, "instants": 0.1, "difference": 0.1, "rate": 0.6}
"""Steps within which a time is no finding: a force held over a step has no finer
instant, and a rate may be the mean over the step before, as a gyroscope's."""
LARGE: Final = 4.0  # times the deviation of a bias: no sensor's
LEAST_ARM: Final = 0.05  # m; a term of a lever arm that short need not be seen
_SIGNED: Final = [
    np.diag(signs)[list(order)]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]


class Look(NamedTuple):
    """A first look: delay, axes and frame that leave least."""

    state: Expansion
    frame: str


def look(
    sensor: SensorTerms, pieces: Sequence[Piece], guess: Array | None, delay: float
) -> Look:
    """Look at which axes and delay readings have, before anything is made linear."""
    mount = sensor.declared.mount
    default = np.eye(3) if mount is None else mount
    state = Expansion(delay, 0.0, 0.0, 0.0, np.eye(3), False, sensor.nominal())
    thin = [_thinned(each, len(pieces)) for each in pieces]

    # of the truth's rounding, too: a frame that leaves less is none
    known = sum(
        float(np.sum(draws**2)) * 3.0 / draws.shape[1]
        for p in thin
        for draws in sensor.rounding(p, p.time, state)
    )

    def model(late: float) -> tuple[Array, Array, Array]:
        made = [
            (*sensor.motion(p.fine, p.time - late * p.step, state), p) for p in thin
        ]
        motion = np.concatenate([each[0] for each in made])
        y = np.concatenate([p.readings[sensor.name] for *_, p in made])
        world = np.concatenate(
            [in_body(now.attitude, p.readings[sensor.name]) for _, now, p in made]
        )
        return motion, y, world

    def general(late: float) -> tuple[float, float]:
        motion, y, world = model(late)
        f = np.column_stack([motion @ sensor.nominal(), np.ones(len(y))])
        floor = SILENT**2 * float(np.sum(y**2)) + known
        return _left(f, y) + floor, _left(f, world) + floor

    far = np.concatenate([np.arange(1, 8), np.arange(8, FARTHEST + 1, 4)])
    grid = np.concatenate([[0.0], far, -far])
    grid = grid[np.abs(grid) < len(thin[0].time)]
    each = np.array([general(delay + late) for late in grid])
    best = each.min(axis=0)
    world = bool(best[1] < HALF * best[0])
    near = np.abs(grid) <= NEAR
    own = each[:, int(world)]
    late = grid[np.argmin(own)] if own.min() < HALF * own[near].min() else 0.0
    motion, y, turned = model(delay + late)
    y = turned if world else y
    frame = "world" if world else ""
    if world:
        default = np.eye(3)
        candidates: dict[str, Array] = {"": default}
    elif mount is None:
        default = _nearest(y, motion @ sensor.nominal(), guess)
        mirrored = _nearest(y, motion @ sensor.nominal(), guess, -1.0)
        candidates = {"": default, "reversed": mirrored}
    else:
        candidates = {"": default, "body": np.eye(3), "inverse": default.T}
        candidates |= {f"axes {k}": P @ default for k, P in enumerate(_SIGNED)}
    floor = SILENT**2 * float(np.sum(y**2)) + known
    squares = {name: _flexible(motion, y @ C) + floor for name, C in candidates.items()}
    least = min(squares, key=squares.__getitem__)
    if least and squares[least] < HALF * squares[""]:
        frame, default = least, candidates[least]
    return Look(
        Expansion(delay + float(late), 0.0, 0.0, 0.0, default, world, sensor.nominal()),
        frame,
    )


def _thinned(piece: Piece, count: int) -> Piece:
    # evenly, and in time order
    keep = slice(None, None, max(1, len(piece.time) * count // THIN))
    return Piece(
        piece.time[keep], {k: v[keep] for k, v in piece.readings.items()}, piece.step,
        piece.fine, piece.coarse, piece.noise, piece.position_sd, piece.attitude_sd,
    )  # fmt: skip


def _left(columns: Array, y: Array) -> float:
    found, *_ = np.linalg.lstsq(columns, y, rcond=None)
    return float(np.sum((y - columns @ found) ** 2))


def _flexible(motion: Array, y: Array) -> float:
    # squares that any coefficients of the motion leave
    eye = np.broadcast_to(np.eye(3), (len(y), 3, 3))
    columns = np.concatenate([motion, eye], axis=2).reshape(3 * len(y), -1)
    return _left(columns, y.reshape(-1, 1))


def _nearest(y: Array, f: Array, guess: Array | None, sign: float = 1.0) -> Array:
    # the rotation (or, by its sign, the reflection) from f to y; the guess, or none
    # at all, about axes that they do not tell
    B = y.T @ f
    B = B / max(float(np.linalg.norm(B)), 1e-300)
    B = B + (FAINT * np.eye(3) if guess is None else 100.0 * guess * (sign > 0.0))
    U, _, V = np.linalg.svd(B)
    return U @ np.diag([1.0, 1.0, sign * np.linalg.det(U @ V)]) @ V


def pieces_or_refuse(pieces: Sequence[Piece]) -> None:
    """Raise RefusedError where the truth is nowhere smooth."""
    if not pieces:
        msg = (
            "no part of the recording has a smooth truth with readings beside it; look "
            "at the clocks of both, or record longer between contacts"
        )
        raise RefusedError(msg)
