"""Calibration of a log: the accelerometer first, then the other sensors.

The rests that the accelerometer shows are the poses of all. Accelerometer and gyroscope
are fitted together, and so are accelerometer and magnetometer; where they misfit, each
fit says who is to blame (`simval.imu.calibrate.factors`). Where there are all three,
one fit of all begins with these two. Where the log has a
temperature, each sensor's terms in it are chosen first (`simval.imu.calibrate.thermal`)
and taken out of the rows; in the fits of several sensors their uncertainty is noise of
each pose. A sensor that cannot be
calibrated from this log is left out with the reason; one that was asked for is refused.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as default
from functools import partial
from typing import Any

import numpy as np

from simval.account import Account, Remark, Told
from simval.arguments import choice
from simval.arrays import Array, ReadOnly
from simval.errors import InputError, RefusedError
from simval.imu.calibrate import (
    Calibration,
    FitResult,
    GyroscopeFit,
    MagnetometerFit,
    Recording,
    calibrate,
    fit,
    recording_of,
)
from simval.imu.calibrate.covariance import FEW
from simval.imu.calibrate.diagnosis import Diagnosis, diagnose, reduced_chi2
from simval.imu.calibrate.joint import together
from simval.imu.calibrate.path_statistics import Scheme
from simval.imu.calibrate.recording import NOTHING, OTHERS, Hemisphere, Taken
from simval.imu.calibrate.rest_temperatures import RestTemperatures, within_rests
from simval.imu.calibrate.thermal import (
    TEMPERATURE,
    TIME,
    Course,
    Term,
    ThermalChoice,
    ThermalFit,
    choose_thermal,
)
from simval.imu.explain import RestMeans
from simval.imu.logs import Log
from simval.imu.multiposition.case import case_of, kept, rest_means
from simval.imu.multiposition.description import calibration_account
from simval.imu.multiposition.faults import explained, for_a_log, require_sound
from simval.imu.multiposition.log_units import Scale, units_of
from simval.imu.multiposition.noise import PoseNoise, along_gravity, pose_noise
from simval.imu.multiposition.ranges import (
    require_alive,
    require_one_unit,
    require_unsaturated,
)
from simval.imu.multiposition.rests import find_rests
from simval.imu.noise import NoiseFile
from simval.imu.statics import Intervals, Rest, interval_means
from simval.poses import PARAMETERS, observability
from simval.shapes import Float
from simval.vocabulary import Iteration, Loss, Method, Model, Residual


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LogCalibration(Told, ReadOnly):
    """Calibration of a log: its rests, its accelerometer and its other sensors.

    Attributes
    ----------
    fit : FitResult
        The accelerometer's calibration by itself, with Type A error bars.
    diagnosis : Diagnosis
        Residuals, outliers, chi-square and verdict, by `pose_noise`.
    white_chi2_per_dof : float
        Chi-square per degree of freedom if white noise were all there is; NaN where the
        readings show no noise.
    pose_noise : PoseNoise
        Noise of the mean of each rest, and where it comes from.
    rest : Rest
        The initial rest.
    rest_seconds : float
        Its length, s.
    multiplier : float
        Threshold of the detector over the variance of the rest.
    intervals : Intervals
        Static intervals, samples start <= k < stop, (m, 2).
    numbers : Intervals
        Of each among those that were found, from 0, with the ones left out, (m,).
    steps : tuple of str
        Rests that hold several levels: cut into these, or left out.
    cuts : tuple of str
        Rests of the accelerometer in which the gyroscope turns: cut, left out or, of
        too few, kept.
    turns : bool
        Whether it does in all but too few: `intervals` are the accelerometer's then,
        and the gyroscope cannot be calibrated.
    predicted : CalibrationMoments or None
        Bias, covariance and Cramer-Rao bound by `pose_noise`; None where nobody was
        asked, or the readings show no noise.
    next_direction : Array
        Direction of a further pose that would help most, sensor axes, (3,).
    warm : ThermalChoice
        What the accelerometer owes to temperature; `fit` is at the reference.
    accelerometer : FitResult
        The accelerometer's as the fit with the other sensors leaves it, else `fit`.
    gyroscope : GyroscopeFit or None
        Its covariance holds the accelerometer's nine parameters too.
    magnetometer : MagnetometerFit or None
        On the axes of the accelerometer, fitted together with it.
    together : Calibration or None
        The one fit that all of these are of, where there are three sensors.
    taken : Taken
        What was taken out of the readings of all, and why.
    left_out : mapping of str to Remark
        Sensors of the log that are not calibrated: why, and what to do.
    field_noise : PoseNoise or None
        Noise of the magnetometer's pose means, and where it comes from.
    thermal_reasons : tuple of str
        Why there are these terms in temperature, or none.
    units : mapping of str to Scale
        Unit and axes of each sensor as they are stated, and as the readings show.
    """

    fit: FitResult
    diagnosis: Diagnosis
    white_chi2_per_dof: float
    pose_noise: PoseNoise
    rest: Rest
    rest_seconds: float
    multiplier: float
    intervals: Intervals
    numbers: Intervals
    steps: tuple[str, ...]
    cuts: tuple[str, ...]
    turns: bool
    predicted: Any
    next_direction: Float[Array, "3"]
    warm: ThermalChoice
    accelerometer: FitResult
    gyroscope: GyroscopeFit | None = None
    magnetometer: MagnetometerFit | None = None
    together: Calibration | None = None
    taken: Taken = NOTHING
    left_out: Mapping[str, Remark] = default(default_factory=dict)
    field_noise: PoseNoise | None = None
    thermal_reasons: tuple[str, ...] = ()
    units: Mapping[str, Scale] = default(default_factory=dict)

    @property
    def account(self) -> Account:
        """Everything that there is to say of the calibration."""
        return calibration_account(self)


def calibrate_log(
    log: Log,
    *,
    g: float = 9.80665,
    g_std: float = 0.0,
    model: Model = "triangular",
    method: Method = "lm",
    residual: Residual = "squared",
    loss: Loss = "linear",
    step: float = 1.0,
    iteration: Iteration = "centre",
    rest: float | None = None,
    full_scale: float | None = None,
    noise: NoiseFile | None = None,
    leave_out: Sequence[float] = (),
    drift: bool = False,
    predict: Callable[..., Any] | None = None,
) -> LogCalibration:
    """Calibrate the accelerometer of a log.

    Parameters
    ----------
    log : Log
        The log, see `simval.imu.logs.read_log`.
    g, g_std : float
        Local gravity and its standard deviation, m/s^2, see
        `simval.imu.calibrate.local_gravity`; 0 takes it as exact.
    model, method, residual, loss : str
        As in `simval.imu.calibrate.calibrate`.
    step : float, default 1.0
        Fraction of each step of the solver that is taken.
    iteration : {"centre", "source"}
        As in `simval.imu.calibrate.calibrate`.
    rest : float or None
        Length of the initial rest, s; None finds it.
    full_scale : float or None
        Greatest reading of the sensor, units of the log.
    noise : NoiseFile or None
        The sensor's noise, see `simval.imu.noise.load_noise`; None takes it from the
        log's longest rest, and white noise alone where that is too short.
    leave_out : sequence of int or float
        Rests to leave out: an int is the number of one, a float a time within it, s.
    drift : bool, default False
        Whether the accelerometer's bias and scale may follow the time; the parameters
        are those at the middle of the rests.
    predict : callable or None
        Theory of how well the sensor can be known from these rests, such as
        `simval.theory.calibration_moments`.

    Returns
    -------
    LogCalibration
        The calibration and what it was made from.

    Raises
    ------
    InputError
        If a rest that is to be left out was not found.
    RefusedError
        If there is no rest, no threshold gives nine static intervals, none of the
        fits is a calibration, or the log shows a fault of the sensor or the logger.
    """
    fitted = partial(
        calibrate, g=g, model=model, method=method, residual=residual, loss=loss,
        full_scale=full_scale, step=step, iteration=iteration,
    )  # fmt: skip
    over = _course(log, loss) if drift else TEMPERATURE
    try:
        rests = find_rests(log, rest)
        refusal: RefusedError | None = None
        for level in rests.plateau:
            numbers = kept(log, level.intervals, leave_out)
            intervals = level.intervals[numbers]
            require_unsaturated(log, intervals, full_scale)
            poses = interval_means(log.accelerometer, intervals)
            pose = pose_noise(log, intervals, block=rests.block, file=noise)
            # so few residuals say too little of the noise; what was measured says it
            few = len(poses) - PARAMETERS <= FEW and pose.source == "file"
            stated = pose.std if few or residual == "adjusted" else None
            try:
                fit = fitted(poses, noise_std=stated).require_converged()
                break
            except RefusedError as error:
                refusal = error
        else:
            assert refusal is not None  # there is a best level
            raise refusal
        pose = along_gravity(log, intervals, pose, fit)
        if np.any(pose.trembled):
            log = steadied(log, intervals, pose)
            poses = interval_means(log.accelerometer, intervals)
            fit = fitted(poses, noise_std=stated).require_converged()
        std = None if np.any(pose.std == 0.0) else pose.std
        white = None if np.any(pose.white == 0.0) else pose.white
        means = rest_means(log, intervals, pose)
        warm, further = _rest_terms(log, intervals, means, fit, std, loss, over), None
        if warm.fit is not None:
            log = at_reference(log, accelerometer=warm.thermal)
            poses = interval_means(log.accelerometer, intervals)
            fit = fitted(poses, residual="squared")
            fit = _with_terms(fit, warm.fit, std)
            further = warm.fit.slopes[:, 9:] * (1.0 if std is None else std[:, None])
        if warm.rests is not None:
            within = within_rests(
                log.accelerometer, log.time, intervals, warm.rests, warm.thermal
            )
            warm = warm._replace(within=within)
        case = case_of(log, rest, intervals, pose, fit, numbers)
        diagnosis = diagnose(
            fit, poses, std, time=case.middle, further=further,
            judgement=case.judgement,
        )  # fmt: skip
        sensor = fit.sensor()
        forces, initial = sensor.correct(poses), rests.initial
        fit = fit.with_gravity(g_std)  # all before is by what the log shows
        result = LogCalibration(
            fit=fit,
            diagnosis=replace(diagnosis, do=case.do),
            white_chi2_per_dof=reduced_chi2(fit, poses, white),
            pose_noise=pose,
            rest=initial,
            rest_seconds=float(log.time[initial.stop - 1] - log.time[initial.start]),
            multiplier=level.multiplier,
            intervals=intervals,
            numbers=numbers,
            steps=level.steps,
            cuts=level.cuts,
            turns=not level.enough,
            predicted=None
            if std is None or predict is None
            else predict(sensor, forces, fit.g, std, fit.residual, form=fit.model),
            next_direction=observability(forces).next_direction,
            warm=warm,
            accelerometer=fit,
            taken=NOTHING._replace(thermal=_terms(accelerometer=warm.thermal)),
        )
    except RefusedError as error:
        raise explained(log, rest, error) from error
    require_sound(case)
    return result


def _course(log: Log, loss: str) -> Course:
    # of a drift that is asked for, if the rests can show it
    if log.temperature is not None:
        beside = "a temperature, by which terms go; leave its column out (--columns)"
    elif loss != "linear":
        beside = f"the loss {loss}; terms are fitted by least squares: leave it out"
    else:
        return TIME
    msg = f"`drift` cannot be used together with {beside}"
    raise InputError(msg)


def steadied(log: Log, intervals: Intervals, pose: PoseNoise) -> Log:
    """Log whose rests have the means that they would have without a trembling hand."""
    if not np.any(pose.trembled):
        return log
    rows = log.accelerometer.copy()
    lost = np.broadcast_to(pose.trembled, (len(intervals), 3))
    for (a, b), each in zip(intervals, lost, strict=True):
        rows[a:b] += each
    return replace(log, accelerometer=rows)


def at_reference(log: Log, **terms: Term | None) -> Log:
    """Log as its sensors would have read at their reference temperatures."""
    rows = {name.replace("gyroscope", "gyro"): own for name, own in terms.items()}
    changed: dict[str, Any] = {
        name: own.compensated(getattr(log, name), course)
        for name, own in rows.items()
        if own is not None
        and getattr(log, name) is not None
        and (course := getattr(log, own.over.name)) is not None
    }
    return replace(log, **changed)


def _rest_terms(
    log: Log,
    rests: Intervals,
    means: RestMeans,
    fit: FitResult,
    std: Float[Array, " m"] | None,
    loss: str = "linear",
    over: Course = TEMPERATURE,
) -> ThermalChoice:
    # temperature or time of each rest, and how the readings depend on it
    course = getattr(log, over.name)
    if course is None:
        return ThermalChoice()
    rested = RestTemperatures.of(course, log.time, rests, means.readings)
    if loss != "linear":
        why = f"the loss is {loss}: terms are fitted by least squares"
        return ThermalChoice(rested, reason=rested.not_modelled(why), tested=False)
    found = choose_thermal(
        means, rested, start=fit.parameters, model=fit.model, g=fit.g, over=over,
        std=np.ones(len(rests)) if std is None else std,
    )  # fmt: skip
    return found if over is TEMPERATURE else found._replace(rests=None)


def _with_terms(
    fit: FitResult, warm: ThermalFit, std: Float[Array, " m"] | None
) -> FitResult:
    # the fit of the readings at the reference, with what the terms cost it
    dof = len(warm.slopes) - warm.theta.size
    scale = warm.square / dof
    chi2: Any = np.float64(np.nan if std is None else scale)
    return replace(
        fit, parameters=warm.theta[:9], covariance=scale * warm.covariance[:9, :9],
        residual="weighted", covariance_kind="type A", dof=dof,
        chi2_per_dof=chi2,
    )  # fmt: skip


def calibrate_sensors(
    log: Log,
    result: LogCalibration,
    *,
    sensors: Sequence[str] | None = None,
    hemisphere: Hemisphere = "unstated",
    field: float = 1.0,
    noise: NoiseFile | None = None,
) -> LogCalibration:
    """Calibrate the other sensors of a log whose accelerometer is calibrated.

    Parameters
    ----------
    log : Log
        The log.
    result : LogCalibration
        As from `calibrate_log`.
    sensors : sequence of str or None
        Out of ``gyroscope`` and ``magnetometer``, those that must be calibrated; None
        takes those that the log has and leaves out what cannot be.
    hemisphere : {"unstated", "north", "south"}
        Where the log was made, which the magnetometer's axes cannot tell.
    field : float
        Strength of the field, in the unit that the magnetometer's M is wanted in.
    noise : NoiseFile or None
        Where it has a magnetometer, its noise; None, or one without, takes it from the
        log's longest rest, and white noise alone where that is too short.

    Returns
    -------
    LogCalibration
        The result with these sensors, and what was left out.

    Raises
    ------
    InputError
        If a sensor is unknown, or asked for and not in the log.
    RefusedError
        If a sensor that was asked for cannot be calibrated from this log.
    """
    asked = None if sensors is None else [choice("sensors", s, OTHERS) for s in sensors]
    recorded = log
    log = steadied(log, result.intervals, result.pose_noise)
    log = at_reference(log, accelerometer=result.warm.thermal)
    rests = partial(
        recording_of, log.time, log.accelerometer, result.intervals, g=result.fit.g,
        g_std=result.fit.g_std, model=result.fit.model, field=field,
        pose_std=result.pose_noise.std, hemisphere=hemisphere,
    )  # fmt: skip
    shifts = {"accelerometer": result.warm.shifts}
    parts: dict[str, Calibration] = {}
    left_out, place = dict[str, Remark](), f"{log.path}: "
    field_noise, warm = None, ThermalChoice()
    for name, samples in _wanted(log, asked):
        try:
            require_alive(log, name, samples)
            if name == "gyroscope":
                parts[name] = _gyroscope(log, result, rests, samples)
                continue
            found, field_noise, warm = _fields(log, result, samples, field, noise)
            own = rests(magnetometer=found, field_std=field_noise.std)
            shifts[name] = warm.shifts
            part = fit(_with_errors(own, shifts)).require_converged()
            require_one_unit(log, name, _matrix(part))
            parts[name] = part
        except RefusedError as error:
            if asked is not None:
                raise
            said = error.remark
            words, do = map(for_a_log, (said.words.removeprefix(place), said.do))
            left_out[name] = said._replace(words=words, do=do)
    imu, compass = parts.get("gyroscope"), parts.get("magnetometer")
    warm = ThermalChoice() if compass is None else warm  # what is left out has none
    whole, refusal = _all(parts, shifts)
    one, other = whole or imu, whole or compass
    taken, matrices = NOTHING, {"accelerometer": result.fit.matrix}
    if imu is not None:
        taken, matrices["gyro"] = imu.recording.taken, imu.gyroscope.M
    reasons = (
        ()
        if one is None
        else (*taken.reasons, *filter(None, [one.noise.words]), *refusal)
    )
    return replace(
        result,
        accelerometer=(one and one.accelerometer) or result.fit,
        gyroscope=one.gyroscope if one else None,
        magnetometer=other.magnetometer if other else None,
        together=whole,
        taken=taken._replace(
            reasons=reasons,
            thermal=_terms(
                accelerometer=result.warm.thermal,
                gyroscope=taken.thermal.get("gyroscope"),
                magnetometer=warm.thermal,
            ),
        ),
        field_noise=field_noise if compass else None,
        left_out=left_out,
        thermal_reasons=tuple(x for x in (result.warm.reason, warm.reason) if x),
        units=units_of(recorded, matrices=matrices, hemisphere=hemisphere),
    )


def _terms(**found: Term | None) -> dict[str, Term]:
    # terms in temperature of the sensors that have any
    return {name: own for name, own in found.items() if own is not None}


def _wanted(log: Log, asked: Sequence[str] | None) -> Iterator[tuple[str, Array]]:
    # other sensors to calibrate, and their rows
    for name, samples in (("gyroscope", log.gyro), ("magnetometer", log.magnetometer)):
        if samples is not None and (asked is None or name in asked):
            yield name, samples
        elif asked is not None and name in asked:
            letter = name[0].replace("g", "w")
            msg = (
                f"{log.path} has no {name}, but you asked for it; name its columns: "
                f"--columns with {letter}x, {letter}y and {letter}z"
            )
            raise InputError(msg)


def _all(
    parts: Mapping[str, Calibration], shifts: Mapping[str, Any]
) -> tuple[Calibration | None, tuple[str, ...]]:
    # the three sensors in one fit, or why they are left as they are
    if len(parts) < len(OTHERS):
        return None, ()
    imu, read = parts["gyroscope"], parts["magnetometer"].recording
    three = replace(imu.recording, fields=read.fields, field_std=read.field_std)
    try:
        return together(_with_errors(three, shifts), parts).require_converged(), ()
    except RefusedError as error:
        return None, (f"the three sensors are not fitted together: {error}",)


def _with_errors(recording: Recording, shifts: Mapping[str, Any]) -> Recording:
    return replace(recording, taken=recording.taken._replace(shifts=shifts))


def _gyroscope(
    log: Log,
    result: LogCalibration,
    rests: Callable[..., Recording],
    samples: Float[Array, "n 3"],
) -> Calibration:
    # together with the accelerometer
    if result.turns:
        msg = (
            f"it turns in {len(result.cuts)} of the {len(result.intervals)} "
            f"rests of the accelerometer, and {PARAMETERS} rests in which both "
            "are still are needed"
        )
        do = "record more rests in which nothing turns"
        raise RefusedError(msg, do, rests=len(result.intervals))
    scheme: Scheme = "cubic" if log.gyro_rows.kind == "instant" else "averages"
    samples = log.gyro_rows.in_place(log.time, samples)
    shifts = {"accelerometer": result.warm.shifts}

    def joint(rows: Float[Array, "n 3"]) -> Calibration:
        recording = rests(gyroscope=rows, temperature=log.temperature, scheme=scheme)
        found = fit(_with_errors(recording, shifts)).require_converged()
        require_one_unit(log, "gyroscope", _matrix(found))
        return found

    # axes of different units make any move look blind to the one with small numbers
    try:
        return joint(samples)
    except RefusedError as error:
        size = samples.std(axis=0)
        try:
            alike = joint(samples / size)
        except RefusedError:
            raise error from None
        require_one_unit(log, "gyroscope", _matrix(alike) / size)
        raise


def _matrix(found: Calibration) -> Float[Array, "3 3"]:
    # of the one other sensor
    return (found.gyroscope or found.magnetometer).M


def _fields(
    log: Log,
    result: LogCalibration,
    samples: Float[Array, "n 3"],
    field: float,
    file: NoiseFile | None,
) -> tuple[Float[Array, "n 3"], PoseNoise, ThermalChoice]:
    # rows of the magnetometer at its reference, and their noise; its terms in
    # temperature by the strength of the field alone, which is as constant as gravity
    rests, warm = result.intervals, ThermalChoice()
    noise = pose_noise(log, rests, sensor="magnetometer", file=file)
    if log.temperature is None:
        return samples, noise, warm
    fields = interval_means(samples, rests)
    std = None if np.any(noise.std == 0.0) else noise.std
    means = rest_means(log, rests, noise, samples)
    warm = _rest_terms(
        log, rests, means, calibrate(fields, field, result.fit.model), std
    )
    warm = warm._replace(reason=warm.reason and f"magnetometer: {warm.reason}")
    if warm.thermal is not None:
        samples = warm.thermal.compensated(samples, log.temperature)
    return samples, noise, warm
