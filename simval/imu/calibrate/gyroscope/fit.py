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

The way of a fit: a start; plain Gauss-Newton steps until it is near; and the solver of
`equations`, or without the accelerometer's parameters generalised least squares,
linearised again until no step is left.
"""

from dataclasses import dataclass
from itertools import permutations, product
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate.drift import Drift, find_drift
from simval.imu.calibrate.equations import (
    TOLERANCE,
    Accelerometer,
    Corrected,
    Local,
    Problem,
    Solution,
)
from simval.imu.calibrate.factors import NoiseFactors
from simval.imu.calibrate.gyroscope.covariance import Setting
from simval.imu.calibrate.gyroscope.moves import Moves, merged
from simval.imu.calibrate.gyroscope.residuals import InterRest, across, gap_values
from simval.imu.calibrate.gyroscope.turn import end_of, turn
from simval.imu.calibrate.residuals import WEIGHTED, noise_shares
from simval.shapes import Float

_RANK = 1e-7  # of the greatest singular value


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gain:
    """Linear estimator of the rows."""

    K: Float[Array, "t p r"]
    covariance: Float[Array, "t p p"]
    white: Float[Array, "t r r"]  # inverse of the Cholesky factor of V

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
    return Gain(K=K, covariance=covariance, white=white)


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
MOST_STEPS: Final = 30
ROUNDED: Final = 1e-14  # of a row
_ANGLE: Final = 0.5  # rad a chunk on the way there
A = 9  # accelerometer's parameters


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """Where the fit of each trial ended."""

    theta: Float[Array, "t p"]  # accelerometer's, M, and B less the centre if fitted
    covariance: Float[Array, "t 21 21"]
    chi2: Float[Array, " t"]
    step: Float[Array, " t"]  # the last, in standard deviations
    iterations: Any  # (t,)
    converged: Any  # bool, (t,)
    turned: Float[Array, "t e 12"]  # derivative of the rows of the turns by M and B


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


def problem_of(moves: Moves, poses: Float[Array, "t n 3"], setting: Setting) -> Problem:
    """Accelerometer and gyroscope of the same rests."""
    std = np.broadcast_to(setting.noise.pose_std, poses.shape)
    sensor = Accelerometer(readings=poses, std=std, model=setting.model, g=setting.g)
    turns = InterRest(moves=moves, setting=setting, each=2)
    return Problem(sensors=(sensor,), turns=turns)


def turns_of(problem: Problem) -> InterRest:
    """The gyroscope's block."""
    assert isinstance(problem.turns, InterRest)
    return problem.turns


def joint(problem: Problem, found: Solution, here: Local) -> Fitted:
    """Both sensors in one fit: their covariance."""
    setting, between = turns_of(problem).setting, here.between
    assert between is not None
    covariance = np.zeros((len(found.theta), 21, 21))
    free = A + setting.free
    covariance[:, :free, :free] = here.covariance()[0]
    last = np.arange(free, 21)
    covariance[:, last, last] = setting.bias_std[: len(last)] ** 2
    return Fitted(
        theta=found.theta,
        covariance=covariance,
        chi2=here.chi_square,
        step=found.step,
        iterations=found.iterations,
        converged=found.converged,
        turned=between.whole,
    )


