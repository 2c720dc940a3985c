r"""Joint calibration of accelerometer, gyroscope and magnetometer from the same rests.

**The rows of three sensors that an unknown attitude leaves, and their noise.**

A pose gives six readings and a rotation three angles; the attitudes of n rests take 3n
of these 6n + 3(n - 1) away. What is left are the three equations of each pose, (M1) of
`theory.magnetometer`, and three inter-rest residuals of each rotation. Two are those of
gravity (N5). The third turns the field v_k of one pose into the next and looks along
the horizontal direction across it,

.. math:: e_{k3} = a_{k+1}^T (C_k^T v_k - v_{k+1}), \qquad
   a = \frac{u \times v}{|u \times v|}, \tag{J1}

so a gyroscope tells the headings of all poses to one, and a magnetometer is compared
with itself. All are functions of the same pose means: with L the map from the unit
noises of six axes a pose to the rows, their covariance is :math:`LL^T` and what the
rotations add (`gyroscope.residuals`), so that a pose is counted once.

The readings of both vectors are in the scaled units of the magnetometer's fit; the 34
parameters stand in the order: nine of the accelerometer, the rows of :math:`M_m`,
:math:`b_m`, s, and then the rows of the gyroscope's M, and B.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from simval.arguments import instance
from simval.arrays import Array, physical_array
from simval.errors import InputError
from simval.imu.calibrate.equations import Problem
from simval.imu.calibrate.estimate import Estimate
from simval.imu.calibrate.factors import NOT_JUDGED, NoiseFactors
from simval.imu.calibrate.gauss_newton import JointSolution, minimize, weighed
from simval.imu.calibrate.gyroscope.noise import checked_pose_std, noise_of
from simval.imu.calibrate.gyroscope.path_statistics import InterRestRotations
from simval.imu.calibrate.gyroscope.residuals import InterRest
from simval.imu.calibrate.gyroscope.result import NAMES, GyroscopeFit
from simval.imu.calibrate.magnetometer.calibration import CompassOptions, Scaled, scale
from simval.imu.calibrate.magnetometer.covariance import natural_sd
from simval.imu.calibrate.magnetometer.result import (
    ACCELEROMETER,
    DIP,
    OWN_NAMES,
    PARAMETERS,
    MagnetometerFit,
)
from simval.imu.calibrate.values import NORMAL_95, nine_axis_account
from simval.imu.sensor import forms
from simval.shapes import Float

GYROSCOPE, MAGNETOMETER = slice(9, 21), slice(21, 34)
"""Indices of the parameters of the sensors other than the accelerometer."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NineAxisFit(Estimate):
    """Accelerometer, gyroscope and magnetometer in one fit, one recording or a batch.

    The 34 parameters, the dip in rad, have a covariance with the stated noises; see
    `Estimate`.

    Attributes
    ----------
    chi2_per_dof : Array
        Weighted sum of squares of all rows by degree of freedom, (...).
    step : Array
        The last step, over its standard deviation, (...).
    noise : NoiseFactors
        By how much the noise of each sensor was taken to exceed what was stated, with
        which covariance and chi-square are; empty for a batch.
    gyroscope : GyroscopeFit
        The gyroscope with the numbers of this fit; its `dof` and `chi2_per_dof` are
        those of all rows.
    magnetometer : MagnetometerFit
        The magnetometer with the parameters and the covariance of this fit. What is
        said of single poses, `chi_square`, `dof`, `pose_chi_square`, `disturbed` and
        `findings`, is of the fit with the accelerometer alone.
    """

    what: ClassVar[str] = "three sensors"
    states: ClassVar[Any] = staticmethod(nine_axis_account)
    advice: ClassVar[str] = (
        "the fits of two sensors disagree by more than their noise; look for rests "
        "that moved, a disturbed field and the noise that is stated"
    )

    chi2_per_dof: Float[Array, "..."]
    step: Float[Array, "..."]
    noise: NoiseFactors
    gyroscope: GyroscopeFit
    magnetometer: MagnetometerFit

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 34: the accelerometer's, then with gyro and mag before them."""
        others = (
            (f"gyro_{name}" for name in NAMES),
            (f"mag_{name}" for name in OWN_NAMES),
        )
        return (*forms.names(self.gyroscope.model), *others[0], *others[1])

    def with_covariance(self, covariance: Float[Array, "34 34"]) -> "NineAxisFit":
        """Return the same fit, and each sensor's part, with another covariance.

        Parameters
        ----------
        covariance : Array
            Of all parameters, (34, 34).

        Returns
        -------
        NineAxisFit
            The fit.
        """
        poses = np.r_[ACCELEROMETER, MAGNETOMETER]
        compass = covariance[np.ix_(poses, poses)]
        return replace(
            self,
            covariance=covariance,
            gyroscope=replace(self.gyroscope, covariance=covariance[:21, :21]),
            magnetometer=replace(self.magnetometer, covariance=compass),
        )

    def as_object(self) -> dict[str, Any]:
        """Return what the sensors' own objects do not hold, as JSON can hold it.

        Returns
        -------
        dict
            Names, covariance of all parameters, chi-square and status of one fit.
        """
        return {
            "names": list(self.names),
            "covariance": self.covariance.tolist(),
            "dof": self.dof,
            "chi2_per_dof": float(self.chi2_per_dof),
            "status": str(self.status),
            "iterations": int(self.iterations),
        }


