"""One sensor of a recording, judged: the fewest wrong things that explain it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array, Mask
from simval.geometry import attitude_matrix, cross_matrix, from_rotation_vector
from simval.imu.audit.ideal import BIAS, SILENT, Ideal, IdealState, TermRows
from simval.imu.audit.pieces import Piece, Pieces, TrueMotion
from simval.imu.audit.regression import TINY, Regression, TermFit
from simval.imu.audit.terms import Flaw
from simval.path import Kinematics, PosePath
from simval.shapes import Float

ROUNDS: Final = 6
FARTHEST: Final = 64  # steps of delay that are looked at
NEAR: Final = 2.0  # steps within which a delay needs no look around
HALF: Final = 0.5  # of the squares: another frame must leave less
THIN: Final = 600  # rows for a look
FAINT: Final = 1e-3  # of a direction: below it a mount is the declared axes'
SPIKE: Final = 12.0  # times the noise
BLOCK: Final = 32  # rows whose mean is all but free of the rounding of poses
SPIKE_SHARE: Final = 0.02  # of the reading, and of the rows
BOUND: Final = 3.0
PRESENT: Final = 0.5  # a term is judged where its absence would be seen
LARGE: Final = 4.0  # times the deviation of a bias: no sensor's
LEAST_ARM: Final = 0.05  # m; a term of a lever arm that short need not be seen
_TURNS: Final = [cross_matrix(each) for each in np.eye(3)]
_SIGNED: Final = [
    np.diag(signs)[list(order)]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]


class Item(NamedTuple):
    """One term that was judged: its value, what is allowed, and the verdict.

    Attributes
    ----------
    term : Flaw
        What may be wrong.
    value, sd, allowed : Array
        Deviation from what is right, its standard deviation, and how far it may be off:
        chance at the stated rate and the error of the ideal.
    wrong : bool
        Whether it is one of the fewest that explain the readings.
    judged : Array
        Of each number, whether the motion tells it.
    """

    term: Flaw
    value: Float[Array, " m"]
    sd: Float[Array, " m"]
    allowed: Float[Array, " m"]
    wrong: bool
    judged: Mask

    @property
    def name(self) -> str:
        """Name of the term."""
        return self.term.name


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorAudit:
    """Result of the audit of one sensor.

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
    constant : Array
        Bias and constant, body axes, (3,).
    deviation : Array
        What the fit leaves of a row on each axis of the sensor, root mean square, (3,).
    spikes : Array
        Times of readings far off, s.
    left : list of Array
        What the fit leaves of each piece, body axes.
    bound : float
        Root mean square of the error of the ideal in the longest piece.
    slow_bound : float
        The same of means over some rows, as far as an integral keeps it.
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
    constant: Float[Array, "3"]
    deviation: Float[Array, "3"]
    spikes: Float[Array, " s"]
    left: list[Array]
    bound: float
    slow_bound: float
    size: float
    unexplained: float

    @property
    def wrong(self) -> list[str]:
        """Names of the terms that are wrong."""
        return [each.name for each in self.items.values() if each.wrong]


def judged(
    ideal: Ideal, pieces: Pieces, rate: float, guess: Array | None
) -> SensorAudit:
    """Judge a sensor by the fewest errors that explain it, at a false-alarm rate."""
    state, frame = look(ideal, pieces.smooth, guess)
    bad = [np.zeros(len(each.time), bool) for each in pieces.smooth]
    value: Array = np.zeros(0)
    for turn in range(ROUNDS):
        rows = [ideal.rows(each, state) for each in pieces.smooth]
        given = [each.target.copy() for each in rows]
        for each, far in zip(rows, bad, strict=True):
            if turn:  # what the model has, in place of readings far off
                each.target[far] = (each.columns @ value)[far]
        regression = Regression(rows, ideal.terms)
        explained, fit = regression.fewest(rate)
        value = regression.whole.value
        size = _size(np.vstack([each.ideal for each in rows]))
        for each, far in zip(rows, bad, strict=True):
            found = _far(each, each.left(value), size)
            far |= found & (found.mean() <= SPIKE_SHARE)
        before, state = state, ideal.moved(state, regression.split(fit.value))
        if turn and state.near(before):
            break
    if explained == "no":  # no name is better than a guess
        right = tuple(each for each in ideal.terms if not each.wrong)
        fit = regression.fit(right, fit.instant)
    items = _items(ideal, regression, fit, rate)
    left = [
        _left(each, own, far, fit.value, size)
        for each, own, far in zip(rows, given, bad, strict=True)
    ]
    spikes = [piece.time[far] for piece, far in zip(pieces.smooth, bad, strict=True)]
    if explained == "all" and not frame and not any(x.wrong for x in items.values()):
        first = ideal.rows(pieces.start, state)
        far = _far(first, np.vstack([first.left(fit.value), left[0]]), size)
        spikes.append(pieces.start.time[far[: len(first.ideal)]])
    own, sd = regression.split(fit.value), regression.split(fit.sd)
    every = np.concatenate(left) @ state.mount.T
    rest = _size(every) / max(size, TINY)
    delay = items["delay"]
    names = [each.name for each in ideal.terms if not each.wrong]
    longest = max(rows, key=lambda each: len(each.ideal))
    return SensorAudit(
        name=ideal.name, items=items,
        fitted={name: (own[name], sd[name]) for name in names},
        instant=fit.instant, delay=fit.instant + delay.wrong * float(delay.value[0]),
        delay_sd=float(delay.sd[0]), mount=state.mount, frame=frame,
        deviation=np.sqrt(np.mean(every**2, axis=0)), spikes=np.concatenate(spikes),
        left=left,
        constant=own["bias"] + own["constant"],
        bound=_size(np.sum(np.abs(longest.errors), axis=0)),
        slow_bound=_size(
            np.sum([np.abs(block_means(each)) for each in longest.errors], axis=0)
        ),
        size=size, unexplained=0.0 if explained == "all" else rest,
    )  # fmt: skip


