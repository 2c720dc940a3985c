r"""Fit a gyroscope to the directions of gravity at rests, alone or with them.

**Generalised least squares for a batch of trials.**

With rows r, derivative J and covariance V the step is :math:`-K r`; K is
:math:`(J^T V^{-1} J)^{-1} J^T V^{-1}` for generalised least squares and
:math:`(J^T J)^{-1} J^T` without weights. In both cases the covariance of the estimate
is :math:`K V K^T`, a sandwich that in the first case is :math:`(J^T V^{-1} J)^{-1}`.

**A start for the gyroscope's matrix: scale, then order and signs of the axes.**

Moves of a radian or two tell a scale within some ten percent from any other, so scales
a tenth apart are tried. If axes are not those of the accelerometer, all 48 orders and
signs are.

The way of a fit: a start; plain Gauss-Newton steps until it is near; a linearisation
there, with the covariance of the rows; steps with it until they are far below the error
bars; and so again from where they ended, until the way there is below `MOVED`. Weights
and covariance are then those at the solution, to the product of that way and of the
noise over the readings.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.calibrate.drift import Drift, find_drift
from simval.calibrate.factors import NoiseFactors, Residuals
from simval.calibrate.gyroscope.covariance import Setting, Spread, shared, spread
from simval.calibrate.gyroscope.moves import Moves, merged, taken
from simval.calibrate.gyroscope.residuals import (
    Rows,
    across,
    carried,
    covariance_of,
    directions,
    gap_rows,
    gap_values,
    gravity,
    influence,
)
from simval.calibrate.gyroscope.turn import end_of, turn
from simval.shapes import Float

_RANK = 1e-7  # of the greatest singular value


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gain:
    """Linear estimator of the rows."""

    K: Float[Array, "t p r"]
    covariance: Float[Array, "t p p"]
    white: Float[Array, "t r r"]  # inverse of the Cholesky factor of V
    J: Float[Array, "t r p"]

    def chi2(self, r: Float[Array, "t r"]) -> Float[Array, " t"]:
        """Weighted sum of squares of rows."""
        w = (self.white @ r[..., None])[..., 0]
        return np.vecdot(w, w)


def least_squares(
    J: Float[Array, "t r p"], r: Float[Array, "t r"]
) -> Float[Array, "t p"]:
    """Plain step, the shortest one where the rows do not tell it."""
    return -np.vecdot(np.linalg.pinv(J, rcond=_RANK), r[:, None])


def gain(J: Float[Array, "t r p"], V: Float[Array, "t r r"], *, weighted: bool) -> Gain:
    """Estimator, generalised or not, and its covariance."""
    white = np.linalg.inv(np.linalg.cholesky(V))
    if weighted:
        K, root = _pseudo_inverse(white @ J)
        K, covariance = K @ white, root @ np.swapaxes(root, -1, -2)
    else:
        K, _ = _pseudo_inverse(J)
        covariance = K @ V @ np.swapaxes(K, -1, -2)
    return Gain(K=K, covariance=covariance, white=white, J=J)


def _pseudo_inverse(
    J: Float[Array, "t r p"],
) -> tuple[Float[Array, "t p r"], Float[Array, "t p p"]]:
    # of full column rank, and the inverse triangle; columns of equal length first
    size = np.sqrt((J * J).sum(axis=1, keepdims=True))
    Q, R = np.linalg.qr(J / size)
    root = np.linalg.inv(R) / np.swapaxes(size, -1, -2)
    return root @ np.swapaxes(Q, -1, -2), root


_RATIO: Final = 1.1  # of neighbouring scales
_LEAST, _MOST = 0.05, 12.0  # rad, along the way of a typical move
_CHUNKS: Final = 1 << 16  # worked at once
_ENOUGH: Final = 24  # chunks of a move: a third of a radian each at the most
GOOD: Final = 0.1  # rad, rms of rows at a start that is near; sensors are 1 % off


def first_matrix(
    statistics: Float[Array, "k 10 j"],
    u: Float[Array, "n 3"],
    E: Float[Array, "k 2 3"],
) -> Float[Array, "3 3"]:
    """Best of the matrices that are a scale times an order of axes."""
    way = np.sqrt((statistics[:, :3] ** 2).sum(axis=1)).sum(axis=1)
    typical = float(np.median(way))
    size = max(1, statistics.shape[-1] // _ENOUGH)
    statistics = merged(statistics[None], 2 ** int(np.log2(size)))[0]
    if not typical > 0.0:
        return np.full((3, 3), np.nan)
    count = int(np.ceil(np.log(_MOST / _LEAST) / np.log(_RATIO)))
    scales = _LEAST / typical * _RATIO ** np.arange(count + 1)
    aligned = scales[:, None, None] * np.eye(3)
    cost = _costs(statistics, u, E, aligned)
    best = aligned[np.argmin(cost)]
    if cost.min() < GOOD:
        return best
    orders = np.array(
        [
            np.eye(3)[list(order)] * np.array(signs)[:, None]
            for order, signs in product(
                permutations(range(3)), product((1, -1), repeat=3)
            )
        ]
    )
    every = (scales[:, None, None, None] * orders).reshape(-1, 3, 3)
    costs = _costs(statistics, u, E, every)
    # as it stands, unless another order is far better
    return every[np.argmin(costs)] if costs.min() < 0.5 * cost.min() else best


def _costs(statistics: Array, u: Array, E: Array, guesses: Array) -> Float[Array, " m"]:
    # root mean square of the rows, rad
    size = max(1, _CHUNKS // (statistics.shape[0] * statistics.shape[2]))
    parts = []
    for i in range(0, len(guesses), size):
        some = guesses[i : i + size]
        C = end_of(statistics[None], some, np.zeros((len(some), 3)))
        m = len(some)
        e = gap_values(
            C, np.broadcast_to(u, (m, *u.shape)), np.broadcast_to(E, (m, *E.shape))
        )
        parts.append(np.sqrt((e * e).mean(axis=-1)))
    return np.concatenate(parts)


NEAR: Final = 3e-3  # relative step; the next error is its square
MOST_PLAIN: Final = 30
MOST_STEPS: Final = 12  # with one linearisation; each takes a thousandth of the error
MOST_LINEAR: Final = 12
SETTLED: Final = 1e-5  # standard deviations
MOVED: Final = 1e-2  # standard deviations that a linearisation may be from the end
ROUNDED: Final = 1e-13  # of the parameters' own size
_ANGLE: Final = 0.5  # rad a chunk on the way there
A = 9  # accelerometer's parameters


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """Rows at a point, their estimator, and what else is asked of them."""

    r: Float[Array, "t r"]
    gain: Gain
    L: Float[Array, "t r m"]  # unit noises of the poses to the rows
    E: Float[Array, "t k 2 3"]
    by_gyroscope: Float[Array, "t e 12"]  # of the gaps, for the observability
    # covariance of the accelerometer's own fit, and of the estimate with it
    accelerometer: Float[Array, "t 9 9"]
    cross: Float[Array, "t p 9"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """Parameters at the end: accelerometer's, M, and B less the centre."""

    theta: Float[Array, "t 9"]
    M: Float[Array, "t 3 3"]
    B: Float[Array, "t 3"]
    linear: Linear
    r: Float[Array, "t r"]
    step: Float[Array, " t"]
    moved: Float[Array, " t"]  # greatest step since the linearisation
    iterations: int


