r"""Bring the truth to the log's clock, the sensor's axes and a north-west-up world.

First the offsets that are likely, then a fit at each for each class of meaning
(`simval.imu.recorded.attitudes`), the best of them, its error bars, and its world.
Refused where the best explains little of what the gyroscope shows, where it is not
clearly better than another, and where the motion leaves an axis open.

**Likely offsets**, by the size of the rate, in whatever axes: log and truth are brought
to an even clock and correlated at every shift that leaves enough overlap, with holes
left out (Pearson's coefficient of what both have at that shift).

**The fit** of clock, axes and gyroscope against the truth, by least squares:

.. math:: y_j = L x_j(\tau) + \beta T_j + r_j \tag{R3}

with a stretch's turns :math:`y_j, x_j` (R1) and length :math:`T_j`, and
:math:`\tau = \tau_0 + d (t - t_0)` about the middle of the log: fourteen unknowns, the
offset :math:`\tau_0`, the nine of L, the bias, and the drift d of one clock against the
other (left out of a first fit). The rotation nearest to L, its
polar factor Q, carries the truth's body axes to the sensor's; what is left, Q'L, is
symmetric: the gyroscope's own scale and misalignment, and is reported as that. So a
gyroscope that is wrong by some per cent does not turn the truth.

The offset is where the residuals do not depend on the change of the rate over a
stretch, :math:`\partial x / \partial \tau`, *as the gyroscope has it*. The truth's own
would share its noise with the residuals: between two rows an interpolation has less
noise than on one, and least squares would move the clock to where there is less.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import scipy

from simval.arrays import Array, ReadOnly
from simval.errors import GeometryError, InputError, RefusedError
from simval.geometry import axial, cross_matrix
from simval.imu.logs import Log, Truth
from simval.imu.multiposition.log_units import units_of, written_unit
from simval.imu.multiposition.rests import find_rests
from simval.imu.recorded.attitudes import (
    STRETCH,
    Attitudes,
    Meaning,
    Stretches,
    attitudes,
    composed,
    meanings,
    of_matrix,
    rotation_vector,
    stretches,
    turned,
)
from simval.imu.recorded.errors import Measured, block_of, jackknife
from simval.imu.recorded.rows import SLACK, RowCentre, judged_rows, row_centre
from simval.imu.recorded.settings import (
    UNSTATED,
    Signals,
    signals,
    with_gyro_unit,
    without_turns,
)
from simval.imu.recorded.world import TruthWorld, World, find_world, taken_world
from simval.imu.statics import interval_means
from simval.shapes import Float

OVERLAP: Final = 0.3
"""Least share of the shorter recording that the other one must cover: with less, two
short pieces that happen to look alike win."""

LEAST_SECONDS: Final = 4.0  # s; least overlap, as of the fit
APART: Final = 1.0  # s; maxima nearer than this are one
MOST_OFFSETS: Final = 3  # maxima that are tried by a fit
LONGEST: Final = 1 << 20  # ticks of an even clock: 29 hours


def likely_offsets(signals: Signals, attitudes: Attitudes) -> list[float]:
    """Possible offsets of the truth's clock from the log's, s, the likeliest first.

    Raises
    ------
    RefusedError
        If nothing moves, or either is too long or too short.
    """
    time, gyro = signals.turning
    # about the median, which is the bias of a sensor that rests, and of counts
    centred = gyro - np.median(gyro, axis=0)
    sums = np.cumsum(centred[1:] * np.diff(time)[:, None], axis=0)
    ticks = np.arange(time[0], time[-1], STRETCH)
    at = np.column_stack([np.interp(ticks, time[1:], sums[:, k]) for k in range(3)])
    log = np.linalg.norm(np.diff(at, axis=0), axis=1)
    q = attitudes.at(np.arange(attitudes.time[0], attitudes.time[-1], STRETCH))
    truth = np.linalg.norm(turned(q[:-1], q[1:]), axis=1)
    if max(len(log), len(truth)) > LONGEST:
        msg = (
            f"log and truth last {len(log) * STRETCH:.6g} s and "
            f"{len(truth) * STRETCH:.6g} s; cut them to {LONGEST * STRETCH:.0f} s"
        )
        raise RefusedError(msg)
    correlation = _correlation(truth, log)
    if not np.isfinite(correlation).any():
        msg = (
            "truth and gyroscope do not move together for "
            f"{LEAST_SECONDS:g} s at any shift of their clocks; give the truth of this "
            "log, recorded while the sensor turned"
        )
        raise RefusedError(msg)
    found: list[float] = []
    apart = max(1, round(APART / STRETCH))
    for _ in range(MOST_OFFSETS):
        best = int(np.nanargmax(correlation))
        shift = best - (len(log) - 1)
        found.append(shift * STRETCH + float(attitudes.time[0] - time[0]))
        correlation[max(0, best - apart) : best + apart + 1] = np.nan
        if not np.isfinite(correlation).any():
            break
    return found


def _correlation(a: Float[Array, " n"], b: Float[Array, " m"]) -> Float[Array, " k"]:
    # Pearson's coefficient of a[s + j] with b[j] for s from -(m - 1) on; NaN where they
    # share too little, or one does not vary
    def sums(x: Array, y: Array) -> Array:
        return scipy.signal.fftconvolve(x, y[::-1])

    mask_a, mask_b = np.isfinite(a).astype(float), np.isfinite(b).astype(float)
    a, b = np.where(mask_a > 0.0, a, 0.0), np.where(mask_b > 0.0, b, 0.0)
    a, b = a / max(a.max(initial=0.0), 1e-300), b / max(b.max(initial=0.0), 1e-300)
    count = np.maximum(np.round(sums(mask_a, mask_b)), 1.0)
    mean_a, mean_b = sums(a, mask_b) / count, sums(mask_a, b) / count
    var_a = sums(a * a, mask_b) / count - mean_a**2
    var_b = sums(mask_a, b * b) / count - mean_b**2
    both = sums(a, b) / count - mean_a * mean_b
    least = max(OVERLAP * min(mask_a.sum(), mask_b.sum()), LEAST_SECONDS / STRETCH)
    usable = (count >= least) & (var_a > 1e-9) & (var_b > 1e-9)
    return np.where(
        usable, both / np.sqrt(np.where(usable, var_a * var_b, 1.0)), np.nan
    )


STEPS: Final = 20
MOST_DRIFT: Final = 1e-3  # s a second, in a step: the worst of clocks
ENOUGH: Final = 1e-4  # of a quarter of the truth's step: a change below it is none
LEAST_STRETCHES: Final = 40  # stretches; the blocks then hold two each
STEEP: Final = 1e6  # condition of X'X beyond which an axis was not turned about


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnFit(ReadOnly):
    """Least-squares solution of eq. (R3)."""

    offset: float  # s, at `middle`: what the truth's clock shows minus the log's
    drift: float  # of that, s a second
    middle: float  # s, log's clock
    linear: Float[Array, "3 3"]  # L, raw units per rad/s
    bias: Float[Array, "3"]  # raw units
    residuals: Float[Array, "m 3"]  # r_j, raw units times s
    rows: Float[Array, "m 3 p"]  # derivatives of r by offset, L, bias (and drift)
    instruments: Float[Array, "m 3 p"]  # what the residuals are made orthogonal to
    used: Float[Array, " m"]  # middle of each stretch used, log's clock, s
    share: float  # of the variance of y that is left, 0 to 1
    converged: bool

    @property
    def scale(self) -> float:
        """Raw units per rad/s, mean of the three axes."""
        return float(abs(np.linalg.det(self.linear)) ** (1.0 / 3.0))


def fit_turns(
    stretches: Stretches,
    attitudes: Attitudes,
    offset: float,
    *,
    steps: int = STEPS,
    drifts: bool = False,
) -> TurnFit:
    """Fit eq. (R3), starting from an offset that is right to about one stretch.

    Raises
    ------
    RefusedError
        If there are too few stretches with truth, or nothing turns in them.
    """
    delta = 0.25 * attitudes.step
    about = stretches.middle - stretches.middle.mean()
    drift = 0.0
    for _ in range(steps):
        now = offset + drift * about
        x = stretches.truth(attitudes, now)
        before, after = (stretches.truth(attitudes, now + d) for d in (-delta, delta))
        slope = (after - before) / (2.0 * delta)
        good = np.isfinite(x + slope).all(axis=1)
        _require_motion(x[good])
        y, T = stretches.turn[good], stretches.seconds[good]
        known = np.column_stack([x[good], T])
        solution = np.linalg.lstsq(known, y)[0]
        linear = solution[:3].T
        residuals = y - known @ solution
        at = about[good] if drifts else None
        rows = _derivatives(x[good], slope[good] @ linear.T, T, at)
        instruments = _derivatives(x[good], stretches.change[good], T, at)
        change = _change(instruments, rows, residuals)
        done = abs(change[0]) < ENOUGH * delta
        if done:
            break
        offset += float(np.clip(change[0], -0.5 * STRETCH, 0.5 * STRETCH))
        drift += float(np.clip(change[13], -MOST_DRIFT, MOST_DRIFT)) if drifts else 0.0
    spread = np.sum((y - y.mean(axis=0)) ** 2)
    return TurnFit(
        offset=offset,
        drift=drift,
        middle=float(stretches.middle.mean()),
        linear=linear,
        bias=solution[3],
        residuals=residuals,
        rows=rows,
        instruments=instruments,
        used=stretches.middle[good],
        share=float(np.sum(residuals**2) / spread) if spread > 0.0 else 1.0,
        converged=bool(done),
    )


def _change(
    instruments: Float[Array, "m 3 p"],
    rows: Float[Array, "m 3 p"],
    residuals: Float[Array, "m 3"],
) -> Float[Array, " p"]:
    # of the unknowns, towards residuals that are orthogonal to all instruments
    Z, J = (
        instruments.reshape(-1, instruments.shape[-1]),
        rows.reshape(-1, rows.shape[-1]),
    )
    left, right = np.linalg.norm(Z, axis=0), np.linalg.norm(J, axis=0)
    change = np.linalg.lstsq(
        (Z / left).T @ (J / right), -(Z / left).T @ residuals.ravel()
    )[0]
    return change / right


def _derivatives(
    x: Float[Array, "m 3"],
    slope: Float[Array, "m 3"],
    T: Float[Array, " m"],
    about: Float[Array, " m"] | None,
) -> Float[Array, "m 3 p"]:
    # of r by offset, L row by row, bias, and the drift: it moves a stretch by its time,
    # and that it also stretches it is in L
    rows = np.zeros((len(x), 3, 13 if about is None else 14))
    rows[:, :, 0] = -slope
    for axis in range(3):
        rows[:, axis, 1 + 3 * axis : 4 + 3 * axis] = -x
        rows[:, axis, 10 + axis] = -T
    if about is not None:
        rows[:, :, 13] = -slope * about[:, None]
    return rows


def _require_motion(x: Float[Array, "m 3"]) -> None:
    if len(x) < LEAST_STRETCHES:
        msg = (
            f"truth and gyroscope overlap for {len(x) * STRETCH:.1f} s, and "
            f"{LEAST_STRETCHES * STRETCH:g} s are needed; give the truth of "
            "this log"
        )
        raise RefusedError(msg)
    off = x - x.mean(axis=0)
    values = np.linalg.eigvalsh(off.T @ off)
    if not values[0] * STEEP > values[-1] > 0.0:
        msg = (
            "the truth turns about fewer than three axes, so the sensor's axes in it "
            "cannot be found; turn the sensor about each of its axes"
        )
        raise GeometryError(msg)


def polar(linear: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Rotation nearest to a matrix of positive determinant."""
    U, _, V = np.linalg.svd(linear)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnErrors:
    """Error bars of a `TurnFit`."""

    offset: float  # s
    drift: float  # s a second; NaN where it was not fitted
    rotation: Float[Array, "3 3"]  # covariance, rotation vector in sensor axes, rad^2
    own: Float[Array, "3 3"]  # standard deviations of Q'L, relative
    bias: Float[Array, "3"]  # raw units
    dof: int


