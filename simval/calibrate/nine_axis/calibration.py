"""Calibrate accelerometer, gyroscope and magnetometer of the same rests in one fit."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from simval.arguments import instance
from simval.arrays import Array, physical_array
from simval.calibrate.gyroscope.moves import Moves, taken
from simval.calibrate.gyroscope.noise import checked_pose_std
from simval.calibrate.gyroscope.result import GyroscopeFit
from simval.calibrate.gyroscope.setting import Given, Setting, setting_of
from simval.calibrate.magnetometer.arguments import Options
from simval.calibrate.magnetometer.equations import (
    ACCELEROMETER,
    DIP,
    PARAMETERS,
)
from simval.calibrate.magnetometer.result import MagnetometerFit
from simval.calibrate.magnetometer.scaling import Scaled, scale
from simval.calibrate.magnetometer.summary import natural_sd
from simval.calibrate.nine_axis.result import NineAxisFit
from simval.calibrate.nine_axis.rows import EACH, Problem, State
from simval.calibrate.nine_axis.solve import Solved, solve
from simval.errors import InputError
from simval.shapes import Float

COUNT: Final = 34
_FLOOR: Final = 1e-11  # of the readings' own size, as for the other noises
_NORMAL_95: Final = 1.959964
_ORDER = np.r_[0:9, 22:34, 9:22]
"""Accelerometer, gyroscope, magnetometer; the fit has the gyroscope last."""


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
    result = _empty(good, gyroscope, magnetometer)
    if good.any():
        part = moves if good.all() else taken(moves, good)
        chosen = replace(setting, bias_value=setting.bias_value[good])
        scaled = _scaled((pair[0][good], pair[1][good]), noise, magnetometer)
        problem = _problem(part, chosen, scaled, noise)
        found = solve(problem, _start(part, scaled, gyroscope, magnetometer, good))
        _write(result, good, found, problem, scaled)
    return _result(result, gyroscope, magnetometer, 2 * EACH * count - COUNT)


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


def _empty(
    good: Any, gyroscope: GyroscopeFit, magnetometer: MagnetometerFit
) -> dict[str, Any]:
    t = len(good)
    made: dict[str, Any] = {
        "parameters": np.full((t, COUNT), np.nan),
        "covariance": np.full((t, COUNT, COUNT), np.nan),
        "gap_angles": np.full((t, gyroscope.gap_angles.shape[-1]), np.nan),
    }
    made |= {name: np.full(t, np.nan) for name in ("chi2", "half_width", "step")}
    made["iterations"] = np.zeros(t, int)
    said = np.where(
        np.atleast_1d(gyroscope.converged),
        np.atleast_1d(magnetometer.status),
        np.atleast_1d(gyroscope.status),
    )
    made["status"] = said.astype(object)
    return made


def _write(
    result: dict[str, Any], good: Any, found: Solved, problem: Problem, scaled: Scaled
) -> None:
    # the numbers of the fitted trials, in their own units
    state, linear = found.state, found.linear
    t = len(state.M)
    own = linear.gain.covariance
    whole = np.zeros((t, COUNT, COUNT))
    free = own.shape[1]
    whole[:, :free, :free] = own
    if free < COUNT:
        last = np.arange(free, COUNT)
        whole[:, last, last] = problem.setting.bias_std**2
    inner = whole[:, :PARAMETERS, :PARAMETERS]
    natural = natural_sd(problem.setting.model, state.poses, linear.at, inner)
    values, _ = scaled.physical(state.poses, inner)
    slope = np.ones((t, COUNT))
    slope[:, :PARAMETERS] = scaled.sizes
    slope[:, DIP] = 1.0 / np.cos(values[:, DIP])
    whole *= slope[:, :, None] * slope[:, None, :]
    parameters = np.concatenate(
        [values, state.M.reshape(t, 9), state.B + problem.moves.centre], axis=1
    )
    result["parameters"][good] = parameters[:, _ORDER]
    result["covariance"][good] = whole[:, _ORDER[:, None], _ORDER]
    result["half_width"][good] = _NORMAL_95 * natural.max(axis=1)
    turned = (linear.u[:, :-1, None] @ linear.C)[:, :, 0]
    sine = np.linalg.norm(np.cross(turned, linear.u[:, 1:]), axis=-1)
    result["gap_angles"][good] = np.arcsin(np.minimum(sine, 1.0))
    result["chi2"][good] = found.chi2
    result["step"][good] = found.step
    result["iterations"][good] = found.iterations
    result["status"][good] = np.where(found.converged, "converged", "max iterations")


def _result(
    result: dict[str, Any],
    gyroscope: GyroscopeFit,
    magnetometer: MagnetometerFit,
    dof: int,
) -> NineAxisFit:
    if gyroscope.parameters.ndim == 1:
        result = {name: value[0] for name, value in result.items()}
    parameters, covariance = result["parameters"], result["covariance"]
    ratio = result["chi2"] / dof if dof > 0 else result["chi2"] * np.nan
    poses = np.r_[0:9, 21:34]  # accelerometer and magnetometer
    shared = {key: result[key] for key in ("status", "iterations")}
    return NineAxisFit(
        parameters=parameters,
        covariance=covariance,
        dof=dof,
        chi2_per_dof=ratio,
        step=result["step"],
        gyroscope=replace(
            gyroscope,
            parameters=parameters[..., 9:21],
            accelerometer=parameters[..., :9],
            covariance=covariance[..., :21, :21],
            dof=dof,
            chi2_per_dof=ratio,
            gap_angles=result["gap_angles"],
            step=result["step"],
            **shared,
        ),
        magnetometer=replace(
            magnetometer,
            parameters=parameters[..., poses],
            covariance=covariance[..., poses[:, None], poses],
            half_width=result["half_width"],
            **shared,
        ),
        **shared,
    )