def approach(
    moves: Moves, setting: Setting, u: Float[Array, "t n 3"], M: Float[Array, "t 3 3"]
) -> tuple[Float[Array, "t 3 3"], Float[Array, "t r 12"], Float[Array, "t r"]]:
    """Plain steps on larger chunks, the bias as the rests say.

    Returns M, and the derivative and the values of the gaps a small step before it.
    """
    E = across(u[:, 1:])
    B = setting.bias_value
    statistics = coarse(moves, M)
    for _ in range(MOST_PLAIN):
        moved = turn(statistics, M, B)
        EC = E @ np.swapaxes(moved.C, -1, -2)
        J = np.cross(EC, u[:, :-1, None, :]) @ moved.slopes
        J, e = J.reshape(len(u), -1, 12), gap_values(moved.C, u, E)
        step = least_squares(J[..., :A], e).reshape(-1, 3, 3)
        size = np.linalg.norm(step, axis=(1, 2)) / np.linalg.norm(M, axis=(1, 2))
        # a step of more than a third is outside of what a linearisation tells
        M = M + step * np.minimum(1.0, 0.33 / np.maximum(size, 1e-300))[:, None, None]
        if not np.any(size > NEAR):
            break
    return M, J, e


def coarse(moves: Moves, M: Float[Array, "t 3 3"]) -> Float[Array, "t k 10 c"]:
    """Statistics of larger chunks, good to a few milliradians a move."""
    S = moves.statistics[0, :, :3]
    scale = float(np.linalg.norm(M[0], 2))
    greatest = float(np.sqrt((S * S).sum(axis=1)).max()) * scale
    size = max(1.0, _ANGLE / max(greatest, 1e-300))
    return merged(moves.statistics, min(8, 2 ** int(np.log2(size))))