def turn_errors(fit: TurnFit) -> TurnErrors:
    """Error bars from blocks of equal information, eq. (R2), by the delta method.

    A change dL turns the polar factor, Q exp([a x]), by the antisymmetric part of
    Q'dL = [a x] P + dP:  (tr P I - P) a = the axial vector of Q'dL - (Q'dL)'.
    """
    weight = np.sum(fit.rows[:, :, 1:4] ** 2, axis=(1, 2))
    block, count = block_of(weight + weight.mean())
    covariance = jackknife(fit.instruments, fit.rows, fit.residuals, block)
    Q = polar(fit.linear)
    P = Q.T @ fit.linear
    turn, own = np.zeros((3, 9)), np.zeros((9, 9))
    for k in range(9):
        dL = np.zeros(9)
        dL[k] = 1.0
        D = Q.T @ dL.reshape(3, 3)
        a = np.linalg.solve(np.trace(P) * np.eye(3) - P, axial(D))
        turn[:, k] = Q @ a
        own[:, k] = (D - cross_matrix(a) @ P).ravel() / fit.scale
    nine = covariance[1:10, 1:10]
    return TurnErrors(
        offset=float(np.sqrt(covariance[0, 0])),
        drift=float(np.sqrt(covariance[13, 13])) if len(covariance) > 13 else np.nan,
        rotation=turn @ nine @ turn.T,
        own=np.sqrt(np.diagonal(own @ nine @ own.T)).reshape(3, 3),
        bias=np.sqrt(np.diagonal(covariance)[10:13]),
        dof=count - 1,
    )


