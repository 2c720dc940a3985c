r"""Calibrate a gyroscope from its rotations between rests.

The way of a fit: a start; plain Gauss-Newton steps on merged chunks until it is near;
and the solver of `equations`, each trial by itself. Without the accelerometer's
parameters, which are then held, their errors are noise of the residuals; generalised
least squares weighs by the whole covariance V, the unweighted estimator by none, and of
both the covariance is :math:`K V K^T`, K the gain of the estimator.

**A start for the gyroscope's matrix: scale, then order and signs of the axes.**

Rotations of a radian or two tell a scale within some ten percent from any other, so
scales a tenth apart are tried. If axes are not those of the accelerometer, all 48
orders and signs are.
"""

from typing import Any, Final, get_args

import numpy as np

from simval.arrays import Array, outer
from simval.errors import GeometryError, InputError
from simval.geometry import normalize
from simval.imu.calibrate.drift import Drift, find_drift
from simval.imu.calibrate.equations import Accelerometer, HeldAccelerometer, Problem
from simval.imu.calibrate.factors import NOT_JUDGED, NoiseFactors
from simval.imu.calibrate.gauss_newton import JointSolution, minimize, weighed
from simval.imu.calibrate.gyroscope.noise import Weighting, floored, noise_of
from simval.imu.calibrate.gyroscope.residuals import (
    InterRest,
    across,
    inter_rest_residuals,
)
from simval.imu.calibrate.gyroscope.result import GyroscopeFit
from simval.imu.calibrate.gyroscope.rotation import final_rotations, rotations
from simval.imu.calibrate.path_statistics import InterRestRotations, merged
from simval.imu.calibrate.recording import Recording
from simval.imu.calibrate.residuals import WEIGHTED, noise_shares
from simval.imu.calibrate.result import FitResult
from simval.poses import axis_orders
from simval.shapes import Float, Int
from simval.spelling import counted
from simval.turns import MATRIX, TurnObservability, best_next_turn, judge, missing

A: Final = 9  # accelerometer's parameters, and entries of M
MOST_STEPS: Final = 30
_RANK: Final = 1e-7  # of the greatest singular value
ESTIMATORS: Final = get_args(Weighting)
_FAR: Final = 0.05
"""rad, rms of the residuals, beyond which the rotations lead somewhere else. Chosen:
recordings by hand leave 0.01, columns of another log 0.1 and more."""

CONDITION_LIMIT: Final = 100.0
"""Greatest condition of the rotations. Chosen: five in generic directions have about
10, forty 2; those whose axes lie within a degree of a plane have 60 and more."""
SD_LIMIT: Final = 0.1
"""Greatest standard deviation of any relative error of M. Chosen: an uncalibrated
gyroscope is known to a few percent from its data sheet."""


def relative_rows(
    by_gyroscope: Float[Array, "r 12"], M: Float[Array, "3 3"]
) -> Float[Array, "r 9"]:
    """Rows by the relative error D = dM M^-1, from rows by the entries of M."""
    by_matrix = by_gyroscope[:, :MATRIX].reshape(-1, 3, 3)
    return (by_matrix @ M.T).reshape(-1, MATRIX)


def worst_sd(covariance: Float[Array, "9 9"], M: Float[Array, "3 3"]) -> float:
    """Largest standard deviation of a relative error of length 1."""
    to_relative = np.kron(np.eye(3), np.linalg.inv(M).T)
    values, _ = np.linalg.eigh(to_relative @ covariance @ to_relative.T)
    return np.sqrt(values[-1])


def require_told(
    rows: Float[Array, "r 9"], u: Float[Array, "n 3"], sd: float | None = None
) -> TurnObservability:
    """Refuse rotations that do not determine the nine entries of M.

    Raises
    ------
    GeometryError
        If they do not: the message names what is missing and the turn that helps most.
    """
    found = judge(rows)
    told = found.rank == MATRIX and found.condition <= CONDITION_LIMIT
    if told and (sd is None or sd <= SD_LIMIT):
        return found
    axis, angle = best_next_turn(rows, u[-1])
    named = ", ".join(f"{x:.2f}" for x in axis)
    if found.rank < MATRIX:
        fault = f"have rank {found.rank} of {MATRIX}"
    elif not told:
        fault = f"have condition {found.condition:.3g}, {CONDITION_LIMIT:g} at most"
    else:
        fault = f"leave a relative error of {sd:.2g}, {SD_LIMIT:g} at most"
    msg = (
        f"the {len(rows) // 2} rotations {fault}: they do not determine "
        f"{missing(found)}"
    )
    do = (
        f"from the last rest turn by {np.degrees(angle):.0f} degrees about the axis "
        f"({named}) of the sensor and rest again, and so on with other axes"
    )
    numbers = {"rank": found.rank, "condition": found.condition, "relative_sd": sd}
    raise GeometryError(msg, do, **numbers)


