r"""Calibration of the sensors of one recording, together.

An accelerometer is fitted with a gyroscope, and with a magnetometer, and where there
are both in one fit of all three, which begins with these two.

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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from simval.arguments import choice, instance
from simval.arrays import Array, outer, physical_array
from simval.errors import InputError
from simval.imu.calibrate.accelerometer import calibrate
from simval.imu.calibrate.equations import Problem
from simval.imu.calibrate.estimate import Estimate
from simval.imu.calibrate.factors import NOT_JUDGED, NoiseFactors, widened
from simval.imu.calibrate.gauss_newton import JointSolution, minimize, weighed
from simval.imu.calibrate.gravity import gravity_error
from simval.imu.calibrate.gyroscope.calibration import ESTIMATORS, fit_gyroscope
from simval.imu.calibrate.gyroscope.noise import Weighting, noise_of
from simval.imu.calibrate.gyroscope.residuals import InterRest
from simval.imu.calibrate.gyroscope.result import NAMES, GyroscopeFit
from simval.imu.calibrate.magnetometer.calibration import (
    Scaled,
    fit_magnetometer,
    scale,
)
from simval.imu.calibrate.magnetometer.covariance import natural_sd
from simval.imu.calibrate.magnetometer.result import (
    ACCELEROMETER,
    DIP,
    OWN_NAMES,
    PARAMETERS,
    MagnetometerFit,
)
from simval.imu.calibrate.recording import OTHERS, Recording
from simval.imu.calibrate.result import FitResult
from simval.imu.calibrate.values import several_account
from simval.imu.sensor import forms
from simval.imu.sensor.readable import NORMAL_95
from simval.shapes import Float

GYROSCOPE, MAGNETOMETER = slice(9, 21), slice(21, 34)
"""Of three sensors, where the parameters of those beside the accelerometer stand."""
_COMPASS = np.r_[ACCELEROMETER, MAGNETOMETER]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration(Estimate):
    """Sensors of one recording, or of a batch of trials, in one fit; see `Estimate`.

    The parameters are the accelerometer's nine, then those of each other sensor, the
    dip of the field in rad; the covariance is that of all.

    Attributes
    ----------
    chi2_per_dof : Array
        Weighted sum of squares of all rows by degree of freedom, (...).
    noise : NoiseFactors
        By how much the noise of each sensor was taken to exceed what was stated, with
        which covariance and chi-square are; empty for a batch.
    accelerometer : FitResult or None
        The accelerometer with the numbers of this fit; None beside a magnetometer
        alone, unless the recording has its own fit.
    gyroscope : GyroscopeFit or None
        The gyroscope with the numbers of this fit; its `dof` and `chi2_per_dof` are
        those of all rows.
    magnetometer : MagnetometerFit or None
        The magnetometer with the parameters and the covariance of this fit. What is
        said of single poses, `chi_square`, `dof`, `pose_chi_square`, `disturbed` and
        `findings`, is of the fit with the accelerometer alone.
    recording : Recording
        What was fitted; `recording.taken` is what had been taken out of it.
    """

    what: ClassVar[str] = "several sensors"
    states: ClassVar[Any] = staticmethod(several_account)
    advice: ClassVar[str] = (
        "the fits of two sensors disagree by more than their noise; look for rests "
        "that moved, a disturbed field and the noise that is stated"
    )

    chi2_per_dof: Float[Array, "..."]
    noise: NoiseFactors
    # who fits a sensor knows that it is there: a type that may be None asks for that
    # at each use
    accelerometer: Any
    gyroscope: Any = None
    magnetometer: Any = None
    recording: Recording

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters; gyroscope's and magnetometer's have a prefix."""
        gyro = () if self.gyroscope is None else NAMES
        mag = () if self.magnetometer is None else OWN_NAMES
        others = (*(f"gyro_{x}" for x in gyro), *(f"mag_{x}" for x in mag))
        return (*forms.names(self.recording.model), *others)

    def with_covariance(self, covariance: Float[Array, "... p p"]) -> "Calibration":
        """Return the same calibration with another covariance, in each part too.

        Parameters
        ----------
        covariance : Array
            Of all parameters, (..., p, p).

        Returns
        -------
        Calibration
            The calibration.
        """
        return _parts_of(replace(self, covariance=covariance))

    def as_object(self) -> dict[str, Any]:
        """Return what is not in the sensors' own objects, as plain JSON values.

        Returns
        -------
        dict
            Names, covariance of all parameters, chi-square and status of one fit.
        """
        return {
            "names": list(self.names),
            "covariance": self.covariance.tolist(),
            "dof": self.dof,
            "chi2_per_dof": self.chi2_per_dof,
            "status": str(self.status),
            "iterations": int(self.iterations),
        }