MOST_LEFT: Final = 0.25
"""Share of the variance of the gyroscope's turns that a truth may leave unexplained.
Truths of other logs are refused (test_recorded_refusals.py); the least that one
was seen to leave is 0.43, and the two recordings of BROAD leave 0.001."""

_SAME: Final = 1e-3  # relative, of two such shares of one motion
MOUNTED: Final = np.radians(30.0)
"""By which stated axes may be off: less than half of a turn to the next ones."""

BETTER: Final = 4.0
"""Factor in that share by which the best must be ahead of any other meaning or offset;
two halves of the residual are then each of its size."""

TRIES: Final = 8
"""Steps of a fit that may be at a wrong offset; from a right one it takes four."""

WIDEST: Final = np.radians(2.0)
"""Standard deviation of an axis of the sensor in the truth's, beyond which the error of
a filter would be that of the alignment."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment(ReadOnly):
    """Clock, axes and world of a truth, relative to its log.

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

    @property
    def offset(self) -> Measured:
        """Offset of the truth's clock from the log's in the middle of the log, s."""
        return Measured(
            value=self.fit.offset, sd=self.errors.offset, dof=self.errors.dof
        )

    @property
    def drift(self) -> Measured:
        """Growth of the offset, s per second."""
        return Measured(value=self.fit.drift, sd=self.errors.drift, dof=self.errors.dof)

    @property
    def axes(self) -> tuple[Measured, ...]:
        """Turn between sensor and truth, a rotation vector with error bars, rad."""
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
    signals: Signals,
    world: TruthWorld | None = None,
    axes: Float[Array, "3 3"] | None = None,
) -> Alignment:
    """Align a truth with a log, see the module.

    Parameters
    ----------
    truth : Truth
        As from `simval.imu.logs.read_truth`.
    signals : Signals
        Readings of the log: angular rate and field in any unit, specific force in
        m/s^2.
    world : {"NWU", "ENU", "NED", "estimated"}, optional
        The truth's world; default that of its data set, else the nearest one;
        ``estimated`` turns the truth to what rests and field show.
    axes : Array, optional
        Axes of the sensor in those of the truth's body, one a row, as far as they are
        known, (3, 3): of two readings that both follow the gyroscope the one is taken
        whose axes are within `MOUNTED` of these.

    Returns
    -------
    Alignment
        What lies between them, with error bars, and the aligned attitudes.

    Raises
    ------
    RefusedError
        If it cannot be done without a guess.
    """
    first, others = _best(truth, signals)
    best, rivals = first, others
    if axes is not None:
        best, rivals = _with_axes(truth, signals, [first, *others], axes)
    _require_it(best, rivals)
    same, meaning, fit = _refined(truth, signals, best, axes)
    otherwise = min(
        (each.fit.share for each in (first, *others) if each is not best),
        default=np.inf,
    )
    errors = turn_errors(fit)
    _require_axes(fit, errors)
    Q = polar(fit.linear)
    turn = of_matrix(Q)
    read = attitudes(truth.time, truth.components, meaning)
    time = signals.time
    raw = read.at(time + fit.offset + fit.drift * (time - fit.middle))
    q = composed(raw, turn)
    shown = find_world(q, signals.force, signals.field, signals.rests, errors.rotation)
    there = taken_world(shown, truth.columns, world)
    return Alignment(
        meaning=meaning,
        same=same,
        better=otherwise / best.fit.share,
        fit=fit,
        errors=errors,
        rotation=rotation_vector(turn),
        world=there,
        attitude=composed(of_matrix(there.matrix.T), q),
        noise=_noise(read, time[signals.rests] + fit.offset),
    )