def linearise(
    moves: Moves,
    poses: Float[Array, "t n 3"],
    setting: Setting,
    theta: Float[Array, "t 9"],
    M: Float[Array, "t 3 3"],
    B: Float[Array, "t 3"],
) -> Linear:
    """Rows, derivative and covariance at a point."""
    noise = setting.noise
    found = gravity(setting.model, theta, poses, setting.g)
    moved = turn(moves.statistics, M, B)
    rows = gap_rows(found, moved, noise.pose_std)
    pulled = influence(found, setting.residual, noise.pose_std)
    found_noise = spread(rows, moved, moves, setting, M, B)
    if not setting.joint:
        rows = carried(rows, pulled)
    t, n = found.c.shape
    norms = n if setting.joint else 0
    own = np.zeros((t, norms, n, 3))
    if norms:
        each = np.arange(n)
        own[:, each, each] = found.c_by_reading * noise.pose_std
    slopes = found.c_by_theta[:, :norms, : A if norms else 0]
    J, V, L = assembled(
        rows, found_noise, setting, slopes, own.reshape(t, norms, 3 * n)
    )
    estimator = gain(J, V, weighted=setting.weighted)
    K = estimator.K[..., : rows.e.shape[1]]
    back = np.swapaxes(pulled, -1, -2)
    return Linear(
        r=_values(rows.e, found.c, B, setting),
        gain=estimator,
        L=L,
        E=rows.E,
        by_gyroscope=rows.by_gyroscope,
        accelerometer=pulled @ back,
        cross=-(K @ rows.by_pose) @ back,
    )


def assembled(
    rows: Rows,
    noise: Spread,
    setting: Setting,
    J_poses: Float[Array, "t c q"],
    L_poses: Float[Array, "t c m"],
) -> tuple[Float[Array, "t r p"], Float[Array, "t r r"], Float[Array, "t r m"]]:
    """J, V and the poses' part of its root: of the moves, the poses, and the bias.

    The parameters are those of the sensors that are read at rest, q, if they are fitted
    too, and the gyroscope's; the bias has rows where it is estimated.
    """
    t, gaps = rows.e.shape
    both, first = gaps + J_poses.shape[1], J_poses.shape[2]
    ends = 3 if setting.free == 12 else 0
    J = np.zeros((t, both + ends, first + setting.free))
    J[:, :gaps, first:] = rows.by_gyroscope[..., : setting.free]
    if first:
        J[:, :gaps, :first] = rows.by_accelerometer
        J[:, gaps:both, :first] = J_poses
    L = np.concatenate([rows.by_pose, L_poses], axis=1)
    V = np.zeros((t, *J.shape[1:2] * 2))
    V[:, :both, :both] = covariance_of(L, noise.blocks)
    if ends:
        J[:, -3:, -3:] = np.eye(3)
        V[:, [-3, -2, -1], [-3, -2, -1]] = setting.bias_std**2
    shared(V, noise, ends)
    return J, V, np.pad(L, ((0, 0), (0, ends), (0, 0)))


def _values(e: Array, c: Array, B: Array, setting: Setting) -> Float[Array, "t r"]:
    parts = [e]
    if setting.joint:
        parts.append(c)
    if setting.free == 12:
        parts.append(B - setting.bias_value)
    return np.concatenate(parts, axis=1)


def ended(
    moves: Moves,
    poses: Float[Array, "t n 3"],
    setting: Setting,
    start: tuple[Array, Array, Array],
) -> Iterator[tuple[Any, Fitted]]:
    """Fit from some theta, M and B: which trials, and where they are, the last holds.

    A trial is linearised again until it stands.
    """
    theta, M, B = map(np.array, start)
    at = np.arange(len(M))
    for _ in range(MOST_LINEAR):
        if not at.size:
            break
        part = moves if len(at) == len(M) else taken(moves, at)
        chosen = replace(setting, bias_value=setting.bias_value[at])
        found = iterate(part, poses[at], chosen, theta[at], M[at], B[at])
        yield at, found
        theta[at], M[at], B[at] = found.theta, found.M, found.B
        at = at[found.moved > MOVED]