def fit_gyroscope(
    recording: Recording, accelerometer: FitResult, estimator: Weighting, start: Any
) -> GyroscopeFit:
    """Fit M and B to the rotations between rests, one recording or a batch.

    Raises
    ------
    InputError
        If a value is not usable.
    GeometryError
        If the rotations of one recording do not tell the parameters. In a batch such a
        trial has a status that says so, and NaN for its numbers.
    RefusedError
        If the residuals of one recording are far beyond the noise of a sensor.
    """
    inter_rest, single = recording.rotations, recording.single
    assert inter_rest is not None
    readings = recording.poses[None] if single else recording.poses
    theta = _parameters(accelerometer, len(readings))
    noise = noise_of(recording, kept=estimator == "unweighted")
    sensor, count = sensor_of(recording), readings.shape[1]
    u = normalize(sensor.corrected(theta).w)
    M, J, e = approach(inter_rest, noise.bias_value, u, _start(inter_rest, u, start))
    refusals, condition = _judged(u, M, J, e)
    if single and refusals[0] is not None:
        raise refusals[0]
    good = np.array([each is None for each in refusals])
    turns = InterRest(inter_rest=inter_rest, noise=noise, each=2)
    begin = [M.reshape(-1, A), noise.bias_value[:, : noise.free - A]]
    factors, follows = NOT_JUDGED, None
    if estimator == "joint":
        problem = Problem(sensors=(sensor,), turns=turns)
        begin = [theta, *begin]
    else:
        weighted = estimator == "generalised"
        held = held_of(sensor, theta, accelerometer.residual)
        problem = Problem(sensors=(held,), turns=turns, weighted=weighted)
    start = np.where(good[:, None], np.concatenate(begin, axis=1), np.nan)
    solution = minimize(problem, start, MOST_STEPS)
    # a noise of zero, or below rounding, is no statement
    if single and estimator == "joint" and np.all(sensor.std == recording.pose_std):
        problem, solution, factors = weighed(problem, solution, MOST_STEPS)
        follows = drift(problem, solution, factors)
    dof = 2 * len(inter_rest.before) - A + (count - A if estimator == "joint" else 0)
    result = _numbers(problem, solution, theta, dof)
    if single:
        M, told = result["parameters"][0, :A].reshape(3, 3), result["covariance"][0]
        sd = worst_sd(told[A : 2 * A, A : 2 * A], M)
        require_told(relative_rows(solution.here.whole[0], M), u[0], sd)
    status = np.where(solution.converged, "converged", "max iterations").astype(object)
    for k in np.flatnonzero(~good):
        status[k] = f"refused: {refusals[k]}"
        for values in result.values():
            values[k] = np.nan
    result |= {"iterations": solution.iterations, "condition": condition}
    result["status"] = status
    if single:
        result = {name: value[0] for name, value in result.items()}
    return GyroscopeFit(
        model=recording.model, estimator=estimator, bias=recording.bias, dof=dof,
        noise=factors, drift=follows, **result,
    )  # fmt: skip


def sensor_of(recording: Recording) -> Accelerometer:
    """The accelerometer's readings, with at least rounding as their noise."""
    readings = recording.poses[None] if recording.single else recording.poses
    std = np.broadcast_to(floored(recording.pose_std, readings), readings.shape)
    return Accelerometer(
        readings=readings, std=std, model=recording.model, g=recording.g
    )


def held_of(
    sensor: Accelerometer, theta: Float[Array, "t 9"], residual: str
) -> HeldAccelerometer:
    """The accelerometer with the parameters and errors of its own fit."""
    return HeldAccelerometer(
        readings=sensor.readings, std=sensor.std, model=sensor.model, g=sensor.g,
        theta=theta, error=influence(sensor, theta, residual),
    )  # fmt: skip


def _numbers(
    problem: Problem, solution: JointSolution, theta: Array, dof: int
) -> dict[str, Array]:
    # of the fit of each trial, theta the accelerometer's where that was held
    turns, here, sensor = problem.turns, solution.here, problem.sensors[0]
    assert isinstance(turns, InterRest)
    free = A + turns.size
    covariance = np.zeros((len(theta), 21, 21))
    last = np.arange(free, 21)
    covariance[:, last, last] = turns.noise.bias_std[: len(last)] ** 2
    if isinstance(sensor, HeldAccelerometer):
        own, error = solution.theta, sensor.error.mT
        inner, by_noise, chi2 = here.sandwich()
        cross = by_noise @ error
        covariance[:, :A, :A] = sensor.error @ error
        covariance[:, A:free, A:free] = inner
        covariance[:, A:free, :A] = cross
        covariance[:, :A, A:free] = cross.mT
    else:
        theta, own = solution.theta[:, :A], solution.theta[:, A:]
        covariance[:, :free, :free], chi2 = here.covariance()[0], here.chi_square
    return {
        "parameters": turns.parameters(own),
        "accelerometer": np.array(theta),
        "covariance": covariance,
        "residual_angles": turns.angles(here.at, own),
        "chi2_per_dof": chi2 / dof if dof > 0 else np.full(len(theta), np.nan),
    }