def _left(
    rows: TermRows, given: Array, far: Mask, value: Array, size: float
) -> Float[Array, "n 3"]:
    # what is left, where readings are far off by what is chosen, too, and their flags
    rows.target[:] = given
    far &= _far(rows, rows.left(value), size)
    rows.target[far] = (rows.columns @ value)[far]
    return rows.left(value)


def _items(
    ideal: Ideal, regression: Regression, fit: TermFit, rate: float
) -> dict[str, Item]:
    wrong = [each for each in ideal.terms if each.wrong]
    z = float(scipy.special.ndtri(1.0 - rate / 2.0 / len(wrong)))
    lever, own = ideal.declared.lever, regression.split(fit.value)
    arm = np.linalg.norm(own.get("lever", 0.0) if lever is None else lever)
    items: dict[str, Item] = {}
    for term in wrong:
        chosen = term in fit.terms
        beside = fit if chosen else regression.fit((*fit.terms, term), fit.instant)
        at = regression.place[term.name]
        at = slice(at.start, at.start + 1) if term.name in ideal.times else at
        value, sd = beside.value[at], beside.sd[at]
        if term.name == "delay":
            value = value - fit.instant
        allowed = np.maximum(z * sd + regression.bound(beside)[at], term.held)
        least = term.whole or max(float(arm), LEAST_ARM)
        items[term.name] = Item(
            term, value, sd, allowed, chosen and bool(abs(value[0]) >= term.held),
            allowed < PRESENT * least,
        )  # fmt: skip
    bias, sd = own["bias"], regression.split(fit.sd)["bias"]
    constant = items["constant"]
    if not constant.wrong and np.linalg.norm(bias) > LARGE * BIAS[ideal.name]:
        constant = Item(constant.term, bias, sd, z * sd, True, constant.judged)
    # a component that is not seen counts as zero
    items["constant"] = constant._replace(judged=np.ones(3, bool))
    return items


