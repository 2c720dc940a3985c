"""The numbers of a batch of fits of three sensors, refused trials among them."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from simval.calibrate.factors import NoiseFactors
from simval.calibrate.gyroscope.result import GyroscopeFit
from simval.calibrate.magnetometer.equations import DIP, PARAMETERS
from simval.calibrate.magnetometer.result import MagnetometerFit
from simval.calibrate.magnetometer.scaling import Scaled
from simval.calibrate.magnetometer.summary import natural_sd
from simval.calibrate.nine_axis.result import NineAxisFit
from simval.calibrate.nine_axis.rows import Problem
from simval.calibrate.nine_axis.solve import Solved

COUNT: Final = 34
_NORMAL_95: Final = 1.959964
_ORDER = np.r_[0:9, 22:34, 9:22]
"""Accelerometer, gyroscope, magnetometer; the fit has the gyroscope last."""


def empty(
    good: Any, gyroscope: GyroscopeFit, magnetometer: MagnetometerFit
) -> dict[str, Any]:
    """Numbers of trials that are not fitted yet."""
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


def write(
    result: dict[str, Any], good: Any, found: Solved, problem: Problem, scaled: Scaled
) -> None:
    """Write the numbers of fitted trials among them, in their own units."""
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


def result_of(
    result: dict[str, Any],
    gyroscope: GyroscopeFit,
    magnetometer: MagnetometerFit,
    dof: int,
    noise: NoiseFactors,
) -> NineAxisFit:
    """Return all trials, or the one of a recording, with each sensor's own part."""
    if gyroscope.parameters.ndim == 1:
        result = {name: value[0] for name, value in result.items()}
    parameters, covariance = result["parameters"], result["covariance"]
    ratio = result["chi2"] / dof if dof > 0 else result["chi2"] * np.nan
    poses = np.r_[0:9, 21:34]  # accelerometer and magnetometer
    shared = {key: result[key] for key in ("status", "iterations")} | {"noise": noise}
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