EACH = 3  # equations of a pose, and residuals of a rotation
COUNT: Final = 34
MOST_STEPS: Final = 30
_ORDER = np.r_[0:9, 22:34, 9:22]
"""Accelerometer, gyroscope, magnetometer; the fit has the gyroscope last."""


def _numbers(
    problem: Problem, found: JointSolution, scaled: Scaled
) -> dict[str, Array]:
    # of the fit of each trial, in their own units
    turns, theta, t, here = problem.turns, found.theta, len(found.theta), found.here
    assert isinstance(turns, InterRest)
    whole = np.zeros((t, COUNT, COUNT))
    free = theta.shape[1]
    whole[:, :free, :free] = here.covariance()[0]
    last = np.arange(free, COUNT)
    whole[:, last, last] = turns.noise.bias_std[: len(last)] ** 2
    poses, (M, B) = theta[:, :PARAMETERS], turns.split(theta[:, PARAMETERS:])
    inner = whole[:, :PARAMETERS, :PARAMETERS]
    natural = natural_sd(problem.accelerometer.model, poses, here.at, inner)
    values, _ = scaled.physical(poses, inner)
    slope = np.ones((t, COUNT))
    slope[:, :PARAMETERS] = scaled.sizes
    slope[:, DIP] = 1.0 / np.cos(values[:, DIP])
    whole *= slope[:, :, None] * slope[:, None, :]
    parameters = np.concatenate(
        [values, M.reshape(t, 9), B + turns.inter_rest.centre], axis=1
    )
    return {
        "parameters": parameters[:, _ORDER],
        "covariance": whole[:, _ORDER[:, None], _ORDER],
        "half_width": NORMAL_95 * natural.max(axis=1),
        "residual_angles": turns.angles(here.at, theta[:, PARAMETERS:]),
        "chi2": np.array(here.chi_square),
        "step": np.array(found.step),
    }


def _result(
    result: dict[str, Any],
    gyroscope: GyroscopeFit,
    magnetometer: MagnetometerFit,
    dof: int,
    noise: NoiseFactors,
) -> NineAxisFit:
    # all trials, or the one of a recording, with each sensor's own part
    if gyroscope.parameters.ndim == 1:
        result = {name: value[0] for name, value in result.items()}
    parameters, covariance = result["parameters"], result["covariance"]
    poses = np.r_[ACCELEROMETER, MAGNETOMETER]
    shared = {key: result[key] for key in ("status", "iterations")} | {"noise": noise}
    both: dict[str, Any] = shared | {
        "dof": dof,
        "chi2_per_dof": result["chi2"] / (dof if dof > 0 else np.nan),
        "step": result["step"],
    }
    return NineAxisFit(
        parameters=parameters,
        covariance=covariance,
        gyroscope=replace(
            gyroscope,
            parameters=parameters[..., GYROSCOPE],
            accelerometer=parameters[..., ACCELEROMETER],
            covariance=covariance[..., :21, :21],
            residual_angles=result["residual_angles"],
            **both,
        ),
        magnetometer=replace(
            magnetometer,
            parameters=parameters[..., poses],
            covariance=covariance[..., poses[:, None], poses],
            half_width=result["half_width"],
            **shared,
        ),
        **both,
    )


_FLOOR: Final = 1e-11  # of the readings' own size, as for the other noises