def fit(
    recording: Recording,
    sensors: Sequence[str] | None = None,
    *,
    known: FitResult | None = None,
    estimator: Weighting = "joint",
    start: Any = None,
) -> Calibration:
    """Calibrate a gyroscope, a magnetometer or both, with their accelerometer.

    Parameters
    ----------
    recording : Recording
        Readings of the sensors, see `Recording` and `recording_of`.
    sensors : sequence of str, optional
        The sensors to calibrate, out of ``gyroscope`` and ``magnetometer``; if not
        given, all that the recording has.
    known : FitResult, optional
        The accelerometer's calibration from *other* poses, one for all trials or one
        for each. It enters the fit of a magnetometer alone with its covariance; without
        it, both sensors are fitted.
    estimator : {"joint", "generalised", "unweighted"}
        How a gyroscope alone is fitted: joint fits the accelerometer again, together
        with the gyroscope; generalised keeps the accelerometer's calibration and
        counts its errors; unweighted is IMU-TK's least squares.
    start : array_like, optional
        M of the gyroscope to start from, (3, 3); if not given, `fit` finds one.

    Returns
    -------
    Calibration
        Parameters, covariance and status of the whole fit and of each sensor.

    Raises
    ------
    InputError
        If an argument is not usable, or a sensor is not in the recording.
    GeometryError
        If the rests or the rotations of one recording leave a parameter unobservable.
        In a batch such a trial has a status that says so, and NaN for its numbers.
    RefusedError
        If the residuals of one recording are far beyond the noise of a sensor, or its
        poses give too little information.

    Notes
    -----
    IMU-TK's calibration of a gyroscope is ``estimator="unweighted"`` on a recording
    with ``bias="first rest"`` and rotations of ``scheme="linear"``. Each estimator has
    its own covariance, which follows from the stated noise
    (`simval.imu.calibrate.equations`). If the residuals of one recording contradict
    the stated noise, parameters and error bars use the noise that the residuals show
    (`simval.imu.calibrate.factors`), except with a `known` accelerometer. Chi-squares
    and findings of a magnetometer always use the stated noise. The covariance includes
    the errors of terms that were taken out.
    """
    there = instance("recording", recording, Recording).sensors
    named = there if sensors is None else tuple(sensors)
    for name in named:
        choice("sensors", name, OTHERS)
    estimator = choice("estimator", estimator, ESTIMATORS)
    if start is not None:
        start = physical_array("start", start, (3, 3))
    missing = [name for name in named if name not in there]
    if missing or not named:
        lacks = f"no {missing[0]}" if missing else "no sensor besides the accelerometer"
        msg = (
            f"the recording has {lacks}; give its readings to `Recording`, or use "
            "`calibrate` for an accelerometer alone"
        )
        raise InputError(msg)
    for option, given, alone in (
        ("known", known is not None, "magnetometer"),
        ("estimator", estimator != "joint", "gyroscope"),
    ):
        if given and named != (alone,):
            msg = (
                f"`{option}` is for a {alone} alone, and {' and '.join(named)} are "
                "asked for; leave it at its default, or fit one sensor at a time "
                "(`sensors`)"
            )
            raise InputError(msg)
    parts = {}
    for name in named:
        part = recording.of((name,))
        if name == "gyroscope":
            parts[name] = _with_gyroscope(part, estimator, start)
        else:
            parts[name] = _with_magnetometer(part, known)
    return together(recording, parts)


