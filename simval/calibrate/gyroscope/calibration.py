"""Calibrate a gyroscope from the moves between rests."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import Array, physical_array
from simval.calibrate.factors import NOT_JUDGED, NoiseFactors, judged
from simval.calibrate.gyroscope.fit import A, Fitted, approach, drift, ended, residuals
from simval.calibrate.gyroscope.gravity import across, directions
from simval.calibrate.gyroscope.moves import Moves, taken
from simval.calibrate.gyroscope.noise import checked_pose_std
from simval.calibrate.gyroscope.outcome import degrees_of_freedom, empty, write
from simval.calibrate.gyroscope.refusal import relative_rows, require_told, worst_sd
from simval.calibrate.gyroscope.result import GyroscopeFit
from simval.calibrate.gyroscope.setting import Given, Setting, setting_of
from simval.calibrate.gyroscope.start import first_matrix
from simval.calibrate.result import FitResult
from simval.errors import GeometryError, InputError, RefusedError
from simval.shapes import Float

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
    its own (`simval.calibrate.gyroscope.solve`); where the residuals of one log do not
    bear that, a joint fit takes what they show (`simval.calibrate.factors`).
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
    u, _ = directions(setting.model, theta, readings, setting.g)
    M = _start(moves, u, start)
    M, J, e = approach(moves, setting, u, M)
    refusals, condition = _judged(u, M, J, e)
    single = np.ndim(poses) == 2
    if single and refusals[0]:
        raise GeometryError(refusals[0])
    good = np.array([not text for text in refusals])
    result = empty(len(M), moves, setting, estimator, condition)
    trials = np.flatnonzero(good)
    part = moves if good.all() else taken(moves, good)
    chosen = replace(setting, bias_value=setting.bias_value[good])
    start = theta[good], M[good], chosen.bias_value
    for at, found in ended(part, readings[good], chosen, start):
        here = trials[at]
        write(result, here, found, taken(moves, here), chosen)
    result["status"] = np.where(
        good, result["status"], [f"refused: {text}" for text in refusals]
    )
    noise, follows = NOT_JUDGED, None
    # a noise of zero, or below rounding, is no statement
    stated = setting.noise.pose_std == checked_pose_std(pose_std, readings.shape[1])
    if single and setting.joint and stated.all():
        found, noise = _weighed(moves, readings, setting, found)
        write(result, trials, found, moves, setting.noisier(*noise.factor))
        follows = drift(found, moves, noise)
    if single:
        sd, _ = worst_sd(result["covariance"][0, A : 2 * A, A : 2 * A], found.M[0])
        rows = relative_rows(found.linear.by_gyroscope[0], found.M[0])
        require_told(rows, u[0], sd)
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


def _weighed(
    moves: Moves, readings: Float[Array, "1 n 3"], setting: Setting, found: Fitted
) -> tuple[Fitted, NoiseFactors]:
    # by the noise that the residuals ask for, where it is more than stated
    def fit(last: Fitted, factor: Any) -> Fitted:
        start = last.theta, last.M, last.B
        *_, (_, found) = ended(moves, readings, setting.noisier(*factor), start)
        return found

    found, noise = judged(found, fit, residuals)
    if noise.refusal:
        raise RefusedError(noise.refusal)
    return found, noise


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
