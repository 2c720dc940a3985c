"""Calibrate a gyroscope from the rotations between rests."""

from typing import Any, Final

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import Array, physical_array
from simval.errors import GeometryError, InputError
from simval.geometry import normalize
from simval.imu.calibrate.equations import Problem, minimize, weighed
from simval.imu.calibrate.factors import NOT_JUDGED
from simval.imu.calibrate.gyroscope.covariance import (
    Given,
    Setting,
    checked_pose_std,
    setting_of,
)
from simval.imu.calibrate.gyroscope.fit import (
    MOST_STEPS,
    A,
    Fitted,
    approach,
    drift,
    first_matrix,
    joint,
    one_way,
    problem_of,
    turns_of,
)
from simval.imu.calibrate.gyroscope.moves import Moves
from simval.imu.calibrate.gyroscope.residuals import across
from simval.imu.calibrate.gyroscope.result import GyroscopeFit
from simval.imu.calibrate.result import FitResult
from simval.shapes import Float
from simval.turns import MATRIX, TurnObservability, best_next_turn, judge, missing

CONDITION_LIMIT: Final = 100.0
"""Greatest condition of the moves. Chosen: five moves in generic directions have about
10, forty 2; moves whose axes lie within a degree of a plane have 60 and more."""
SD_LIMIT: Final = 0.1
"""Greatest standard deviation of any relative error of M. Chosen: an uncalibrated
gyroscope is known to a few percent from its data sheet."""


def relative_rows(
    by_gyroscope: Float[Array, "r 12"], M: Float[Array, "3 3"]
) -> Float[Array, "r 9"]:
    """Rows by D = dM M^-1, from rows by the entries of M."""
    by_matrix = by_gyroscope[:, :MATRIX].reshape(-1, 3, 3)
    return (by_matrix @ M.T).reshape(-1, MATRIX)


def worst_sd(
    covariance: Float[Array, "9 9"], M: Float[Array, "3 3"]
) -> tuple[float, Float[Array, "3 3"]]:
    """Greatest standard deviation of a relative error D of length 1, and that error."""
    to_relative = np.kron(np.eye(3), np.linalg.inv(M).T)
    values, vectors = np.linalg.eigh(to_relative @ covariance @ to_relative.T)
    return float(np.sqrt(values[-1])), vectors[:, -1].reshape(3, 3)


