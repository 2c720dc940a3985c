r"""Columns of what may be wrong with a gyroscope and an accelerometer.

The ideal readings, in body axes, at the time :math:`t - d` of the truth:

.. math:: y &= M\omega + b \\
   y &= M\bigl(s R^T p'' + R^T c + \alpha \times r_E
   + \omega \times (\omega \times r_C) + k\, \omega \times R^T p'\bigr) + b
   \tag{W5}

Right are :math:`M = I`, s = 1, c the negative of gravity, :math:`r_E = r_C` the place
of the sensor, k = 0 and d = 0. The accelerations (p'' and :math:`\alpha`) may be of an
instant of their own, and the rate in the centripetal term; either reading may be the
mean over an interval, which adds the 24th part of its square times the second
derivative.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.geometry import cross
from simval.imu.audit.regression import AuditTerm, TermRows
from simval.imu.audit.simulated import LEAST, Declared, SimulatedImu
from simval.path import Kinematics, PosePath, in_body, in_world
from simval.shapes import Bool, Float

LONGEST: Final = 1 << 15  # rows of a piece
MOST: Final = 8  # pieces
HOLE: Final = 3.0  # steps without a row
SETTLED: Final = 1e-4  # of a step, or a radian
ENDS: Final = 6  # poses at an end of a path, where a spline is poor
BESIDE: Final = 10  # rows beside a place where the truth is not smooth
ROUGH: Final = 20.0  # times the usual change by the degree of the spline
ROUGH_SHARE: Final = 0.01  # of the specific force
BIAS: Final = {"gyroscope": 0.1, "accelerometer": 0.5}
"""Standard deviation of a bias that nobody declared, rad/s and m/s^2."""
FAR: Final = 10.0  # of a lever arm, m
EARTH: Final = 2.2e-3  # of gravity over the Earth, a standard deviation
COARSE: Final = 5
_DRAWS: Final = 3
_EIGHTH: Final = np.sqrt(12870.0)  # of white noise in its eighth difference
_EYE: Final = np.eye(3)


class Expansion(NamedTuple):
    """Where (W5) is made linear: times in steps, and the coefficients there."""

    delay: float
    late: float  # of the accelerations, beyond the delay
    slow: float  # of the centripetal term's rate, beyond the delay
    past: float  # of all terms of motion against the attitude
    mount: Float[Array, "3 3"]  # body to sensor
    world: bool  # whether readings are in world axes
    motion: Float[Array, " k"]  # coefficients of the columns of motion

    def near(self, other: "Expansion") -> bool:
        """Whether nothing moved any more."""
        moved = [self.delay - other.delay, self.late - other.late]
        moved += [
            self.slow - other.slow,
            self.past - other.past,
            *(self.mount - other.mount).ravel(),
        ]
        return float(np.abs(moved).max()) < SETTLED


@dataclass(slots=True, eq=False)
class Piece:
    """Part of a recording whose truth is smooth."""

    time: Float[Array, " n"]
    readings: dict[str, Float[Array, "n 3"]]
    step: float
    fine: PosePath
    coarse: PosePath
    noise: Callable[[Array, int], Array]  # of a white unit error of the truth
    position_sd: float  # by rounding
    attitude_sd: float
    bad: dict[str, Bool[NDArray[np.bool_], " n"]] = field(default_factory=dict)


def pieces_of(recording: SimulatedImu) -> tuple[list[Piece], list[Array]]:
    """Parts whose truth is smooth, and times where it is not."""
    found: list[Piece] = []
    rough: list[Array] = []
    for rows in _windows(recording):
        piece = _piece(recording, rows)
        if piece is None:
            continue
        off = _roughness(piece)
        rough.append(piece.time[off])
        near = np.convolve(off, np.ones(2 * BESIDE + 1), "same") > 0.0
        for a, b in _runs(~near):
            if b - a >= LEAST // 2:
                found.append(_part(piece, slice(a, b)))
    return found, rough


def _windows(recording: SimulatedImu) -> list[tuple[int, int]]:
    time, most = recording.time, HOLE * recording.step
    holes = np.flatnonzero(np.diff(time) > most) + 1
    edges = np.unique([0, *holes, len(time)])
    parts = [
        (int(a), int(b))
        for start, stop in pairwise(edges)
        for a, b in _even(int(start), int(stop))
        if b - a >= LEAST
    ]
    chosen = np.unique(np.linspace(0, len(parts) - 1, MOST).round().astype(int))
    return [parts[k] for k in chosen] if parts else []


def _even(start: int, stop: int) -> list[tuple[int, int]]:
    count = -(-(stop - start) // LONGEST)
    edges = np.linspace(start, stop, count + 1).astype(int)
    return [*pairwise(edges.tolist())]


def _piece(recording: SimulatedImu, rows: tuple[int, int]) -> Piece | None:
    time = recording.time[slice(*rows)]
    poses = recording.poses
    step = float(np.median(np.diff(poses)))
    around = slice(*np.searchsorted(
        poses, [time[0] - 2 * ENDS * step, time[-1] + 2 * ENDS * step]
    ))  # fmt: skip
    own = poses[around]
    if len(own) < LEAST // 2 or np.diff(own).max() > HOLE * step:
        return None
    position, attitude = recording.position[around], recording.attitude[around]
    fine = PosePath(own, position, attitude)
    coarse = PosePath(own, position, attitude, COARSE)
    white = np.random.Generator(np.random.SFC64(len(own))).standard_normal
    spline = scipy.interpolate.make_interp_spline(
        (own - own[0]) / step, white((len(own), _DRAWS)), 7
    )
    reach = ENDS * step
    inside = (time >= fine.start + reach) & (time <= fine.stop - reach)
    kept = {
        name: value[slice(*rows)][inside]
        for name in ("gyroscope", "accelerometer")
        if (value := getattr(recording, name)) is not None
    }
    if np.count_nonzero(inside) < LEAST // 2:
        return None
    origin = float(own[0])
    return Piece(
        time[inside], kept, recording.step, fine, coarse,
        lambda t, k: spline((t - origin) / step, k) / step**k,
        _rounding(position - position.mean(axis=0)), _rounding(fine._poses[:, 3:]),
    )  # fmt: skip


def _part(piece: Piece, rows: slice) -> Piece:
    return Piece(
        piece.time[rows], {k: v[rows] for k, v in piece.readings.items()}, piece.step,
        piece.fine, piece.coarse, piece.noise, piece.position_sd, piece.attitude_sd,
    )  # fmt: skip


def _rounding(rows: Float[Array, "n k"]) -> float:
    # white error of a smooth course, by what a polynomial of the seventh degree leaves
    left = np.sort(np.diff(rows, 8, axis=0) ** 2, axis=0)
    return float(
        np.sqrt(left[: max(int(0.95 * len(left)), 1)].mean(axis=0).max()) / _EIGHTH
    )


def _roughness(piece: Piece) -> Bool[NDArray[np.bool_], " n"]:
    zero, g = np.zeros(3), np.array([0.0, 0.0, -9.8])
    fine, coarse = (
        each.at(piece.time).specific_force(zero, g)
        for each in (piece.fine, piece.coarse)
    )
    change = np.linalg.norm(fine - coarse, axis=1)
    size = float(np.sqrt(np.mean(np.median(fine**2, axis=0).sum())))
    return change > np.maximum(ROUGH * np.median(change), ROUGH_SHARE * size)


def _runs(good: Bool[NDArray[np.bool_], " n"]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    return [*zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]


class SensorTerms:
    """What a sensor's columns are, by their names."""

    names: tuple[tuple[str, int], ...]
    name: str
    motions: int  # columns of motion, which come first

    def __init__(self, declared: Declared, step: float) -> None:
        self.declared, self.step = declared, step

    @cached_property
    def place(self) -> dict[str, slice]:
        """Columns by name."""
        ends = np.cumsum([count for _, count in self.names]).tolist()
        return {
            name: slice(end - count, end)
            for (name, count), end in zip(self.names, ends, strict=True)
        }

    def basis(self, *parts: tuple[str, Array]) -> Array:
        """Parameters in the columns, as sums of parts of some."""
        width = sum(count for _, count in self.names)
        made = np.zeros((width, parts[0][1].shape[1]))
        for name, own in parts:
            made[self.place[name]] += own
        return made

    def term(
        self, name: str, *parts: str, wrong: bool = True, sd: float = np.inf
    ) -> AuditTerm:
        """All parameters of some columns, side by side."""
        own = [self.place[each] for each in parts or (name,)]
        width = sum(count for _, count in self.names)
        basis = np.hstack([np.eye(width)[:, each] for each in own])
        return AuditTerm(name, basis, wrong, sd)

    def matrix_terms(self) -> list[AuditTerm]:
        """Scale, axes that are not square or not those declared, and a mount."""
        turns = np.array([np.cross(_EYE[k], _EYE).T.ravel() for k in range(3)]).T
        shears = [np.diag([1.0, -1.0, 0.0]), np.diag([0.5, 0.5, -1.0])]
        for k in range(3):
            each = np.zeros((3, 3))
            each[k - 1, k - 2] = each[k - 2, k - 1] = 1.0
            shears.append(each)
        square: Array = np.array([each.ravel() for each in shears]).T
        found = [AuditTerm("scale", self.basis(("matrix", _EYE.reshape(9, 1))))]
        if self.declared.mount is None:
            found.append(AuditTerm("mount", self.basis(("matrix", turns)), False, 1.0))
        else:
            square = np.asarray(np.hstack([turns, square]))
        return [*found, AuditTerm("axes", self.basis(("matrix", square)))]

    def terms(self) -> list[AuditTerm]:
        """All that is asked."""
        raise NotImplementedError

    def nominal(self) -> Array:
        """Coefficients of the columns of motion in an ideal reading."""
        raise NotImplementedError

    def motion(
        self, path: PosePath, time: Array, state: Expansion
    ) -> tuple[Array, Kinematics]:
        """Columns of motion in body axes, (n, 3, k), and the truth at that time."""
        raise NotImplementedError

    def timing(
        self,
        now: Kinematics,
        motion: Array,
        state: Expansion,
        rate: Callable[[Array], Array],
    ) -> tuple[Array, ...]:
        """Columns of time beside delay and width."""
        return ()

    def rounding(
        self, piece: Piece, time: Array, state: Expansion
    ) -> tuple[Array, ...]:
        """Draws of the error of the ideal reading by the truth's rounding."""
        raise NotImplementedError

    def rows(self, piece: Piece, state: Expansion) -> TermRows:
        """Rows of a piece, made linear at a state."""
        h, t = piece.step, piece.time - state.delay * piece.step

        def rate(rows: Array) -> Array:  # a step
            return np.gradient(rows, piece.time, axis=0) * h

        motion, now = self.motion(piece.fine, t, state)
        ideal, own = motion @ self.nominal(), motion @ state.motion
        coarse = self.motion(piece.coarse, t, state)[0] @ state.motion
        bent = rate(rate(own))
        held = np.zeros_like(own)  # of a force that is held over a step: its kinks
        held[1:-1] = own[2:] - 2.0 * own[1:-1] + own[:-2] - bent[1:-1]
        matrix = (_EYE[:, :, None] * ideal[:, None, None, :]).reshape(-1, 3, 9)
        reading = self.in_body(piece.readings[self.name], now, state)
        columns = [
            motion[:, :, : self.motions], np.broadcast_to(_EYE, (len(t), 3, 3)),
            -rate(own)[..., None], bent[..., None] / 24.0,
            *self.timing(now, motion, state, rate), matrix,
            (reading - ideal)[..., None],
        ]  # fmt: skip
        turning: Array = np.zeros_like(own)
        if self.name == "gyroscope":  # a mean rate is no mean of turns
            turning = cross(now.rate, now.angular_acceleration) * h * h
        return TermRows(
            np.concatenate(columns, axis=2), ideal,
            (own - coarse, bent / 12.0, held / 2.0, turning / 12.0),
            self.rounding(piece, t, state), reading,
        )  # fmt: skip

    @staticmethod
    def in_body(reading: Array, now: Kinematics, state: Expansion) -> Array:
        """Readings in body axes, by the axes that they are taken to have."""
        turned = in_body(now.attitude, reading) if state.world else reading
        return turned @ state.mount