def together(recording: Recording, parts: Mapping[str, Calibration]) -> Calibration:
    """Fit all sensors in one, starting from the separate fits.

    Raises
    ------
    RefusedError
        If the residuals of one recording are far beyond the noise of a sensor.
    """
    if len(parts) == 1:
        return next(iter(parts.values()))
    gyroscope, magnetometer = (parts[name] for name in OTHERS)

    def fitted(means: Recording) -> Calibration:
        return _of_three(means, gyroscope, magnetometer)

    return _with_errors_of_terms(recording, fitted)


def _with_gyroscope(
    recording: Recording, estimator: Weighting, start: Any
) -> Calibration:
    own = recording.accelerometer or accelerometer_of(recording)

    def fitted(means: Recording) -> Calibration:
        found = fit_gyroscope(means, own.with_gravity(0.0), estimator, start)
        values = np.concatenate([found.accelerometer, found.parameters], axis=-1)
        return _of_two(means, found, values, accelerometer=own, gyroscope=found)

    return _with_errors_of_terms(recording, fitted)


def _with_magnetometer(recording: Recording, known: FitResult | None) -> Calibration:
    def fitted(means: Recording) -> Calibration:
        found = fit_magnetometer(means, known)
        own = means.accelerometer
        return _of_two(
            means, found, found.parameters, accelerometer=own, magnetometer=found
        )

    return _with_errors_of_terms(recording, fitted)


_SHARED = ("covariance", "dof", "status", "iterations", "chi2_per_dof", "noise")


def _of_two(
    recording: Recording, found: Any, parameters: Float[Array, "... p"], **sensors: Any
) -> Calibration:
    # a sensor and its accelerometer, by the numbers of its own result
    shared = {name: getattr(found, name) for name in _SHARED}
    return Calibration(parameters=parameters, recording=recording, **shared, **sensors)


def accelerometer_of(recording: Recording) -> FitResult:
    """Calibrate the accelerometer alone, with the noise if every rest has one."""
    std = np.sqrt((recording.pose_std**2).mean(axis=-1))
    return calibrate(
        recording.poses, recording.g, recording.model, residual="weighted",
        noise_std=std if np.all(std > 0.0) else None, g_std=recording.g_std,
    )  # fmt: skip


def _with_errors_of_terms(
    recording: Recording, fitted: Callable[[Recording], Calibration]
) -> Calibration:
    # the fit, with what the errors of terms and of gravity add to its covariance
    found = fitted(recording)
    P = np.array(found.covariance)
    if recording.single:
        P = np.array(widened(
            P, lambda shift: fitted(recording.moved(shift)).parameters, recording.shifts
        ))  # fmt: skip
        if found.gyroscope is not None:
            P[9:18, 9:18] += recording.taken.of_scale
    elif not recording.g_std:
        return found
    ratio = recording.g_std / recording.g
    off = gravity_error(recording.model, found.parameters[..., :9], ratio)
    P[..., :9, :9] += outer(off, off)
    return found.with_covariance(P)


def _parts_of(found: Calibration) -> Calibration:
    # with each sensor's part as that of the whole
    P, values, own = found.covariance, found.parameters, found.accelerometer
    changed: dict[str, Any] = {}
    if found.gyroscope is not None:
        changed["gyroscope"] = replace(
            found.gyroscope, parameters=values[..., GYROSCOPE],
            accelerometer=values[..., ACCELEROMETER], covariance=P[..., :21, :21],
        )  # fmt: skip
        joint = found.gyroscope.estimator == "joint"
        if joint and found.recording.single and own is not None:
            changed["accelerometer"] = joined(
                own, values[:9], P[:9, :9], found.recording.poses
            )
    if found.magnetometer is not None:
        at = _COMPASS if found.gyroscope is not None else np.arange(PARAMETERS)
        changed["magnetometer"] = replace(
            found.magnetometer, parameters=values[..., at],
            covariance=P[..., at[:, None], at],
        )  # fmt: skip
    return replace(found, **changed)