def residuals(found: Fitted) -> Residuals:
    """Rows of one joint fit, and whose noise is in them."""
    gain, L = found.linear.gain, found.linear.L[0]
    root = np.linalg.inv(gain.white[0])
    return Residuals.of_rests_and_moves(
        found.r[0], gain.J[0], root @ root.T,
        {"accelerometer": (L.reshape(len(L), -1, 3), slice(0, A))},
        (found.linear.E.shape[1], 2, slice(A, None)),
    )  # fmt: skip


def drift(found: Fitted, moves: Moves, noise: NoiseFactors) -> Drift:
    """Whether a bias or a gain of the gyroscope of one joint fit drifts."""
    gain, gaps = found.linear.gain, found.linear.by_gyroscope[0]
    middle = moves.times[:, 0] + 0.5 * moves.seconds
    time = np.full(
        found.r.shape[1], middle.mean()
    )  # what is no move of its own tells none
    time[: len(gaps)] = np.repeat(middle, 2)
    columns = {}
    for a, axis in enumerate("xyz"):
        scaled = gaps[:, [a, 3 + a, 6 + a]] @ found.M[0][:, a]
        for what, own in (("bias", gaps[:, A + a]), ("gain", scaled)):
            columns[f"the {what} of {axis}"] = np.pad(own, (0, len(time) - len(own)))
    return find_drift(
        found.r[0], gain.J[0], columns, time, known=bool(noise.borne),
        white=gain.white[0],
    )  # fmt: skip


def iterate(
    moves: Moves,
    poses: Float[Array, "t n 3"],
    setting: Setting,
    theta: Float[Array, "t 9"],
    M: Float[Array, "t 3 3"],
    B: Float[Array, "t 3"],
) -> Fitted:
    """Steps with one linearisation until they are far below the error bars."""
    linear = linearise(moves, poses, setting, theta, M, B)
    first = A if setting.joint else 0
    sd = np.sqrt(np.diagonal(linear.gain.covariance, axis1=-2, axis2=-1))
    size = _sizes(moves, M, theta, first, setting.free)
    r = linear.r
    taken, left = np.full(len(M), np.nan), np.full(len(M), np.inf)
    moved = np.zeros(len(M))
    for count in range(1, MOST_STEPS + 1):
        step = -(linear.gain.K @ r[..., None])[..., 0]
        step[left <= SETTLED] = 0.0  # a trial does not wait for its neighbours
        theta = theta + step[:, :first] if first else theta
        M = M + step[:, first : first + A].reshape(-1, 3, 3)
        B = B + step[:, first + A :] if setting.free == 12 else B
        last, taken = taken, np.max(np.abs(step) / sd, axis=1)
        rounding = np.max(np.abs(step) / size, axis=1) <= ROUNDED
        moved = np.maximum(moved, np.where(rounding, 0.0, taken))
        left = np.where(rounding, 0.0, _left(taken, last))
        if np.all(left <= SETTLED) or count == MOST_STEPS:
            r = r + (linear.gain.J @ step[..., None])[..., 0]
            break
        r = _rows_at(moves, poses, setting, theta, M, B, linear.E)
    return Fitted(
        theta=theta, M=M, B=B, linear=linear, r=r, step=left, moved=moved,
        iterations=count,
    )  # fmt: skip


def _left(taken: Float[Array, " t"], last: Float[Array, " t"]) -> Float[Array, " t"]:
    # what the next step would be if steps go on shrinking as they did
    shrinking = np.where(np.isnan(last), 1.0, taken / np.maximum(last, 1e-300))
    return taken * np.minimum(shrinking, 1.0)


def _rows_at(
    moves: Moves,
    poses: Array,
    setting: Setting,
    theta: Array,
    M: Array,
    B: Array,
    E: Array,
) -> Float[Array, "t r"]:
    u, c = directions(setting.model, theta, poses, setting.g)
    e = gap_values(end_of(moves.statistics, M, B), u, E)
    return _values(e, c, B, setting)


def _sizes(
    moves: Moves, M: Array, theta: Array, first: int, free: int
) -> Float[Array, "t p"]:
    # what rounding is measured against
    t = len(M)
    way = np.sqrt((moves.statistics[:, :, :3] ** 2).sum(axis=2)).sum(axis=-1)
    rate = (way / moves.seconds).mean(axis=1)
    scale = np.linalg.norm(M, axis=(1, 2))[:, None]
    parts = [np.broadcast_to(scale, (t, A))]
    if first:
        parts.insert(0, np.maximum(np.abs(theta), np.abs(theta[:, 3:6]).mean()))
    if free == 12:
        parts.append(np.broadcast_to(rate[:, None], (t, 3)))
    return np.concatenate(parts, axis=1)