def one_way(problem: Problem, theta: Float[Array, "t p"]) -> Fitted:
    """The gyroscope beside an accelerometer that is held, whose error it inherits.

    The noise of a pose reaches a row on two ways, directly and through the
    accelerometer's own fit, of which (U1) is the covariance.
    """
    turns, theta = turns_of(problem), theta.copy()
    at, setting = problem.corrected(theta[:, :A]), turns.setting
    pulled = influence(problem, at, theta[:, :A], setting)
    t = len(theta)
    for count in range(1, MOST_STEPS + 1):
        rows = turns.rows(at, theta[:, A:])
        by_theta, direct = rows.by["accelerometer"]
        L = direct.reshape(t, rows.r.shape[1], -1) + by_theta @ pulled
        V = L @ np.swapaxes(L, -1, -2) + rows.V
        found = gain(rows.own, V, weighted=setting.weighted)
        step = -np.matvec(found.K, rows.r)
        sd = np.sqrt(np.diagonal(found.covariance, axis1=-2, axis2=-1))
        taken = np.max(np.abs(step) / sd, axis=1)
        change = np.abs(np.matvec(rows.own, step)).max(axis=1)
        settled = (taken <= TOLERANCE) | (change <= ROUNDED)
        step[settled] = 0.0  # the numbers are those of the linearisation
        if settled.all() or count == MOST_STEPS:
            break
        theta[:, A:] += step
    covariance = np.zeros((t, 21, 21))
    back, free = np.swapaxes(pulled, -1, -2), A + setting.free
    cross = -(found.K @ L) @ back
    covariance[:, :A, :A] = pulled @ back
    covariance[:, A:free, :A] = cross
    covariance[:, :A, A:free] = np.swapaxes(cross, -1, -2)
    covariance[:, A:free, A:free] = found.covariance
    last = np.arange(free, 21)
    covariance[:, last, last] = setting.bias_std[: len(last)] ** 2
    return Fitted(
        theta=theta, covariance=covariance, chi2=found.chi2(rows.r), step=taken,
        iterations=np.full(t, count), converged=settled, turned=rows.whole,
    )  # fmt: skip


def influence(
    problem: Problem, at: dict[str, Corrected], theta: Array, setting: Setting
) -> Float[Array, "t 9 m"]:
    r"""Error of the accelerometer's parameters by unit noise of each pose and axis.

    Its own fit solves :math:`\sum_i a_i c_i d_i = 0, d = \partial c/\partial\theta`,
    with the weights a of eq. (U1) of `evidence`.
    """
    alone = Problem(sensors=problem.sensors)
    _, J, L = alone.rests(at, theta)
    d, noise, std = J[:, :, 0], L[:, :, 0], problem.sensors[0].std
    root = np.ones(d.shape[:2])
    if setting.residual in WEIGHTED:
        shares = noise_shares(setting.residual, np.sqrt((std[0] ** 2).mean(axis=1)))
        weight = 1.0 if shares is None else shares
        root = np.sqrt(weight / ((noise / std) ** 2).sum(axis=-1))
    rows = d * root[..., None]
    size = np.sqrt((rows * rows).sum(axis=1, keepdims=True))
    Q, R = np.linalg.qr(rows / size)
    pull = (Q * root[..., None])[..., None, :] * noise[..., :, None]  # t n 3 9
    flat = np.swapaxes(pull.reshape(len(root), -1, 9), -1, -2)
    return -np.linalg.solve(R, flat) / np.swapaxes(size, -1, -2)


def drift(problem: Problem, found: Solution, here: Local, noise: NoiseFactors) -> Drift:
    """Whether a bias or a gain of the gyroscope of one joint fit drifts."""
    turns, between, white = turns_of(problem), here.between, here.white[0]
    assert between is not None
    moves, gaps = turns.moves, between.whole[0]
    M = turns.split(found.theta[:, A:])[0][0]
    middle = moves.times[:, 0] + 0.5 * moves.seconds
    # what is no move of its own tells none
    time = np.full(len(white), middle.mean())
    time[: len(gaps)] = np.repeat(middle, 2)
    columns = {}
    for a, axis in enumerate("xyz"):
        scaled = gaps[:, [a, 3 + a, 6 + a]] @ M[:, a]
        for what, column in (("bias", gaps[:, A + a]), ("gain", scaled)):
            whole = np.pad(column, (0, len(time) - len(column)))
            columns[f"the {what} of {axis}"] = whole
    r, J = (np.linalg.solve(white, x) for x in (here.rows[0], here.slopes[0]))
    return find_drift(r, J, columns, time, known=bool(noise.borne), white=white)
