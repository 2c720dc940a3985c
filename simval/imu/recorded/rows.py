r"""When the rows of a gyroscope are of, by a vector that the body turns past.

**Their middle** c against the stamps (`simval.imu.logs.rows`, eq. (W1)). In a window of
two seconds the gyroscope's attitudes A, from its first row on, turn the readings v of a
vector sensor back. Gravity g (or the field) is then constant; what is left is

.. math:: A_k^T v_k = g + \delta c\, A_k^T(\omega_k \times A_k g)
   + A_k^T(b + M A_k g + L_k r) + \theta_k \times g,  \tag{W2}

rows that are :math:`\delta c` off, the sensor's bias and calibration, its lever arm r
(:math:`L r = \dot\omega \times r + \omega \times (\omega \times r)`), and what bias and
calibration of the gyroscope turn by, :math:`\theta`. Each window has a g of its own; the
others are common, with wide priors, without which a thrust is a bias. A window counts
by the inverse of what it leaves. It is the *predicted* Ag that is in the products: the
reading's own noise would be on both sides.

**The error bar** leaves out blocks of windows by turns, as eq. (R2). What is left of
(W2) is real acceleration, and where that is in step with the turning, it moves c: so
`COHERENT` of it is taken to be, and is in the bar. Where most of what the sensor shows
is left, no bar is true, and the answer is refused.
"""

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.geometry import attitude_matrix, cross_matrix, from_rotation_vector
from simval.imu.logs.rows import HOLE, MIDDLES, Rows
from simval.shapes import Float, Int

