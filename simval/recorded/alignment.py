"""The truth on the log's clock, in the sensor's axes, in the world north-west-up.

Way of an alignment: the offsets that are likely, a fit at each for each class of
meaning (`attitudes`), the best of them, its error bars, then its world. Refused
where the best explains little of what the gyroscope shows, where it is not clearly
better than another, and where the motion leaves an axis open.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from simval.arrays import Array, frozen
from simval.errors import RefusedError
from simval.logs import Truth
from simval.recorded.attitudes import (
    Attitudes,
    Meaning,
    after,
    attitudes,
    meanings,
    of_matrix,
    rotation_vector,
    turned,
)
from simval.recorded.blocks import Measured
from simval.recorded.fit import TurnErrors, TurnFit, fit_turns, polar, turn_errors
from simval.recorded.search import likely_offsets
from simval.recorded.turns import stretches
from simval.recorded.world import TruthWorld, World, find_world, taken_world
from simval.shapes import Float
from simval.statics import Intervals

MOST_LEFT: Final = 0.25
"""Share of the variance of the gyroscope's turns that a truth may leave unexplained.
Truths of other logs are refused (tests/test_recorded_refusals.py); the least that one
was seen to leave is 0.43, and the two recordings of BROAD leave 0.001."""

BETTER: Final = 4.0
"""Factor in that share by which the best must be ahead of any other meaning or offset;
two halves of the residual are then each of its size."""

TRIES: Final = 8
"""Steps of a fit that may be at a wrong offset; from a right one it takes four."""

WIDEST: Final = np.radians(2.0)
"""Standard deviation of an axis of the sensor in the truth's, beyond which the error of
a filter would be that of the alignment."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """What lies between a log and its truth.

    Attributes
    ----------
    meaning : Meaning
        Of the recorded numbers.
    same : tuple of Meaning
        Further meanings that are the same motion in other axes.
    better : float
        Factor by which another meaning leaves more variance unexplained.
    fit : TurnFit
        Clock, axes and gyroscope.
    errors : TurnErrors
        Its error bars.
    rotation : Array
        Rotation vector from the truth's body to the sensor, rad, (3,).
    world : World
        North and up in the truth's world.
    attitude : Array
        True attitudes at the log's rows, north-west-up to sensor, (n, 4), NaN where
        there is none.
    noise : Array
        Standard deviation of the truth from row to row at rest, rad, (3,); NaN without
        a rest.
    """

    meaning: Meaning
    same: tuple[Meaning, ...]
    better: float
    fit: TurnFit
    errors: TurnErrors
    rotation: Float[Array, "3"]
    world: World
    attitude: Float[Array, "n 4"]
    noise: Float[Array, "3"]

    def __post_init__(self) -> None:
        for name in ("rotation", "attitude", "noise"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def offset(self) -> Measured:
        """What the truth's clock shows minus the log's in the middle of the log, s."""
        return Measured(
            value=self.fit.offset, sd=self.errors.offset, dof=self.errors.dof
        )

    @property
    def drift(self) -> Measured:
        """What that grows by, s a second."""
        return Measured(value=self.fit.drift, sd=self.errors.drift, dof=self.errors.dof)

    @property
    def axes(self) -> tuple[Measured, ...]:
        """The rotation vector with its error bars, rad."""
        sd = np.sqrt(np.diagonal(self.errors.rotation))
        return tuple(
            Measured(value=float(v), sd=float(s), dof=self.errors.dof)
            for v, s in zip(self.rotation, sd, strict=True)
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Tried:
    meaning: Meaning
    offset: float
    fit: TurnFit


def align(
    truth: Truth,
    time: Float[Array, " n"],
    gyro: Float[Array, "n 3"],
    force: Float[Array, "n 3"],
    field: Float[Array, "n 3"],
    rests: Intervals,
    world: TruthWorld | None = None,
) -> Alignment:
    """Align a truth with a log, see the module.

    Parameters
    ----------
    truth : Truth
        As from `simval.logs.read_truth`.
    time : Array
        Times of the log's rows, s, (n,).
    gyro : Array
        Angular rate, the average over the step that ends at a row, any unit, (n, 3).
    force : Array
        Specific force, m/s^2, (n, 3).
    field : Array
        Magnetic field, any unit, (n, 3).
    rests : Array
        Rows ``start <= k < stop`` of each rest, (m, 2).
    world : {"NWU", "ENU", "NED", "estimated"}, optional
        The truth's world; default that of its data set, else the nearest one;
        ``estimated`` turns the truth to what rests and field show.

    Returns
    -------
    Alignment
        What lies between them, with error bars, and the aligned attitudes.

    Raises
    ------
    RefusedError
        If it cannot be done without a guess.
    """
    best, others = _best(truth, time, gyro)
    _require_it(best, others)
    same, meaning, fit = _refined(truth, time, gyro, best)
    errors = turn_errors(fit)
    _require_axes(fit, errors)
    Q = polar(fit.linear)
    turn = of_matrix(Q)
    read = attitudes(truth.time, truth.components, meaning)
    raw = read.at(time + fit.offset + fit.drift * (time - fit.middle))
    q = after(raw, turn)
    shown = find_world(q, force, field, rests, errors.rotation)
    there = taken_world(shown, truth.columns, world)
    return Alignment(
        meaning=meaning,
        same=same,
        better=min((o.fit.share for o in others), default=np.inf) / best.fit.share,
        fit=fit,
        errors=errors,
        rotation=rotation_vector(turn),
        world=there,
        attitude=_in_world(q, there),
        noise=_noise(read, time[rests] + fit.offset),
    )


def _best(
    truth: Truth, time: Float[Array, " n"], gyro: Float[Array, "n 3"]
) -> tuple[_Tried, list[_Tried]]:
    # one meaning of each class is enough, see `attitudes`
    pieces = stretches(time, gyro, coarse=True)
    tried: list[_Tried] = []
    pair = meanings(truth.scalar)[:2]
    first = attitudes(truth.time, truth.components, pair[0])
    for start in likely_offsets(time, gyro, first):
        for meaning in pair:
            read = attitudes(truth.time, truth.components, meaning)
            try:
                fit = fit_turns(pieces, read, start, steps=TRIES)
            except RefusedError:
                continue
            tried.append(_Tried(meaning=meaning, offset=start, fit=fit))
    if not tried:
        fit_turns(pieces, first, likely_offsets(time, gyro, first)[0])  # says why
    best = min(tried, key=lambda each: each.fit.share)
    apart = [
        each
        for each in tried
        if each.meaning != best.meaning
        or abs(each.fit.offset - best.fit.offset) > 10.0 * pieces.seconds[0]
    ]
    return best, apart


def _require_it(best: _Tried, others: list[_Tried]) -> None:
    share = best.fit.share
    if not (share <= MOST_LEFT and best.fit.converged):
        msg = (
            f"no reading of the truth follows the gyroscope: the best ({best.meaning}, "
            f"offset {best.fit.offset:.3f} s) leaves {100 * share:.0f} % of the "
            f"variance of its turns, and at most {100 * MOST_LEFT:.0f} % is allowed; "
            "give the truth of this log (--truth), name its columns (--truth-columns), "
            "or look at the gyroscope's columns (--columns)"
        )
        raise RefusedError(msg)
    for other in others:
        if not other.fit.share >= BETTER * share:
            msg = (
                f"the truth can be read in two ways: {best.meaning} at an offset of "
                f"{best.fit.offset:.3f} s leaves {100 * share:.2g} % of the variance "
                f"of the gyroscope's turns, {other.meaning} at "
                f"{other.fit.offset:.3f} s {100 * other.fit.share:.2g} %; a motion "
                "about all three axes that does not repeat itself tells them apart"
            )
            raise RefusedError(msg)


def _refined(
    truth: Truth, time: Float[Array, " n"], gyro: Float[Array, "n 3"], best: _Tried
) -> tuple[tuple[Meaning, ...], Meaning, TurnFit]:
    # of the meanings of one motion, the one whose body axes are nearest to the sensor's
    pieces = stretches(time, gyro)
    coarse = stretches(time, gyro, coarse=True)
    alike = []
    for meaning in meanings(truth.scalar):
        read = attitudes(truth.time, truth.components, meaning)
        fit = fit_turns(coarse, read, best.fit.offset)
        if fit.share <= best.fit.share * (1.0 + 1e-6):
            size = np.linalg.norm(rotation_vector(of_matrix(polar(fit.linear))))
            alike.append((float(size), meaning))
    alike.sort(key=lambda each: each[0])
    nearest = alike[0][1]
    read = attitudes(truth.time, truth.components, nearest)
    fit = fit_turns(pieces, read, best.fit.offset, drifts=True)
    return tuple(meaning for _, meaning in alike[1:]), nearest, fit


def _require_axes(fit: TurnFit, errors: TurnErrors) -> None:
    if not np.linalg.det(fit.linear) > 0.0:
        msg = (
            "the gyroscope's axes are left-handed against the truth's: one of them has "
            "the wrong sign, or two are exchanged; look at its columns (--columns)"
        )
        raise RefusedError(msg)
    values, vectors = np.linalg.eigh(errors.rotation)
    if not values[-1] <= WIDEST**2:
        axis = ", ".join(f"{x:.2f}" for x in vectors[:, -1])
        msg = (
            "the sensor's axes in the truth's are known to "
            f"{np.degrees(np.sqrt(values[-1])):.2g} degrees only (standard deviation, "
            f"about the axis ({axis}) of the sensor), and {np.degrees(WIDEST):g} are "
            "needed; turn the sensor about each of its axes for longer"
        )
        raise RefusedError(msg)


def _in_world(q: Float[Array, "n 4"], world: World) -> Float[Array, "n 4"]:
    # A(q) W' from A(q): first north-west-up to the truth's world, then to the sensor
    first = of_matrix(world.matrix.T)
    back = np.broadcast_to(first, q.shape)
    e1, s1, e2, s2 = back[:, :3], back[:, 3:], q[:, :3], q[:, 3:]
    vector = s1 * e2 + s2 * e1 + np.cross(e1, e2)
    return np.concatenate([vector, s1 * s2 - np.sum(e1 * e2, 1, keepdims=True)], axis=1)


def _noise(read: Attitudes, spans: Float[Array, "m 2"]) -> Float[Array, "3"]:
    # by the second differences at rest, which no slow motion changes
    squares, count = np.zeros(3), 0
    for start, stop in spans:
        rows = slice(*np.searchsorted(read.time, [start, stop]))
        q, t = read.q[rows], read.time[rows]
        even = np.diff(t, 2) < 0.1 * read.step
        if len(q) < 10 or not even.any():
            continue
        second = np.diff(turned(q[:-1], q[1:]), axis=0)[even]
        squares += np.sum(second**2, axis=0) / 6.0
        count += len(second)
    return np.sqrt(squares / count) if count else np.full(3, np.nan)