def require_told(
    rows: Float[Array, "r 9"], u: Float[Array, "n 3"], sd: float | None = None
) -> TurnObservability:
    """Require moves that tell the nine entries of M.

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
        f"the {len(u) - 1} moves {fault}: they do not tell {missing(found)}; "
        f"from the last rest turn by {np.degrees(angle):.0f} degrees about the axis "
        f"({named}) of the sensor and rest again, and so on with other axes"
    )
    raise GeometryError(msg)


def degrees_of_freedom(moves: Moves, setting: Setting) -> int:
    """Rows less parameters."""
    k = moves.statistics.shape[1]
    norms = k + 1 - A if setting.joint else 0
    return 2 * k + norms - 9


def empty(t: int, moves: Moves, condition: Array) -> dict[str, Any]:
    """Numbers of trials that are not fitted yet."""
    k = moves.statistics.shape[1]
    shapes: dict[str, tuple[int, ...]] = {
        "parameters": (12,), "accelerometer": (9,), "covariance": (21, 21),
        "gap_angles": (k,), "chi2_per_dof": (), "step": (),
    }  # fmt: skip
    made: dict[str, Any] = {k: np.full((t, *v), np.nan) for k, v in shapes.items()}
    made["status"] = np.full(t, "converged", dtype=object)
    made["iterations"] = np.zeros(t, int)
    made["condition"] = condition
    return made


def write(result: dict[str, Any], good: Any, found: Fitted, problem: Problem) -> None:
    """Write the numbers of fitted trials among them."""
    turns, theta = turns_of(problem), found.theta
    M, B = turns.split(theta[:, A:])
    result["parameters"][good] = np.concatenate(
        [M.reshape(-1, 9), B + turns.moves.centre], axis=1
    )
    result["accelerometer"][good] = theta[:, :A]
    result["covariance"][good] = found.covariance
    at = problem.corrected(theta[:, :A])
    result["gap_angles"][good] = turns.angles(at, theta[:, A:])
    dof = degrees_of_freedom(turns.moves, turns.setting)
    result["chi2_per_dof"][good] = found.chi2 / dof if dof > 0 else np.nan
    result["step"][good] = found.step
    result["status"][good] = np.where(found.converged, "converged", "max iterations")
    result["iterations"][good] = found.iterations


ESTIMATORS: Final = ("joint", "generalised", "unweighted")
_FAR: Final = 0.05
"""rad, rms of the rows, beyond which the moves lead somewhere else. Chosen: recordings
by hand leave 0.01, columns of another log 0.1 and more."""


def calibrate_gyroscope(
    moves: Moves,
    poses: Any,
    accelerometer: FitResult,
    *,
    pose_std: Any,
    angle_random_walk: Any = None,
    bias_random_walk: float = 0.0,
    clock_jitter: float = 0.0,
    estimator: str = "joint",
    bias: str = "constant",
    known_bias: Any = None,
    bias_std: Any = None,
    start: Any = None,
) -> GyroscopeFit:
    """Fit M and B of a gyroscope to the moves between rests, one log or a batch.

    Parameters
    ----------
    moves : Moves
        Path statistics, see `moves_between`.
    poses : array_like
        Mean accelerometer reading of each rest, raw units, (n, 3) or (trials, n, 3).
    accelerometer : FitResult
        The accelerometer's calibration from the same rests.
    pose_std : float or array_like
        Noise of each axis of a pose mean, raw units: one number, (n,) or (n, 3).
    angle_random_walk : float or array_like, optional
        White noise N of the gyroscope, raw units per root hertz, one number or (3,);
        from the scatter within rests if not given.
    bias_random_walk : float, default 0.0
        K, raw units times root hertz.
    clock_jitter : float, default 0.0
        Standard deviation of each time stamp, s, where the rows are even and their
        stamps are not.
    estimator : {"joint", "generalised", "unweighted"}
        joint fits the accelerometer again, together with the gyroscope; generalised
        keeps it, and counts its errors; unweighted is IMU-TK's least squares.
    bias : {"constant", "first rest", "line"}
        constant is estimated, from the rests and the moves (unweighted: from the rests
        alone); first rest is the mean of that and kept (IMU-TK); line is what `moves`
        has taken out already.
    known_bias : array_like, optional
        Raw units, (3,): kept instead of the mean of the first rest.
    bias_std : float or array_like, optional
        How well the rests tell the bias, raw units, one number or (3,); by their white
        noise if not given.
    start : array_like, optional
        M to start from, (3, 3); found by itself if not given.

    Returns
    -------
    GyroscopeFit
        Parameters, covariance and status; the accelerometer's of a joint fit too.

    Raises
    ------
    InputError
        If an argument is not usable.
    GeometryError
        If the moves of one log do not tell the parameters. In a batch such a trial has
        a status that says so, and NaN for its numbers.
    RefusedError
        If the residuals of one log are far beyond the noise of a sensor.

    Notes
    -----
    IMU-TK's calibration is ``estimator="unweighted", bias="first rest"`` on moves of
    ``scheme="linear"``. The covariance is that of the stated noise, for each estimator
    its own (`simval.imu.calibrate.gyroscope.fit`); where the residuals of one log do
    not bear that, a joint fit takes what they show (`simval.imu.calibrate.factors`).
    """
    instance("moves", moves, Moves)
    instance("accelerometer", accelerometer, FitResult)
    readings, theta = _readings(moves, poses, accelerometer)
    given = Given(
        pose_std=pose_std, angle_random_walk=angle_random_walk,
        bias_random_walk=bias_random_walk, bias=bias, known_bias=known_bias,
        bias_std=bias_std, clock_jitter=clock_jitter,
    )  # fmt: skip
    estimator = choice("estimator", estimator, ESTIMATORS)
    setting = setting_of(
        moves, readings, given, model=accelerometer.model,
        residual=accelerometer.residual, g=accelerometer.g, estimator=estimator,
    )  # fmt: skip
    problem = problem_of(moves, readings, setting)
    u = normalize(problem.corrected(theta)["accelerometer"].w)
    M = _start(moves, u, start)
    M, J, e = approach(moves, setting, u, M)
    refusals, condition = _judged(u, M, J, e)
    single = np.ndim(poses) == 2
    if single and refusals[0]:
        raise GeometryError(refusals[0])
    good = np.array([not text for text in refusals])
    result = empty(len(M), moves, condition)
    noise, follows = NOT_JUDGED, None
    if good.any():
        problem = problem if good.all() else problem.take(good)
        own = setting.bias_value[good, : setting.free - A]
        begin = np.concatenate([theta[good], M[good].reshape(-1, A), own], axis=1)
        if setting.joint:
            solution = minimize(problem, begin, MOST_STEPS)
            here = problem.local(solution.theta)
            # a noise of zero, or below rounding, is no statement
            stated = setting.noise.pose_std == checked_pose_std(
                pose_std, readings.shape[1]
            )
            if single and stated.all():
                problem, solution, here, noise = weighed(
                    problem, solution, here, MOST_STEPS
                )
                follows = drift(problem, solution, here, noise)
            found = joint(problem, solution, here)
        else:
            found = one_way(problem, begin)
        write(result, good, found, problem)
    result["status"] = np.where(
        good, result["status"], [f"refused: {text}" for text in refusals]
    )
    if single:
        M = found.theta[0, A : 2 * A].reshape(3, 3)
        sd, _ = worst_sd(found.covariance[0, A : 2 * A, A : 2 * A], M)
        require_told(relative_rows(found.turned[0], M), u[0], sd)
        result = {name: value[0] for name, value in result.items()}
    return GyroscopeFit(
        model=setting.model,
        estimator=estimator,
        bias=bias,
        dof=degrees_of_freedom(moves, setting),
        noise=noise,
        drift=follows,
        **result,
    )


def _readings(
    moves: Moves, poses: Any, accelerometer: FitResult
) -> tuple[Float[Array, "t n 3"], Float[Array, "t 9"]]:
    readings = physical_array("poses", poses, (None, 3))
    readings = readings[None] if readings.ndim == 2 else readings
    theta = np.atleast_2d(accelerometer.parameters)
    trials, rests = moves.rest_rates.shape[:2]
    fits = readings.shape[:2] == (trials, rests) and theta.shape == (trials, A)
    if not fits or rests < 3:
        msg = (
            f"`moves` has {trials} trial(s) of {rests} rests, `poses` the shape "
            f"{readings.shape} and the accelerometer {len(theta)} fit(s); give one "
            "pose for each rest, three rests or more, and one fit for each trial"
        )
        raise InputError(msg)
    if not np.isfinite(theta).all():
        msg = (
            "the accelerometer has not been calibrated in every trial; leave those out"
        )
        raise InputError(msg)
    return readings, theta


def _start(moves: Moves, u: Float[Array, "t n 3"], start: Any) -> Float[Array, "t 3 3"]:
    if start is not None:
        given = physical_array("start", start, (3, 3))
        return np.broadcast_to(given, (len(u), 3, 3))
    E = across(u[:, 1:])
    found = [first_matrix(moves.statistics[i], u[i], E[i]) for i in range(len(u))]
    if not np.isfinite(found).all():
        msg = "the gyroscope reads nothing between the rests; check its columns"
        raise InputError(msg)
    return np.array(found)


def _judged(
    u: Float[Array, "t n 3"],
    M: Float[Array, "t 3 3"],
    J: Float[Array, "t r 12"],
    e: Float[Array, "t r"],
) -> tuple[list[str], Float[Array, " t"]]:
    # why a trial is refused, empty where it is not, and the condition of its moves
    off = np.sqrt((e * e).mean(axis=1))
    said, condition = [], np.full(len(u), np.inf)
    for i, each in enumerate(J):
        try:
            condition[i] = require_told(relative_rows(each, M[i]), u[i]).condition
            said.append("")
        except GeometryError as refusal:
            said.append(str(refusal))
        if not said[-1] and not off[i] <= _FAR:
            said[-1] = (
                f"the moves end {off[i]:.2g} rad (rms) from where gravity is, whatever "
                "the scale and the order of the axes; look at the time of both "
                "sensors, at saturation, and whether the columns are what they are "
                "taken for"
            )
    return said, condition