WINDOW: Final = 2.0  # s
MOVING: Final = 0.1  # rad/s, RMS in a window that counts
FEWEST: Final = 10  # windows
MOST_ROWS: Final = 60_000  # in windows that count: those that turn most
BLOCKS: Final = 20
STEPS: Final = 8
ENOUGH: Final = 1e-6  # s
COHERENT: Final = 0.05
"""Share of what is left that may be in step with the motion: two recordings of BROAD
(docs/filters_recorded.md) leave their rows at -1.5 and -2.5 ms by optical positions, and
-2.9 and -11.4 ms by (W2)."""
MOST_LEFT: Final = 0.5
"""Share of what the vector shows in the windows that may be left: of a multirotor, whose
force is along its axis, it is 0.98, and its middle 7 to 19 ms off."""
NARROW: Final = 1.0 / 6.0
"""Of a step: with three such bars one middle of (W1) is at most near."""
SMOOTH: Final = 0.02  # s, to each side, of the polynomial that a rate is by
FARTHEST: Final = 0.25  # s, that a middle is looked for
BENT: Final = np.array([
    np.diag([1.0, -1.0, 0.0]), np.diag([1.0, 1.0, -2.0]),
    [[0, 1, 0], [1, 0, 0], [0, 0, 0]], [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
    [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
])  # fmt: skip
"""Symmetric changes of a vector sensor's axes that leave its mean scale."""
NEAR: Final = 3.0  # bars, of a middle that agrees
FAR: Final = 4.0  # bars, of one that does not

PRIOR: Final = {  # s, the vector's bias and bends over its length
    "accelerometer": [1.0, *[0.05] * 3, *[0.03] * 5],
    "magnetometer": [1.0, *[0.05] * 3, *[0.03] * 5],
}

Witness = Literal["accelerometer", "magnetometer", "truth"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RowCentre:
    """Middle of a gyroscope's rows by another sensor.

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
    left : float
        Share of what the sensor shows that turning does not explain.
    windows : int
        Windows of `WINDOW` that count.
    """

    by: Witness
    centre: float
    sd: float
    coherent: float = 0.0
    left: float = 0.0
    windows: int = 0

    @property
    def bar(self) -> float:
        """One standard deviation of it, s."""
        return float(np.hypot(self.sd, self.coherent))

    @property
    def half(self) -> float:
        """Half width of its 95 % interval, s."""
        return 2.0 * self.bar

    def decides(self, step: float) -> bool:
        """Whether it can tell conventions apart, with the log's step, s."""
        return self.left < MOST_LEFT and self.bar < NARROW * step

    def off(self, centre: float) -> float:
        """Distance from a middle, in bars."""
        return abs(self.centre - centre) / self.bar


def row_centre(
    time: Float[Array, " n"],
    gyro: Float[Array, "n 3"],
    vector: Float[Array, "n 3"],
    by: Witness,
) -> RowCentre:
    """Find the middle of a gyroscope's rows, rad/s, against those of a vector sensor.

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
    size = max(8, round(WINDOW / step))
    gyro = gyro - np.median(gyro, axis=0)
    starts = _starts(time, gyro, vector, size)
    if len(starts) < FEWEST:
        return RowCentre(by=by, centre=np.nan, sd=np.nan, windows=len(starts))
    rows = starts[:, None] + np.arange(size)
    lever = 3 if by == "accelerometer" else 0
    prior = np.concatenate([PRIOR[by], [0.5] * lever, [0.02] * 3, [0.03] * 9])
    centre, arm = MIDDLES["before"] * step, np.zeros(3)
    for k in range(STEPS):
        late = Rows(delay=MIDDLES["before"] * step - centre)
        means = np.nan_to_num(late.means(time, gyro))
        fit = _fit(time, means, vector, rows, prior, arm, by)
        if lever:
            arm = fit.solution[9:12]
        if lever and k < 2:  # the arm first: its force moves with the rows
            continue
        change = float(np.clip(fit.solution[0], -FARTHEST - centre, FARTHEST - centre))
        centre += change
        if abs(change) < ENOUGH:
            break
    return RowCentre(
        by=by, centre=centre, sd=fit.sd, coherent=COHERENT * fit.moved, left=fit.left,
        windows=len(starts),
    )  # fmt: skip


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


class _Fit(NamedTuple):
    """Least squares of eq. (W2)."""

    solution: Float[Array, " p"]  # change of the middle, s, first
    sd: float  # of that, by blocks
    moved: float  # s, by which all that is left would move it, were it in step
    left: float  # share of what the sensor shows


def _fit(
    time: Float[Array, " n"],
    means: Float[Array, "n 3"],
    vector: Float[Array, "n 3"],
    rows: Int[np.ndarray, "w s"],
    prior: Float[Array, " p"],
    arm: Float[Array, "3"],
    by: Witness,
) -> _Fit:
    count = len(rows)
    X, u = _equations(time, means, vector, rows, arm, by)
    X = (X - X.mean(axis=1, keepdims=True)).reshape(count, -1, len(prior))
    u = (u - u.mean(axis=1, keepdims=True)).reshape(count, -1)
    N, b = X.swapaxes(1, 2) @ X, np.vecmat(u, X)
    weight = np.full(count, 1.0 / np.median(np.mean(u**2, axis=1)))
    for _ in range(4):
        whole = np.einsum("w,wpq->pq", weight, N) + np.diag(prior**-2.0)
        right = weight @ b
        solution = np.linalg.solve(whole, right)
        rest = np.mean((u - X @ solution) ** 2, axis=1)
        weight = 1.0 / (rest + np.median(rest))
    parts = np.array_split(np.arange(count), min(BLOCKS, count))
    without = np.array([
        np.linalg.solve(
            whole - np.einsum("w,wpq->pq", weight[k], N[k]), right - weight[k] @ b[k]
        )[0]
        for k in parts
    ])  # fmt: skip
    share = (len(parts) - 1) / len(parts)
    shown = vector[rows] - vector[rows].mean(axis=1, keepdims=True)
    column = weight @ np.mean(X[:, :, 0] ** 2, axis=1)
    # what the sensor shows from row to row where it is quietest is in step with nothing
    jumps = np.mean(np.diff(vector, axis=0) ** 2, axis=1)
    size = rows.shape[1]
    quiet = jumps[: len(jumps) // size * size].reshape(-1, size).mean(axis=1).min()
    slow = weight @ np.maximum(rest - 0.5 * quiet, 0.0)
    return _Fit(
        solution=solution,
        sd=float(np.sqrt(share * np.sum((without - without.mean()) ** 2))),
        moved=float(np.sqrt(slow / column)),
        left=float(np.sum(rest) * u.shape[1] / np.sum(shown**2)),
    )


def _equations(
    time: Float[Array, " n"],
    means: Float[Array, "n 3"],
    vector: Float[Array, "n 3"],
    rows: Int[np.ndarray, "w s"],
    arm: Float[Array, "3"],
    by: Witness,
) -> tuple[Float[Array, "w s 3 p"], Float[Array, "w s 3"]]:
    # columns of eq. (W2), and the readings turned back
    step = np.diff(time, prepend=2.0 * time[0] - time[1])
    h = step[rows][..., None]
    back = _attitudes(means * step[:, None], rows).swapaxes(2, 3)
    rate, speed = _rates(means * step[:, None], step, rows)
    u = np.matvec(back, vector[rows])
    g = u.mean(axis=1, keepdims=True)
    p = np.matvec(back.swapaxes(2, 3), g)
    late = np.matvec(back, np.cross(rate, p))
    size = np.linalg.norm(g, axis=2)[..., None]
    columns = [size[..., None] * back, *(np.matvec(back, p @ M)[..., None] for M in BENT)]
    if by == "accelerometer":
        L = cross_matrix(speed) + cross_matrix(rate) @ cross_matrix(rate)
        columns.append(back @ L)
        late = late - np.matvec(back, np.gradient(L @ arm, axis=1) / h)
    turns = [back, *(back * rate[:, :, None, j : j + 1] for j in range(3))]
    for each in turns:
        theta = np.cumsum(each * h[..., None], axis=1)
        columns.append(-np.cross(g[..., None], theta, axis=2))
    return np.concatenate([late[..., None], *columns], axis=3), u


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