def _parameters(accelerometer: FitResult, trials: int) -> Float[Array, "t 9"]:
    theta = np.atleast_2d(accelerometer.parameters)
    if theta.shape != (trials, A):
        msg = (
            f"`accelerometer` holds {counted(len(theta), 'fit')} for "
            f"{counted(trials, 'trial')}; give one for each"
        )
        raise InputError(msg)
    if not np.isfinite(theta).all():
        msg = (
            "some trials have no calibration of the accelerometer; leave those "
            "trials out"
        )
        raise InputError(msg)
    return theta


def _start(
    inter_rest: InterRestRotations, u: Float[Array, "t n 3"], start: Any
) -> Float[Array, "t 3 3"]:
    if start is not None:
        return np.broadcast_to(start, (len(u), 3, 3))
    found = [
        first_matrix(each, own, inter_rest.before)
        for each, own in zip(inter_rest.statistics, u, strict=True)
    ]
    if not np.isfinite(found).all():
        msg = "the gyroscope reads nothing between the rests; check its columns"
        raise InputError(msg)
    return np.array(found)


def _judged(
    u: Float[Array, "t n 3"],
    M: Float[Array, "t 3 3"],
    J: Float[Array, "t r 12"],
    e: Float[Array, "t r"],
) -> tuple[list[GeometryError | None], Float[Array, " t"]]:
    # why a trial is refused, None where it is not, and the condition of its rotations
    off = np.sqrt((e * e).mean(axis=1))
    condition, found = np.full(len(u), np.inf), list[GeometryError | None]()
    for i, each in enumerate(J):
        try:
            condition[i] = require_told(relative_rows(each, M[i]), u[i]).condition
            if not off[i] <= _FAR:
                words = (
                    f"the rotations end {off[i]:.2g} rad (rms) from where gravity is, "
                    "whatever the scale and the order of the axes"
                )
                do = (
                    "look at the time of both sensors, at saturation, and whether the "
                    "columns are what they are taken for"
                )
                raise GeometryError(words, do, rms_rad=float(off[i]))
            found.append(None)
        except GeometryError as refusal:
            found.append(refusal)
    return found, condition


_RATIO: Final = 1.1  # of neighbouring scales
_LEAST, _MOST = 0.05, 12.0  # rad, along the way of a typical rotation
_CHUNKS: Final = 1 << 16  # worked at once
_ENOUGH: Final = 24  # chunks of a rotation: a third of a radian each at the most
GOOD: Final = 0.1  # rad, rms of rows at a start that is near; sensors are 1 % off