def joined(
    acc: FitResult,
    parameters: Float[Array, "9"],
    covariance: Float[Array, "9 9"],
    poses: Float[Array, "n 3"],
) -> FitResult:
    """The accelerometer's result after a fit with other sensors."""
    M = forms.matrix(acc.model, parameters)
    length = np.linalg.norm((poses - parameters[6:]) @ M.T, axis=1)
    return replace(
        acc,
        parameters=parameters,
        covariance=covariance,
        covariance_kind="known sigma",
        rms=np.sqrt(((length - acc.g) ** 2).mean()),
    )


EACH = 3  # equations of a pose, and residuals of a rotation
COUNT: Final = 34
MOST_STEPS: Final = 30
_ORDER = np.r_[0:9, 22:34, 9:22]
"""Accelerometer, gyroscope, magnetometer; the fit has the gyroscope last."""
_FLOOR: Final = 1e-11  # of the readings' own size, as for the other noises


def _of_three(
    recording: Recording, gyroscope: Calibration, magnetometer: Calibration
) -> Calibration:
    # all 34 parameters in one generalised least-squares fit of three equations a pose
    # and three a rotation, from the fits of two sensors each
    own, compass = gyroscope.gyroscope, magnetometer.magnetometer
    count, rotations = recording.poses.shape[-2], recording.rotations
    assert rotations is not None
    scaled = scale(recording)
    # a noise of zero is rounding of the readings, which are of unit size here
    sensors = [
        replace(each, std=np.maximum(each.std, _FLOOR))
        for each in scaled.problem.sensors
    ]
    turns = InterRest(inter_rest=rotations, noise=noise_of(recording), each=EACH)
    problem = Problem(sensors=tuple(sensors), turns=turns)
    start = _start(turns, scaled, own, compass)
    good, told = np.isfinite(start).all(axis=1), NOT_JUDGED
    found = minimize(problem, start, MOST_STEPS)
    noises = (recording.pose_std, recording.field_std)
    if recording.single and all(np.all(std > 0.0) for std in noises) and good.all():
        problem, found, told = weighed(problem, found, MOST_STEPS)
    result: dict[str, Any] = _numbers(problem, found, scaled)
    for values in result.values():
        values[~good] = np.nan
    ends = [np.atleast_1d(fit.status) for fit in (own, compass)]
    others = np.where(np.atleast_1d(own.converged), ends[1], ends[0])
    status = np.where(found.converged, "converged", "max iterations")
    result["status"] = np.where(good, status, others).astype(object)
    result["iterations"] = found.iterations
    if recording.single:
        result = {name: value[0] for name, value in result.items()}
    dof = EACH * (count + len(rotations.before) + 1) - COUNT
    chi2_per_dof = result["chi2"] / (dof if dof > 0 else np.nan)
    shared = {"status": result["status"], "iterations": result["iterations"]}
    own = replace(
        own, residual_angles=result["residual_angles"], dof=dof, noise=told,
        chi2_per_dof=chi2_per_dof, **shared,
    )  # fmt: skip
    compass = replace(compass, half_width=result["half_width"], noise=told, **shared)
    whole = Calibration(
        parameters=result["parameters"], covariance=result["covariance"], dof=dof,
        chi2_per_dof=chi2_per_dof, noise=told, accelerometer=gyroscope.accelerometer,
        gyroscope=own, magnetometer=compass, recording=recording, **shared,
    )  # fmt: skip
    return _parts_of(whole)


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
    poses, own = theta[:, :PARAMETERS], theta[:, PARAMETERS:]
    inner = whole[:, :PARAMETERS, :PARAMETERS]
    natural = natural_sd(problem.accelerometer.model, poses, here.at, inner)
    values, _ = scaled.physical(poses, inner)
    slope = np.ones((t, COUNT))
    slope[:, :PARAMETERS] = scaled.sizes
    slope[:, DIP] = 1.0 / np.cos(values[:, DIP])
    whole *= outer(slope, slope)
    parameters = np.concatenate([values, turns.parameters(own)], axis=1)
    return {
        "parameters": parameters[:, _ORDER],
        "covariance": whole[:, _ORDER[:, None], _ORDER],
        "half_width": NORMAL_95 * natural.max(axis=1),
        "residual_angles": turns.angles(here.at, own),
        "chi2": np.array(here.chi_square),
    }


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