def _best(truth: Truth, signals: Signals) -> tuple[_Tried, list[_Tried]]:
    # one meaning of each class is enough, see `attitudes`
    pieces = stretches(*signals.turning, coarse=True)
    tried: list[_Tried] = []
    pair = meanings(truth.scalar)[:2]
    first = attitudes(truth.time, truth.components, pair[0])
    starts = likely_offsets(signals, first)
    for start in starts:
        for meaning in pair:
            read = attitudes(truth.time, truth.components, meaning)
            try:
                fit = fit_turns(pieces, read, start, steps=TRIES)
            except RefusedError:
                continue
            tried.append(_Tried(meaning=meaning, offset=start, fit=fit))
    if not tried:
        fit_turns(pieces, first, starts[0])  # says why
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
            "look at the gyroscope's columns (--columns), or record a log that turns"
        )
        raise RefusedError(msg)
    for other in others:
        if not other.fit.share >= BETTER * share:
            msg = (
                f"the truth can be read in two ways: {best.meaning} at an offset of "
                f"{best.fit.offset:.3f} s leaves {100 * share:.2g} % of the variance "
                f"of the gyroscope's turns, {other.meaning} at "
                f"{other.fit.offset:.3f} s {100 * other.fit.share:.2g} %; state how "
                "the sensor's axes lie in the truth's body (--truth-axes x,y,z), or "
                "record a rotation about all three axes that does not repeat itself"
            )
            raise RefusedError(msg)


