"""Calibrate accelerometer, gyroscope and magnetometer of the same rests in one fit."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from simval.arguments import instance
from simval.arrays import Array, physical_array
from simval.calibrate.factors import NOT_JUDGED, NoiseFactors, judged
from simval.calibrate.gyroscope.moves import Moves, taken
from simval.calibrate.gyroscope.noise import checked_pose_std
from simval.calibrate.gyroscope.result import GyroscopeFit
from simval.calibrate.gyroscope.setting import Given, Setting, setting_of
from simval.calibrate.magnetometer.arguments import Options
from simval.calibrate.magnetometer.equations import (
    ACCELEROMETER,
    DIP,
)
from simval.calibrate.magnetometer.result import MagnetometerFit
from simval.calibrate.magnetometer.scaling import Scaled, scale
from simval.calibrate.nine_axis.outcome import COUNT, empty, result_of, write
from simval.calibrate.nine_axis.result import NineAxisFit
from simval.calibrate.nine_axis.rows import EACH, Problem, State, residuals
from simval.calibrate.nine_axis.solve import Solved, solve
from simval.errors import InputError, RefusedError
from simval.shapes import Float

_FLOOR: Final = 1e-11  # of the readings' own size, as for the other noises


def calibrate_nine_axis(
    moves: Moves,
    poses: Any,
    fields: Any,
    gyroscope: GyroscopeFit,
    magnetometer: MagnetometerFit,
    *,
    pose_std: Any,
    field_std: Any,
    angle_random_walk: Any = None,
    bias_random_walk: float = 0.0,
    known_bias: Any = None,
    bias_std: Any = None,
) -> NineAxisFit:
    """Fit three sensors to the same rests and the moves between them.

    All 34 parameters in one generalised least-squares fit of three equations a pose and
    three a move, from the fits of two sensors each.

    Parameters
    ----------
    moves : Moves
        Path statistics, see `moves_between`.
    poses, fields : array_like
        Mean reading of the accelerometer and of the magnetometer in each rest, raw
        units, (n, 3) or (trials, n, 3).
    gyroscope : GyroscopeFit
        Of the same moves and poses, ``estimator="joint"``; its model of the bias is
        kept.
    magnetometer : MagnetometerFit
        Of the same poses, in the same form of the accelerometer.
    pose_std, field_std : float or array_like
        Noise of each axis of a pose mean of either sensor, raw units: one number, (n,)
        or (n, 3).
    angle_random_walk : float or array_like, optional
        As in `calibrate_gyroscope`, as are the following.
    bias_random_walk : float, default 0.0
        K, raw units times root hertz.
    known_bias : array_like, optional
        Raw units, (3,): where the gyroscope's bias was kept.
    bias_std : float or array_like, optional
        How well the rests tell the bias, raw units.

    Returns
    -------
    NineAxisFit
        Parameters, covariance and status.

    Raises
    ------
    InputError
        If an argument is not usable, or the fits are not of the same recordings.
    RefusedError
        If the residuals of one recording are far beyond the noise of a sensor.
    """
    instance("moves", moves, Moves)
    instance("gyroscope", gyroscope, GyroscopeFit)
    instance("magnetometer", magnetometer, MagnetometerFit)
    pair = _pair(moves, poses, fields)
    _require_alike(gyroscope, magnetometer, len(pair[0]))
    count = pair[0].shape[1]
    noise = checked_pose_std(pose_std, count), checked_field_std(field_std, count)
    given = Given(
        pose_std=pose_std, angle_random_walk=angle_random_walk,
        bias_random_walk=bias_random_walk, bias=gyroscope.bias,
        known_bias=known_bias, bias_std=bias_std,
    )  # fmt: skip
    setting = setting_of(
        moves, pair[0], given, model=gyroscope.model, residual="weighted", g=1.0,
        estimator="joint",
    )  # fmt: skip
    good = _usable(gyroscope, magnetometer)
    result = empty(good, gyroscope, magnetometer)
    told = NOT_JUDGED
    if good.any():
        part = moves if good.all() else taken(moves, good)
        chosen = replace(setting, bias_value=setting.bias_value[good])
        scaled = _scaled((pair[0][good], pair[1][good]), noise, magnetometer)
        problem = _problem(part, chosen, scaled, noise)
        found = solve(problem, _start(part, scaled, gyroscope, magnetometer, good))
        write(result, good, found, problem, scaled)
        if gyroscope.parameters.ndim == 1 and all(np.all(std > 0.0) for std in noise):
            found, told = _weighed(problem, found)
            write(result, good, found, problem.noisier(*told.factor), scaled)
    dof = 2 * EACH * count - COUNT
    return result_of(result, gyroscope, magnetometer, dof, told)


def _weighed(problem: Problem, stated: Solved) -> tuple[Solved, NoiseFactors]:
    # by the noise that the residuals ask for, where it is more than stated
    found, noise = judged(
        stated,
        lambda last, factor: solve(problem.noisier(*factor), last.state),
        lambda last: residuals(last.linear),
    )
    if not found.converged[0]:  # residuals of no solution
        return stated, NOT_JUDGED
    if noise.refusal:
        raise RefusedError(noise.refusal)
    return found, noise


def checked_field_std(value: Any, count: int) -> Float[Array, "n 3"]:
    """Require the noise of the magnetometer's pose means.

    Raises
    ------
    InputError
        If the shape is another, or one is negative.
    """
    try:
        return checked_pose_std(value, count)
    except InputError as error:
        raise InputError(str(error).replace("`pose_std`", "`field_std`")) from None


def _pair(moves: Moves, poses: Any, fields: Any) -> tuple[Array, Array]:
    named = {"poses": poses, "fields": fields}
    pair = [physical_array(name, value, (None, 3)) for name, value in named.items()]
    pair = [each[None] if each.ndim == 2 else each for each in pair]
    shape = moves.rest_rates.shape
    if not pair[0].shape == pair[1].shape == shape:
        msg = (
            f"`moves` has {shape[0]} trial(s) of {shape[1]} rests, `poses` the shape "
            f"{pair[0].shape} and `fields` {pair[1].shape}; give the mean of both "
            "sensors in each rest"
        )
        raise InputError(msg)
    return pair[0], pair[1]


def _require_alike(
    gyroscope: GyroscopeFit, magnetometer: MagnetometerFit, trials: int
) -> None:
    sizes = [
        np.atleast_2d(fit.parameters).shape[0] for fit in (gyroscope, magnetometer)
    ]
    alike = gyroscope.model == magnetometer.model and sizes == [trials, trials]
    if gyroscope.estimator == "joint" and alike:
        return
    msg = (
        f"`gyroscope` holds {sizes[0]} fit(s) ({gyroscope.estimator}, form "
        f"{gyroscope.model}) and `magnetometer` {sizes[1]} (form {magnetometer.model}) "
        f"for {trials} trial(s); give a fit of each for each trial, in the same form, "
        'and the gyroscope\'s with estimator="joint"'
    )
    raise InputError(msg)


def _usable(gyroscope: GyroscopeFit, magnetometer: MagnetometerFit) -> Any:
    parts = [gyroscope.accelerometer, gyroscope.parameters, magnetometer.parameters]
    finite = [np.isfinite(np.atleast_2d(each)).all(axis=1) for each in parts]
    return np.logical_and.reduce(finite)


def _scaled(
    pair: tuple[Array, Array],
    noise: tuple[Array, Array],
    magnetometer: MagnetometerFit,
) -> Scaled:
    options = Options(
        g=magnetometer.g, field=magnetometer.field, model=magnetometer.model,
        hemisphere="unstated", max_iterations=1, known=None,
    )  # fmt: skip
    level = [np.sqrt((std**2).mean(axis=1)) for std in noise]
    return scale(pair, (level[0], level[1]), slice(None), options)


def _problem(
    moves: Moves, setting: Setting, scaled: Scaled, noise: tuple[Array, Array]
) -> Problem:
    units = scaled.sizes[:, 6, None, None], scaled.sizes[:, 18, None, None]
    stds = [
        # the readings are of unit size here
        np.maximum(std / unit, _FLOOR)
        for std, unit in zip(noise, units, strict=True)
    ]
    return Problem(
        moves=moves,
        setting=setting,
        readings=scaled.readings,
        accelerometer_std=stds[0],
        magnetometer_std=stds[1],
    )


def _start(
    moves: Moves,
    scaled: Scaled,
    gyroscope: GyroscopeFit,
    magnetometer: MagnetometerFit,
    good: Any,
) -> State:
    values = np.atleast_2d(magnetometer.parameters)[good]
    values[:, ACCELEROMETER] = np.atleast_2d(gyroscope.accelerometer)[good]
    values[:, DIP] = np.sin(values[:, DIP])
    own = np.atleast_2d(gyroscope.parameters)[good]
    return State(
        poses=(values - scaled.shifts) / scaled.sizes,
        M=own[:, :9].reshape(-1, 3, 3),
        B=own[:, 9:] - moves.centre,
    )