class GyroscopeTerms(SensorTerms):
    """Angular rate."""

    name = "gyroscope"
    names = (("constant", 3), ("delay", 1), ("width", 1), ("matrix", 9))
    motions = 0

    def terms(self) -> list[AuditTerm]:
        """Terms of a gyroscope."""
        return [
            self.term("bias", "constant", wrong=False, sd=BIAS[self.name]),
            *self.matrix_terms(), self.term("delay", "delay", "width"),
            self.term("constant"),
        ]  # fmt: skip

    def nominal(self) -> Array:
        """The rate."""
        return np.ones(1)

    def motion(
        self, path: PosePath, time: Array, state: Expansion
    ) -> tuple[Array, Kinematics]:
        """The rate alone."""
        now = path.at(time)
        return now.rate[..., None], now

    def rounding(
        self, piece: Piece, time: Array, state: Expansion
    ) -> tuple[Array, ...]:
        """Twice the derivative of the quaternion's."""
        return (2.0 * piece.attitude_sd * piece.noise(time, 1),)


class AccelerometerTerms(SensorTerms):
    """Specific force."""

    name = "accelerometer"
    names = (
        ("linear", 1), ("gravity", 3), ("Euler", 3), ("centripetal", 3),
        ("transport", 1), ("constant", 3), ("delay", 1), ("width", 1),
        ("late", 1), ("wide", 1), ("slow", 1), ("turned", 1), ("matrix", 9),
    )  # fmt: skip
    motions = 11

    def terms(self) -> list[AuditTerm]:
        """Terms of an accelerometer."""
        both = ("Euler", _EYE), ("centripetal", _EYE)
        declared = self.declared
        lever = AuditTerm("lever", self.basis(*both), declared.lever is not None)
        if declared.lever is None:
            lever = lever._replace(sd=FAR)
        found = [self.term("bias", "constant", wrong=False, sd=BIAS[self.name]), lever]
        if declared.gravity is None:
            up = self.nominal()[self.place["gravity"], None]
            found.append(AuditTerm("g", self.basis(("gravity", up)), False, EARTH))
        return [
            *found, *self.matrix_terms(),
            *map(self.term, ("linear", "gravity", "Euler", "centripetal", "transport")),
            self.term("delay", "delay", "width"), self.term("instants", "late", "wide"),
            AuditTerm("difference", np.hstack([
                self.basis(("turned", np.eye(1))),
                self.basis(("wide", np.eye(1))),
            ])),
            self.term("rate", "slow"), self.term("constant"),
        ]  # fmt: skip

    def nominal(self) -> Array:
        """Of (W5)."""
        down, lever = self.declared.down, self.declared.lever
        r = np.zeros(3) if lever is None else lever
        up = -down / np.linalg.norm(down)
        return np.concatenate([[1.0], up, r, r, [0.0]])

    def motion(
        self, path: PosePath, time: Array, state: Expansion
    ) -> tuple[Array, Kinematics]:
        """The columns of (W5) that have a coefficient."""
        now = path.at(time)
        late, past = (state.late + state.past) * self.step, state.past * self.step
        then = path.at(time - late) if late else now
        turned = path.at(time - past).attitude if past else now.attitude
        slow = past + state.slow * self.step
        rate = path.at(time - slow).rate if slow else now.rate
        R, g = now.attitude, float(np.linalg.norm(self.declared.down))

        def here(rows: Array, other: Array) -> Array:  # in body axes of now
            return rows if other is R else in_body(R, in_world(other, rows))

        columns = [in_body(R, then.acceleration)]
        columns += [g * R[:, k] for k in range(3)]
        if past:  # the whole acceleration is of then
            swung = [cross(then.angular_acceleration, axis) for axis in _EYE]
            columns += [here(each, then.attitude) for each in swung]
        else:  # the angular acceleration alone, about where the sensor is now
            turn = here(then.angular_acceleration, then.attitude)
            columns += [cross(turn, axis) for axis in _EYE]
        pulled = [cross(rate, cross(rate, axis)) for axis in _EYE]
        columns += [here(each, turned) for each in pulled]
        columns.append(cross(now.rate, in_body(R, now.velocity)))
        return np.stack(columns, axis=-1), now

    def timing(
        self,
        now: Kinematics,
        motion: Array,
        state: Expansion,
        rate: Callable[[Array], Array],
    ) -> tuple[Array, ...]:
        """Accelerations of another instant, or a mean, and a rate of another."""
        R, own = now.attitude, state.motion
        pulled = motion[..., self.place["centripetal"]] @ own[self.place["centripetal"]]
        moved = motion[..., self.place["linear"]] @ own[self.place["linear"]]
        swung = motion[..., self.place["Euler"]]
        turn = np.stack([swung[:, 2, 1], -swung[:, 2, 0], swung[:, 1, 0]], axis=1)
        arm = own[self.place["Euler"]]

        def later(rows: Array) -> Array:  # a step, of a vector of the world
            return in_body(R, rate(in_world(R, rows)))

        late = later(moved) + cross(later(turn), arm)
        whole = moved + swung @ arm
        return (
            -late[..., None], later(later(whole))[..., None] / 24.0,
            -rate(pulled)[..., None], -later(whole + pulled)[..., None],
        )  # fmt: skip

    def rounding(
        self, piece: Piece, time: Array, state: Expansion
    ) -> tuple[Array, ...]:
        """The second derivatives of both, and gravity turned."""
        q, g = 2.0 * piece.attitude_sd, float(np.linalg.norm(self.declared.down))
        r = float(np.linalg.norm(state.motion[self.place["Euler"]]))
        second = piece.noise(time, 2)
        return (
            piece.position_sd * second, q * g * piece.noise(time, 0), q * r * second,
        )  # fmt: skip