def _refined(
    truth: Truth,
    signals: Signals,
    best: _Tried,
    axes: Float[Array, "3 3"] | None = None,
) -> tuple[tuple[Meaning, ...], Meaning, TurnFit]:
    # of the meanings of one motion, the one whose body axes are nearest to the
    # sensor's, or to the axes that are stated
    pieces = stretches(*signals.turning)
    coarse = stretches(*signals.turning, coarse=True)
    floor = 0.0 if axes is None else 1.0 - _SAME  # another motion may fit better
    alike = []
    for meaning in meanings(truth.scalar):
        read = attitudes(truth.time, truth.components, meaning)
        fit = fit_turns(coarse, read, best.fit.offset)
        if floor <= fit.share / best.fit.share <= 1.0 + 1e-6:
            alike.append((_apart(fit, axes), meaning))
    alike.sort(key=lambda each: each[0])
    nearest = alike[0][1]
    read = attitudes(truth.time, truth.components, nearest)
    fit = fit_turns(pieces, read, best.fit.offset, drifts=True)
    return tuple(meaning for _, meaning in alike[1:]), nearest, fit


def _apart(fit: TurnFit, axes: Float[Array, "3 3"] | None) -> float:
    # rad, between the sensor's axes in the truth's body and those that are stated
    stated = np.eye(3) if axes is None else axes
    turn = rotation_vector(of_matrix(polar(fit.linear) @ stated.T))
    return float(np.linalg.norm(turn))


