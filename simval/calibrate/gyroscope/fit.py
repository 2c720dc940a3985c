r"""Fit a gyroscope to the directions of gravity at rests, alone or with them.

The way of a fit: a start; plain Gauss-Newton steps until it is near; a linearisation
there, with the covariance of the rows; steps with it until they are far below the error
bars; and so again from where they ended, until the way there is below `MOVED`. Weights
and covariance are then those at the solution, to the product of that way and of the
noise over the readings.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.calibrate.drift import Drift, find_drift
from simval.calibrate.factors import NoiseFactors, Residuals
from simval.calibrate.gyroscope.gravity import (
    Gravity,
    across,
    directions,
    gravity,
    influence,
)
from simval.calibrate.gyroscope.moves import Moves, taken
from simval.calibrate.gyroscope.rows import (
    Rows,
    carried,
    covariance_of,
    gap_rows,
    gap_values,
)
from simval.calibrate.gyroscope.setting import Setting
from simval.calibrate.gyroscope.solve import Gain, gain, least_squares
from simval.calibrate.gyroscope.spread import Spread, shared, spread
from simval.calibrate.gyroscope.statistics import merged
from simval.calibrate.gyroscope.turn import end_of, turn
from simval.shapes import Float

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
    r, J, V, L = _assembled(rows, found_noise, found, setting, B)
    estimator = gain(J, V, weighted=setting.weighted)
    K = estimator.K[..., : rows.e.shape[1]]
    back = np.swapaxes(pulled, -1, -2)
    return Linear(
        r=r,
        gain=estimator,
        L=L,
        E=rows.E,
        by_gyroscope=rows.by_gyroscope,
        accelerometer=pulled @ back,
        cross=-(K @ rows.by_pose) @ back,
    )


def _assembled(
    rows: Rows,
    noise: Spread,
    found: Gravity,
    setting: Setting,
    B: Float[Array, "t 3"],
) -> tuple[Array, Array, Array, Array]:
    # r, J, V and the poses' part of its root; rows are the gaps, then norms if the fit
    # is joint, then the bias if it is estimated
    t, gaps = rows.e.shape
    n = found.u.shape[1]
    count, norms = setting.free, n if setting.joint else 0
    ends = 3 if count == 12 else 0
    first = A if setting.joint else 0
    J = np.zeros((t, gaps + norms + ends, first + count))
    J[:, :gaps, first:] = rows.by_gyroscope[..., :count]
    L = rows.by_pose
    if setting.joint:
        J[:, :gaps, :A] = rows.by_accelerometer
        J[:, gaps : gaps + n, :A] = found.c_by_theta
        norm = np.zeros((t, n, n, 3))
        each = np.arange(n)
        norm[:, each, each] = found.c_by_reading * setting.noise.pose_std
        L = np.concatenate([L, norm.reshape(t, n, -1)], axis=1)
    V = np.zeros((t, *J.shape[1:2] * 2))
    V[:, : gaps + norms, : gaps + norms] = covariance_of(L, noise.blocks)
    if ends:
        J[:, -3:, -3:] = np.eye(3)
        V[:, [-3, -2, -1], [-3, -2, -1]] = setting.bias_std**2
    shared(V, noise, ends)
    L = np.pad(L, ((0, 0), (0, ends), (0, 0)))
    return _values(rows.e, found.c, B, setting), J, V, L


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
