r"""When a gyroscope's rows were measured, seen by a vector that the body turns past.

**Their middle** c against the stamps (`simval.imu.logs.rows`, eq. (R6)). In a window of
two seconds the gyroscope's attitudes A, from its first row on, turn the readings v of a
vector sensor back. Gravity g (or the field) is then constant; what is left is

.. math:: A_k^T v_k = g + \delta c\, A_k^T(\omega_k \times A_k g)
   + A_k^T(b + M A_k g + L_k r) + \theta_k \times g,  \tag{R7}

rows that are :math:`\delta c` off, the sensor's bias and calibration, its lever arm r
(:math:`L r = \dot\omega \times r + \omega \times (\omega \times r)`, late like the
rest, and late by itself, as of a body that follows), and what bias and calibration of
the gyroscope turn by, :math:`\theta`. Each window has its own g; the others are common,
with wide priors, without which a thrust is a bias. A window counts by the inverse of
what it leaves. The force in the products is the *predicted* one: the reading's own
noise would be on both sides. The noise of the rates is in the columns, which makes
:math:`\delta c` too small: so c is where none is left, and its error is divided by the
slope there.

**The error bar** has three parts. Blocks of windows are left out by turns, as in eq.
(R2). What is left of (R7) is real acceleration, and `COHERENT` of it is taken to be in
step with the turning, where it moves c. A gait is more in step than that; but it does
not move c as much about each axis, nor as much in slow turning as in quick, as a delay
does: so c is asked of each apart, and what they differ by beyond chance is in the bar.
Where most of what the sensor shows is left, no bar is true, and the answer is refused.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.geometry import attitude_matrix, cross_matrix, from_rotation_vector
from simval.imu.logs.rows import HOLE, LONGEST, MIDDLES, Rows
from simval.shapes import Float, Int
from simval.vocabulary import ROW_KINDS

WINDOW: Final = 2.0  # s
MOVING: Final = 0.1  # rad/s, RMS in a window that counts
LEAST_ROWS: Final = 16  # in a window
FEWEST: Final = 10  # windows
MOST_ROWS: Final = 40_000  # in windows that count: those that turn most
THIN: Final = 0.01  # s, between rows of the equations
BLOCKS: Final = 20
SLOW: Final = 0.5  # s, of a mean that parts slow turning from quick
STEPS: Final = 6
ENOUGH: Final = 1e-5  # s
COHERENT: Final = 0.05
"""Share of what is left that may be in step with the motion."""
MOST_LEFT: Final = 0.5
"""Share of what the vector shows in the windows that may be left."""
NARROW: Final = 1.0 / 6.0
"""Of a step: with three such bars one middle of (R6) is at most near."""
SMOOTH: Final = 0.06
"""s, to each side, of the polynomial that a rate is by: 17 Hz pass. The noise of its
third derivative, times an arm, is in the column of the delay."""
PROBE: Final = 0.25  # of a step, at least, to where the slope is taken
STEEPEST, FLATTEST = -2.0, -0.02
FARTHEST: Final = 0.25  # s, that a middle is looked for
BENT: Final = np.array([
    np.diag([1.0, -1.0, 0.0]), np.diag([1.0, 1.0, -2.0]),
    [[0, 1, 0], [1, 0, 0], [0, 0, 0]], [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
    [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
])  # fmt: skip
"""Symmetric changes of a vector sensor's axes that leave its mean scale."""
SLACK: Final = 1.0 / 30.0
"""Of a step: bar of a truth's clock besides its own, which neither a convention of the
truth nor what lies between its rows moves it by."""
NEAR: Final = 3.0  # bars, of a middle that agrees
FAR: Final = 4.0  # bars, of one that does not

OTHERS: Final = [0.05] * 3 + [0.03] * 5, [0.02] * 3 + [0.03] * 9
PRIORS: Final = {
    "accelerometer": [*OTHERS[0], *[0.5] * 3, *[0.015] * 3, *OTHERS[1]],
    "magnetometer": [*OTHERS[0], *OTHERS[1]],
}
"""Standard deviations of what is not asked: the vector's bias over its length, and its
axes; the arm, m, and that times what it is late by itself, m s; the gyroscope's bias,
rad/s, and matrix."""