def _with_axes(
    truth: Truth, signals: Signals, tried: list[_Tried], axes: Float[Array, "3 3"]
) -> tuple[_Tried, list[_Tried]]:
    # the readings that follow the gyroscope and have the stated axes, the best first
    near = [each for each in tried if each.fit.share <= BETTER * tried[0].fit.share]
    fits = [_refined(truth, signals, each, axes)[2] for each in near]
    # one that fits in left-handed axes has none of them
    apart = [
        _apart(fit, axes) if np.linalg.det(fit.linear) > 0.0 else np.pi for fit in fits
    ]
    fitting = [x for x, off in zip(near, apart, strict=True) if off <= MOUNTED]
    if not fitting:
        words = ", ".join(
            f"{each.meaning} {np.degrees(off):.0f} degrees"
            for each, off in zip(near, apart, strict=True)
        )
        msg = (
            "by --truth-axes the sensor's axes are known, but the readings of "
            "the truth that follow the gyroscope are off from these by "
            f"{words}, where {np.degrees(MOUNTED):.0f} are allowed; check the "
            "axes, or leave the option out"
        )
        raise RefusedError(msg)
    far = [each for each in tried if each not in near]
    return fitting[0], [*fitting[1:], *far]


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


def stated_axes(words: str) -> Float[Array, "3 3"]:
    """Read the axes of a sensor in those of a body, such as ``x,-z,y``.

    Raises
    ------
    InputError
        If they are no right-handed axes.
    """
    rows = {
        f"{sign}{axis}": size * row
        for axis, row in zip("xyz", np.eye(3), strict=True)
        for sign, size in (("", 1.0), ("+", 1.0), ("-", -1.0))
    }
    names = [word.strip() for word in words.split(",")]
    known = len(names) == 3 and rows.keys() >= {*names}
    axes = np.array([rows[name] for name in names]) if known else np.zeros((3, 3))
    if not np.linalg.det(axes) > 0.5:
        msg = (
            f"`--truth-axes` is {words!r}; it needs what the sensor's x, y and z point "
            "along in the truth's body, right-handed, as x,y,z or x,-y,-z"
        )
        raise InputError(msg)
    return axes


def prepared(
    log: Log,
    recorded: Truth | None,
    calibration: Path | None,
    units: tuple[str | None, str | None],
    world: TruthWorld | None = None,
    *,
    find_rows: bool = True,
    axes: Float[Array, "3 3"] | None = None,
) -> tuple[Signals, Alignment | None]:
    """Readings of a log in SI units, with the truth aligned to them.

    The rows of the gyroscope are the log's, or, with their delay, of the kind that is
    found.
    """
    rests = find_rests(log, None, 1).best.intervals
    means = interval_means(log.accelerometer, rests)
    given = {"accelerometer": units[0], "gyro": units[1]}
    scales = {"gyro": UNSTATED} | units_of(log, given, means=means)
    if recorded is not None and not (units[1] or written_unit(log, "gyro")):
        scales["gyro"] = UNSTATED  # the truth says it better
    found = signals(
        log,
        rests,
        **scales,
        calibration=None if calibration is None else str(calibration),
    )
    start, alignment = float(log.time[0]), None
    if recorded is not None:
        if np.spacing(start) > 1e-9:  # seconds since 1970: both from the log's start on
            found = replace(found, time=found.time - start)
            recorded = replace(recorded, time=recorded.time - start)
        alignment = align(recorded, found, world, axes)
    found = with_gyro_unit(found, None if alignment is None else alignment.fit.scale)
    found = _with_evidence(found, recorded, alignment, find=find_rows)
    if recorded is not None and found.rows != log.gyro_rows:
        alignment = align(recorded, found, world, axes)
    return without_turns(found), alignment


def _with_evidence(
    found: Signals, recorded: Truth | None, alignment: Alignment | None, *, find: bool
) -> Signals:
    # what the log says of the gyroscope's rows, which are taken so
    step = float(np.median(np.diff(found.time)))
    compass = None
    seen = [row_centre(found.time, found.gyro, found.force, "accelerometer")]
    if found.field is not None:
        compass = row_centre(found.time, found.gyro, found.field, "magnetometer")
    if alignment is not None and recorded is not None and not recorded.own_clock:
        offset = alignment.offset
        truth = RowCentre(
            by="truth", centre=found.rows.centre(step) + offset.value, sd=offset.sd,
            coherent=SLACK * step,
        )  # fmt: skip
        seen.append(truth)
    evidence = judged_rows(tuple(seen), step, found.rows, find=find)
    evidence = replace(evidence, compass=compass)
    return replace(found.taken_as(evidence.rows), evidence=evidence)