def block_means(rows: Float[Array, "n 3"]) -> Float[Array, "k 3"]:
    """Means of `BLOCK` rows: derivatives of rounded poses are loud in rows alone."""
    n = max(1, min(BLOCK, len(rows) // 16))
    return rows[: len(rows) // n * n].reshape(-1, n, 3).mean(axis=1)


def _far(rows: TermRows, left: Float[Array, "n 3"], size: float) -> Mask:
    # readings far off, relative to the size of all readings
    noise = 1.4826 * np.median(np.abs(left - np.median(left, axis=0)), axis=0)
    size = np.hypot(size, _size(rows.reading))
    *errors, rounding = np.abs(rows.errors)  # of which a spline has more at its ends
    off = np.sum(errors, axis=0) + rounding.max(axis=1, keepdims=True)
    far = np.abs(left[: len(off)]) > SPIKE * noise + BOUND * off + SPIKE_SHARE * size
    return np.any(far, axis=1)


def _size(rows: Array) -> float:
    return float(np.sqrt(np.mean(rows**2)))


def look(
    ideal: Ideal, pieces: Sequence[Piece], guess: Array | None
) -> tuple[IdealState, str]:
    """Find the axes, the delay and the frame of the readings, before linearising."""
    thin = [
        each.rows(slice(None, None, max(1, len(each.time) * len(pieces) // THIN)))
        for each in pieces
    ]
    given = np.concatenate([each.readings[ideal.name] for each in thin])

    def along(paths: Sequence[PosePath]) -> TrueMotion:
        def at(late: float) -> Kinematics:
            each = [p.at(x.time - late) for p, x in zip(paths, thin, strict=True)]
            return Kinematics(*map(np.concatenate, zip(*each, strict=True)))

        return at

    at = along([each.path for each in thin])
    first = np.eye(len(ideal.times))[0]

    def seen(late: float) -> tuple[dict[str, Array], Array]:
        # columns of motion, and readings turned from the world
        made = ideal.motion(at, late * ideal.step * first)
        return made, np.vecmat(given, at(late * ideal.step).attitude)

    rounded = ideal.motion(along([each.rounded for each in thin]), 0.0 * first)
    known = float(np.sum((rounded["ideal"] - seen(0.0)[0]["ideal"]) ** 2))

    def left(columns: Array, y: Array) -> float:
        # squares that any coefficients leave, what is no reading, and the truth's
        # rounding: a frame that leaves less is none
        found, *_ = np.linalg.lstsq(columns, y, rcond=None)
        squares = np.sum((y - columns @ found) ** 2) + SILENT**2 * np.sum(y**2)
        return float(squares) + known

    far = np.concatenate([np.arange(1, 8), np.arange(8, FARTHEST + 1, 4)])
    grid = np.concatenate([[0.0], far, -far])
    grid = grid[np.abs(grid) < len(thin[0].time)]
    squares = []
    for late in grid:
        made, turned = seen(late)
        columns = _late_columns(ideal, made)
        squares.append([left(columns, each) for each in (given, turned)])
    best = np.min(squares, axis=0)
    world = bool(best[1] < HALF * best[0])
    by_delay = np.array(squares)[:, int(world)]
    here = by_delay[np.abs(grid) <= NEAR].min()
    late = float(grid[np.argmin(by_delay)]) if by_delay.min() < HALF * here else 0.0
    made, turned = seen(late)
    y, declared, right = turned if world else given, ideal.declared.mount, made["ideal"]
    if world:
        candidates: list[tuple[str, Array]] = [("world", np.eye(3))]
    elif declared is None:
        candidates = _by_hands(ideal.name, y, right, guess)
    else:
        candidates = [("", declared), ("body", np.eye(3)), ("inverse", declared.T)]
        candidates += [("exchanged", each @ declared) for each in _SIGNED]
    columns = np.hstack([
        np.tile(np.eye(3), (len(y), 1)), *(x.reshape(y.size, -1) for x in made.values())
    ])  # fmt: skip
    own = [left(columns, (y @ mount).reshape(-1, 1)) for _, mount in candidates]
    least = int(np.argmin(own))
    frame, mount = candidates[least if own[least] < HALF * own[0] else 0]
    return IdealState(late * first, mount, world), frame


def _nearest(y: Array, right: Array, guess: Array | None, sign: float) -> Array:
    # the rotation (or, by its sign, the reflection) from what is right to y; the guess,
    # or none at all, about axes that they do not tell
    B = y.T @ right
    B = B / max(float(np.linalg.norm(B)), TINY)
    B = B + (FAINT * np.eye(3) if guess is None else 100.0 * guess * (sign > 0.0))
    U, _, V = np.linalg.svd(B)
    return U @ np.diag([1.0, 1.0, sign * np.linalg.det(U @ V)]) @ V


def _late_columns(ideal: Ideal, made: dict[str, Array]) -> Array:
    # a lever arm that is not declared is among them, or a delay stands for it
    parts = [made["ideal"], np.ones(len(made["ideal"]))]
    if "lever" in made and ideal.declared.lever is None:
        parts.append(made["lever"].reshape(-1, 9))
    return np.column_stack(parts)


def _by_hands(
    name: str, y: Array, right: Array, guess: Array | None
) -> list[tuple[str, Array]]:
    # mounts of right-handed and of left-handed axes
    near = [_nearest(y, right, guess, sign) for sign in (1.0, -1.0)]
    if name == "gyroscope":  # even a faint motion may distinguish them
        near = [_settled(y, right, each) for each in near]
    return [*zip(("", "reversed"), near, strict=True)]


def _settled(y: Array, right: Array, mount: Array) -> Array:
    # turned to the least squares, with a constant fitted too
    turns = np.einsum("kij,nj->nik", _TURNS, right).reshape(-1, 3)
    columns = np.hstack([turns, np.tile(np.eye(3), (len(y), 1))])
    for _ in range(ROUNDS):
        off = (y @ mount - right).ravel()
        found, *_ = np.linalg.lstsq(columns, off, rcond=FAINT**2)
        mount = mount @ attitude_matrix(from_rotation_vector(-found[:3]))
    return mount