Witness = Literal["accelerometer", "magnetometer", "truth"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RowCentre:
    """Middle of the time that a gyroscope's row measures, by another sensor.

    Attributes
    ----------
    by : {"accelerometer", "magnetometer", "truth"}
        The other one.
    centre : float
        Middle less stamp, s; NaN where too little turns.
    sd : float
        Its standard deviation by blocks of time, s.
    coherent : float
        What acceleration in step with the turning may move it by, s.
    apart : float
        By how much it differs, between the axes of turning and between slow and quick
        turning, beyond chance, s.
    left : float
        Share of what the sensor shows that turning does not explain.
    windows : int
        Windows of `WINDOW` that count.
    """

    by: Witness
    centre: float
    sd: float
    coherent: float = 0.0
    apart: float = 0.0
    left: float = 0.0
    windows: int = 0

    @property
    def bar(self) -> float:
        """Standard deviation of the middle, s."""
        return float(np.hypot(np.hypot(self.sd, self.coherent), self.apart))

    @property
    def half(self) -> float:
        """Half width of the middle's 95 % interval, s."""
        return 2.0 * self.bar

    def decides(self, step: float) -> bool:
        """True if it is precise enough to tell the conventions apart."""
        return self.left < MOST_LEFT and self.bar < NARROW * step

    def off(self, centre: float) -> float:
        """Distance from another middle, in standard deviations."""
        return abs(self.centre - centre) / self.bar


class _Equations(NamedTuple):
    """Columns of eq. (R7) in each window, and the readings turned back."""

    late: Float[Array, "w s 3 3"]  # rows that are late, by axis
    others: Float[Array, "w s 3 q"]
    u: Float[Array, "w s 3"]


class _RowFit(NamedTuple):
    """Least-squares solution of eq. (R7), each window weighted by its residuals."""

    solution: Float[Array, " p"]  # changes of the middle, s, first
    sd: Float[Array, " p"]  # by blocks of windows
    rest: Float[Array, " w"]  # mean square of what is left
    weight: Float[Array, " w"]
    moves: Float[Array, " w"]  # mean square of the first column


def row_centre(
    time: Float[Array, " n"],
    gyro: Float[Array, "n 3"],
    vector: Float[Array, "n 3"],
    by: Witness,
) -> RowCentre:
    """Find the middle of a gyroscope's rows, rad/s, by those of a vector sensor.

    Parameters
    ----------
    time : Array
        Stamps of both, s, (n,).
    gyro : Array
        Angular rate, rad/s, (n, 3).
    vector : Array
        Specific force, m/s^2, or field, in any unit, in the same axes, (n, 3).
    by : {"accelerometer", "magnetometer"}
        Which: an accelerometer has a lever arm.

    Returns
    -------
    RowCentre
        Where it is, with its error bar.
    """
    step = float(np.median(np.diff(time)))
    size = max(2, round(WINDOW / step))
    gyro = gyro - np.median(gyro, axis=0)
    starts = _starts(time, gyro, vector, size)
    rows = starts[:, None] + np.arange(size)
    # (a sensor that is stuck, or that is read too slowly, shows no turn)
    if len(starts) < FEWEST or size < LEAST_ROWS or not np.ptp(vector[rows]) > 0.0:
        return RowCentre(by=by, centre=np.nan, sd=np.nan, windows=len(starts))
    arm: Array = np.zeros(3)

    def fitted(centre: float) -> tuple[_RowFit, _Equations]:
        nonlocal arm
        late = Rows(delay=MIDDLES["before"] * step - centre)
        means = np.nan_to_num(late.means(time, gyro))
        each = _equations(time, means, vector, rows, arm, by)
        fit = _fitted(each, each.late.sum(axis=3, keepdims=True), by)
        arm = fit.solution[9:12] if by == "accelerometer" else arm
        return fit, each

    start = MIDDLES["before"] * step
    for _ in range(2 if by == "accelerometer" else 0):
        fitted(start)  # the arm first: its force moves with the rows
    centre, slope, fit, each = _middle(fitted, start, step)
    axes = _fitted(each, each.late, by)
    slow = max(2, round(SLOW / max(step, THIN)))
    low = _Equations(
        *(scipy.ndimage.uniform_filter1d(part, slow, axis=1) for part in each)
    )
    high = _Equations(*(x - y for x, y in zip(each, low, strict=True)))
    bands = [
        _fitted(some, some.late.sum(axis=3, keepdims=True), by) for some in (low, high)
    ]
    apart = np.hypot(
        _apart(axes.solution[:3], axes.sd[:3]),
        _apart(*np.array([(b.solution[0], b.sd[0]) for b in bands]).T),
    )
    shown = _thinned(vector[rows], step)
    shown = shown - shown.mean(axis=1, keepdims=True)
    # what the sensor shows from row to row where it is quietest is in step with nothing
    jumps = np.mean(np.diff(vector, axis=0) ** 2, axis=1)
    quiet = jumps[: len(jumps) // size * size].reshape(-1, size).mean(axis=1).min()
    noise = 0.5 * quiet * shown.shape[1] / size
    real = fit.weight @ np.maximum(fit.rest - noise, 0.0)
    coherent = COHERENT * float(np.sqrt(real / (fit.weight @ fit.moves)))
    # a row after a hole is of the hole or of its last step: it moves c by up to a step
    missed = np.maximum(np.rint(np.diff(time[rows], axis=1) / step) - 1.0, 0.0)
    holes = step * float(missed.mean())
    return RowCentre(
        by=by,
        centre=centre,
        sd=float(fit.sd[0]) / -slope,
        coherent=float(np.hypot(coherent, holes)) / -slope,
        apart=float(apart) / -slope,
        left=float(np.mean(fit.rest) / np.mean(shown**2)),
        windows=len(starts),
    )


def _apart(changes: Float[Array, " k"], sd: Float[Array, " k"]) -> float:
    # what independent changes that should be 0 scatter by beyond their own errors
    weight = sd**-2.0
    excess = float(weight @ changes**2) - (len(changes) - 1)
    return float(np.sqrt(max(excess, 0.0) / weight.sum()))


def _middle(
    fitted: Callable[[float], tuple[_RowFit, _Equations]], start: float, step: float
) -> tuple[float, float, _RowFit, _Equations]:
    # where no change is left, by the secant, and the slope there: noise in the columns
    # makes it flatter, and the answer as much more uncertain
    at, (fit, each), slope = start, fitted(start), -1.0
    move = float(fit.solution[0])
    move = float(np.copysign(max(abs(move), PROBE * step), move))
    for _ in range(STEPS):
        before, left = at, fit.solution[0]
        at = float(np.clip(at + move, -FARTHEST, FARTHEST))
        if at == before or abs(move) < ENOUGH:
            break
        fit, each = fitted(at)
        slope = float((fit.solution[0] - left) / (at - before))
        slope = float(np.clip(slope, STEEPEST, FLATTEST))
        move = float(fit.solution[0]) / -slope
    return at, slope, fit, each


def _starts(
    time: Float[Array, " n"],
    gyro: Float[Array, "n 3"],
    vector: Float[Array, "n 3"],
    size: int,
) -> Int[np.ndarray, " w"]:
    # of windows that turn and have every row, not at the ends
    starts = np.arange(size, len(time) - 2 * size, size)
    rows = starts[:, None] + np.arange(size)
    rate = np.sqrt(np.mean(np.sum(gyro[rows] ** 2, axis=2), axis=1))
    step = np.diff(time, prepend=time[0])
    whole = (step[rows] <= HOLE * np.median(step)).all(axis=1)
    whole &= np.isfinite(vector[rows]).all(axis=(1, 2))
    starts, rate = starts[whole & (rate > MOVING)], rate[whole & (rate > MOVING)]
    most = max(FEWEST, MOST_ROWS // size)
    return np.sort(starts[np.argsort(-rate)[:most]])


def _fitted(each: _Equations, late: Float[Array, "w s 3 k"], by: Witness) -> _RowFit:
    u = each.u
    X, count = np.concatenate([late, each.others], axis=3), len(u)
    X = (X - X.mean(axis=1, keepdims=True)).reshape(count, -1, X.shape[3])
    y = (u - u.mean(axis=1, keepdims=True)).reshape(count, -1)
    prior = np.diag(np.concatenate([[1.0] * late.shape[3], PRIORS[by]]) ** -2.0)
    N, b = X.swapaxes(1, 2) @ X, np.vecmat(y, X)
    weight = np.full(count, 1.0 / np.median(np.mean(y**2, axis=1)))
    for _ in range(4):
        whole, right = np.einsum("w,wpq->pq", weight, N) + prior, weight @ b
        solution = np.linalg.solve(whole, right)
        rest = np.mean((y - X @ solution) ** 2, axis=1)
        weight = 1.0 / (rest + np.median(rest))
    without = np.array([
        np.linalg.solve(
            whole - np.einsum("w,wpq->pq", weight[k], N[k]), right - weight[k] @ b[k]
        )
        for k in np.array_split(np.arange(count), min(BLOCKS, count))
    ])  # fmt: skip
    return _RowFit(
        solution=solution,
        sd=without.std(axis=0) * np.sqrt(len(without) - 1.0),
        rest=rest,
        weight=weight,
        moves=np.mean(X[:, :, 0] ** 2, axis=1),
    )


def _equations(
    time: Float[Array, " n"],
    means: Float[Array, "n 3"],
    vector: Float[Array, "n 3"],
    rows: Int[np.ndarray, "w s"],
    arm: Float[Array, "3"],
    by: Witness,
) -> _Equations:
    step = np.diff(time, prepend=2.0 * time[0] - time[1])
    h = step[rows][..., None]
    back = _attitudes(means * step[:, None], rows).swapaxes(2, 3)
    rate, speed = _rates(means * step[:, None], step, rows)
    W, E = cross_matrix(rate), cross_matrix(np.eye(3))
    L = cross_matrix(speed) + W @ W
    u = np.matvec(back, vector[rows])
    swung = L @ arm
    g = (u - np.matvec(back, swung)).mean(axis=1, keepdims=True)
    p = np.matvec(back.swapaxes(2, 3), g)
    late = rate[..., None] * np.cross(np.eye(3), p[:, :, None])  # [j] of axis j
    size = np.linalg.norm(g, axis=2)[..., None, None]
    p = p + swung
    columns = [size * back, *(np.matvec(back, p @ M)[..., None] for M in BENT)]
    if by == "accelerometer":
        jerk, W = np.gradient(speed, axis=1) / h, W[:, :, None]
        # of each axis, and the change of L with it
        each = jerk[..., None, None] * E + speed[..., None, None] * (E @ W + W @ E)
        late = late - each @ arm
        columns += [back @ L, back @ each.sum(axis=2)]
    for each in (back, *(back * rate[:, :, None, j : j + 1] for j in range(3))):
        theta = np.cumsum(each * h[..., None], axis=1)
        columns.append(-np.cross(np.matvec(back, p)[..., None], theta, axis=2))
    whole = back @ late.swapaxes(2, 3), np.concatenate(columns, axis=3), u
    return _Equations(*(_thinned(part, float(np.median(step))) for part in whole))


def _thinned(rows: Float[Array, "w s ..."], step: float) -> Float[Array, "w r ..."]:
    # means of so many rows that they are `THIN` apart: all columns are as smooth
    many = max(1, round(THIN / step))
    kept = rows[:, : rows.shape[1] // many * many]
    return kept.reshape(len(rows), -1, many, *rows.shape[2:]).mean(axis=2)


def _rates(
    turns: Float[Array, "n 3"], step: Float[Array, " n"], rows: Int[np.ndarray, "w s"]
) -> tuple[Float[Array, "w s 3"], Float[Array, "w s 3"]]:
    # rate and acceleration at the stamps, by polynomials through the running sum: two
    # neighbours' difference is 9 % low for a multirotor at 50 Hz
    usual = float(np.median(step))
    size = 2 * max(2, round(SMOOTH / usual)) + 1
    return tuple(
        scipy.signal.savgol_filter(
            np.cumsum(turns, axis=0), size, 4, deriv=k, delta=usual, axis=0
        )[rows]
        for k in (1, 2)
    )


def _attitudes(
    turns: Float[Array, "n 3"], rows: Int[np.ndarray, "w s"]
) -> Float[Array, "w s 3 3"]:
    # of each row of a window against its first; with the coning of `mekf`, eq. (F9)
    phi = turns[rows] + np.cross(turns[rows - 1], turns[rows]) / 12.0
    each = attitude_matrix(from_rotation_vector(phi))
    each[:, 0] = np.eye(3)
    for k in range(1, rows.shape[1]):
        each[:, k] = each[:, k] @ each[:, k - 1]
    return each


Why = Literal["stated", "accelerometer", "truth", "default"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RowEvidence:
    """How a log's gyroscope rows are taken, and what the log shows of that.

    Attributes
    ----------
    rows : Rows
        As they are taken.
    why : {"stated", "accelerometer", "truth", "default"}
        By what.
    step : float
        Median step of the log, s.
    seen : tuple of RowCentre
        Their middle by the accelerometer, and by a truth on the log's own clock.
    compass : RowCentre or None
        By the magnetometer, which may be late itself, and names nothing.
    """

    rows: Rows
    why: Why
    step: float
    seen: tuple[RowCentre, ...]
    compass: RowCentre | None = None

    @property
    def telling(self) -> RowCentre | None:
        """The first sensor that can tell conventions apart, the truth last.

        A truth that fits none is late itself.
        """
        return next(
            (
                each
                for each in self.seen
                if each.decides(self.step)
                and (each.by == "accelerometer" or self._fitting(each))
            ),
            None,
        )

    @property
    def clash(self) -> bool:
        """True if the log contradicts how the rows are taken."""
        seen = self.telling
        return seen is not None and seen.off(self.rows.centre(self.step)) > FAR

    @property
    def remedy(self) -> Rows | None:
        """Rows to state instead where the log contradicts; None if none fits."""
        if (seen := self.telling) is None or not self.clash:
            return None
        if near := self._fitting(seen):
            return near[0]
        digits = int(np.ceil(-np.log10(seen.bar)))
        late = round(MIDDLES[self.rows.kind] * self.step - seen.centre, digits)
        return replace(self.rows, delay=late) if abs(late) <= LONGEST else None

    def _fitting(self, seen: RowCentre) -> list[Rows]:
        delays = dict.fromkeys((self.rows.delay, 0.0))
        return [each for d in delays for each in fitting(seen, self.step, d)]

    @property
    def lateness(self) -> float:
        """Delay of the magnetometer from the rows as taken, s; NaN if not seen."""
        if self.compass is None or not self.compass.left < MOST_LEFT:
            return np.nan
        return self.compass.centre - self.rows.centre(self.step)


def fitting(seen: RowCentre, step: float, delay: float) -> list[Rows]:
    """Kinds of rows with this delay that fit within `NEAR`, the nearest first."""
    every = (Rows(kind=kind, delay=delay) for kind in ROW_KINDS)
    near = [each for each in every if seen.off(each.centre(step)) <= NEAR]
    return sorted(near, key=lambda each: seen.off(each.centre(step)))


def judged_rows(
    seen: tuple[RowCentre, ...], step: float, rows: Rows, *, find: bool
) -> RowEvidence:
    """Take the rows as stated, or find their kind, with the stated delay.

    Another kind than theirs is taken where a witness names it alone, and they are off.
    """
    if not find:
        return RowEvidence(rows=rows, why="stated", step=step, seen=seen)
    for each in seen:
        if not each.decides(step):
            continue
        near = fitting(each, step, rows.delay)
        if len(near) == 1 and (near[0] == rows or each.off(rows.centre(step)) > FAR):
            why: Why = "truth" if each.by == "truth" else "accelerometer"
            return RowEvidence(rows=near[0], why=why, step=step, seen=seen)
    return RowEvidence(rows=rows, why="default", step=step, seen=seen)