def calibrate_nine_axis(
    inter_rest: InterRestRotations,
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
    """Fit three sensors to the same rests and the rotations between them.

    All 34 parameters in one generalised least-squares fit of three equations a pose and
    three a rotation, from the fits of two sensors each.

    Parameters
    ----------
    inter_rest : InterRestRotations
        Path statistics, see `inter_rest_rotations`.
    poses, fields : array_like
        Mean reading of the accelerometer and of the magnetometer in each rest, raw
        units, (n, 3) or (trials, n, 3).
    gyroscope : GyroscopeFit
        Of the same rotations and poses, ``estimator="joint"``; its model of the bias is
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
    instance("inter_rest", inter_rest, InterRestRotations)
    instance("gyroscope", gyroscope, GyroscopeFit)
    instance("magnetometer", magnetometer, MagnetometerFit)
    pair = _pair(inter_rest, poses, fields)
    _require_alike(gyroscope, magnetometer, len(pair[0]))
    count = pair[0].shape[1]
    noise = (
        checked_pose_std(pose_std, count),
        checked_pose_std(field_std, count, "field_std"),
    )
    own = noise_of(
        inter_rest, bias=gyroscope.bias, angle_random_walk=angle_random_walk,
        bias_random_walk=bias_random_walk, known_bias=known_bias, bias_std=bias_std,
    )  # fmt: skip
    options = CompassOptions(
        g=magnetometer.g, field=magnetometer.field, model=magnetometer.model,
        hemisphere="unstated", max_iterations=1, known=None,
    )  # fmt: skip
    scaled = scale(pair, noise, slice(None), options)
    # a noise of zero is rounding of the readings, which are of unit size here
    sensors = [
        replace(each, std=np.maximum(each.std, _FLOOR))
        for each in scaled.problem.sensors
    ]
    turns = InterRest(inter_rest=inter_rest, noise=own, each=EACH)
    problem = Problem(sensors=tuple(sensors), turns=turns)
    start = _start(turns, scaled, gyroscope, magnetometer)
    good, told = np.isfinite(start).all(axis=1), NOT_JUDGED
    found = minimize(problem, start, MOST_STEPS)
    stated = gyroscope.parameters.ndim == 1 and all(np.all(std > 0.0) for std in noise)
    if stated and good.all():
        problem, found, told = weighed(problem, found, MOST_STEPS)
    result: dict[str, Any] = _numbers(problem, found, scaled)
    for values in result.values():
        values[~good] = np.nan
    ends = [np.atleast_1d(fit.status) for fit in (gyroscope, magnetometer)]
    others = np.where(np.atleast_1d(gyroscope.converged), ends[1], ends[0])
    status = np.where(found.converged, "converged", "max iterations")
    result["status"] = np.where(good, status, others).astype(object)
    result["iterations"] = found.iterations
    dof = 2 * EACH * count - COUNT
    return _result(result, gyroscope, magnetometer, dof, told)


def _pair(
    inter_rest: InterRestRotations, poses: Any, fields: Any
) -> tuple[Array, Array]:
    named = {"poses": poses, "fields": fields}
    pair = [physical_array(name, value, (None, 3)) for name, value in named.items()]
    pair = [each[None] if each.ndim == 2 else each for each in pair]
    shape = inter_rest.rest_rates.shape
    if not pair[0].shape == pair[1].shape == shape:
        msg = (
            f"`inter_rest` has {shape[0]} trial(s) of {shape[1]} rests, `poses` the "
            f"shape {pair[0].shape} and `fields` {pair[1].shape}; give the mean of "
            "both sensors in each rest"
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


def _start(
    turns: InterRest,
    scaled: Scaled,
    gyroscope: GyroscopeFit,
    magnetometer: MagnetometerFit,
) -> Float[Array, "t p"]:
    # NaN where a fit of two is
    values = np.array(np.atleast_2d(magnetometer.parameters))
    values[:, ACCELEROMETER] = np.atleast_2d(gyroscope.accelerometer)
    values[:, DIP] = np.sin(values[:, DIP])
    own = np.array(np.atleast_2d(gyroscope.parameters))
    own[:, 9:] -= turns.inter_rest.centre
    poses = (values - scaled.shifts) / scaled.sizes
    start = np.concatenate([poses, own[:, : turns.size]], axis=1)
    return np.where(np.isfinite(start).all(axis=1, keepdims=True), start, np.nan)