def first_matrix(
    statistics: Float[Array, "k 10 j"],
    u: Float[Array, "n 3"],
    before: Int[np.ndarray, " k"],
) -> Float[Array, "3 3"]:
    """The best starting matrix among scaled orders of the axes."""
    way = np.sqrt((statistics[:, :3] ** 2).sum(axis=1)).sum(axis=1)
    typical = np.median(way)
    size = max(1, statistics.shape[-1] // _ENOUGH)
    statistics = merged(statistics[None], 2 ** int(np.log2(size)))[0]
    if not typical > 0.0:
        return np.full((3, 3), np.nan)
    count = int(np.ceil(np.log(_MOST / _LEAST) / np.log(_RATIO)))
    scales = _LEAST / typical * _RATIO ** np.arange(count + 1)
    aligned = scales[:, None, None] * np.eye(3)
    cost = _costs(statistics, u, before, aligned)
    best = aligned[np.argmin(cost)]
    if cost.min() < GOOD:
        return best
    every = (scales[:, None, None, None] * axis_orders()).reshape(-1, 3, 3)
    costs = _costs(statistics, u, before, every)
    # as it stands, unless another order is far better
    return every[np.argmin(costs)] if costs.min() < 0.5 * cost.min() else best


def _costs(
    statistics: Array, u: Array, before: Any, guesses: Array
) -> Float[Array, " m"]:
    # root mean square of the rows, rad
    E = across(u[None, before + 1])
    size = max(1, _CHUNKS // (statistics.shape[0] * statistics.shape[2]))
    parts = []
    for i in range(0, len(guesses), size):
        some = guesses[i : i + size]
        C = final_rotations(statistics[None], some, np.zeros((len(some), 3)))
        e = inter_rest_residuals(C, u[None], E, before)
        parts.append(np.sqrt((e * e).mean(axis=-1)))
    return np.concatenate(parts)


_NEAR: Final = 3e-3  # relative step; the next error is its square
_MOST_PLAIN: Final = 30
_ANGLE: Final = 0.5  # rad a chunk on the way there


def approach(
    inter_rest: InterRestRotations,
    B: Float[Array, "t 3"],
    u: Float[Array, "t n 3"],
    M: Float[Array, "t 3 3"],
) -> tuple[Float[Array, "t 3 3"], Float[Array, "t r 12"], Float[Array, "t r"]]:
    """Coarse first steps towards M, on larger chunks and with the bias of the rests.

    Returns M, and the derivative and the values of the residuals a small step before.
    """
    S, before = inter_rest.statistics[:, :, :3], inter_rest.before
    rows = 2 * len(before)
    greatest = np.sqrt((S * S).sum(axis=2)).max(axis=(1, 2))
    angle = np.maximum(greatest * np.linalg.norm(M, 2, axis=(1, 2)), 1e-300)
    sizes = np.minimum(8, 2 ** np.log2(np.maximum(1.0, _ANGLE / angle)).astype(int))
    M, J, e = np.array(M), np.zeros((len(M), rows, 12)), np.zeros((len(M), rows))
    for size in np.unique(sizes):
        active = np.flatnonzero(sizes == size)
        statistics = merged(inter_rest.statistics[active], size)
        for _ in range(_MOST_PLAIN):
            here, E = u[active], across(u[active][:, before + 1])
            moved = rotations(statistics, M[active], B[active])
            EC = E @ moved.C.mT
            slopes = np.cross(EC, here[:, before, None, :]) @ moved.slopes
            J[active] = slopes.reshape(len(here), -1, 12)
            e[active] = inter_rest_residuals(moved.C, here, E, before)
            # the shortest step where the residuals do not tell it
            back = np.linalg.pinv(J[active][..., :A], rcond=_RANK)
            step = -np.vecdot(back, e[active][:, None]).reshape(-1, 3, 3)
            length = np.linalg.norm(step, axis=(1, 2))
            length /= np.linalg.norm(M[active], axis=(1, 2))
            # a linearisation holds for steps up to a third
            share = np.minimum(1.0, 0.33 / np.maximum(length, 1e-300))
            M[active] += step * share[:, None, None]
            far = length > _NEAR
            active, statistics = active[far], statistics[far]
            if active.size == 0:
                break
    return M, J, e


def influence(
    sensor: Accelerometer, theta: Float[Array, "t 9"], residual: str
) -> Float[Array, "t 9 m"]:
    r"""Change of the accelerometer's parameters by unit noise of each pose and axis.

    Its own fit solves :math:`\sum_i a_i c_i d_i = 0, d = \partial c/\partial\theta`,
    with the weights a of eq. (U1) of `evidence`.
    """
    alone = Problem(sensors=(sensor,))
    _, J, L = alone.rests(alone.corrected(theta), theta)
    d, noise, std = J[:, :, 0], L[:, :, 0], sensor.std
    root = np.ones(d.shape[:2])
    if residual in WEIGHTED:
        shares = noise_shares(residual, np.sqrt((std[0] ** 2).mean(axis=1)))
        weight = 1.0 if shares is None else shares
        root = np.sqrt(weight / ((noise / std) ** 2).sum(axis=-1))
    rows = d * root[..., None]
    size = np.sqrt((rows * rows).sum(axis=1, keepdims=True))
    Q, R = np.linalg.qr(rows / size)
    pull = outer(noise, Q * root[..., None])  # t n 3 9
    flat = pull.reshape(len(root), -1, A).mT
    return -np.linalg.solve(R, flat) / size.mT


def drift(problem: Problem, found: JointSolution, noise: NoiseFactors) -> Drift:
    """Test for a drift of the gyroscope's bias or gain in a joint fit."""
    turns, here = problem.turns, found.here
    assert isinstance(turns, InterRest)
    inter_rest, own, white = turns.inter_rest, here.whole[0], here.white[0]
    M = turns.split(found.theta[:, A:])[0][0]
    middle = inter_rest.middles
    # rows that are no residuals of rotations show no drift
    time = np.full(len(white), middle.mean())
    time[: len(own)] = np.repeat(middle, 2)
    columns = {}
    for a, axis in enumerate("xyz"):
        scaled = own[:, [a, 3 + a, 6 + a]] @ M[:, a]
        for what, column in (("bias", own[:, A + a]), ("gain", scaled)):
            whole = np.pad(column, (0, len(time) - len(column)))
            columns[f"the {what} of {axis}"] = whole
    r, J = (np.linalg.solve(white, x) for x in (here.rows[0], here.slopes[0]))
    return find_drift(r, J, columns, time, known=noise.borne, white=white)
