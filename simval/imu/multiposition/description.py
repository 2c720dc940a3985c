r"""A log's calibration as text and as JSON, with its verdict.

**Conditions.** Every sentence that says yes or no of the error bars, in the terminal,
in files and on the page, is a `Condition`: no where the chance of what is seen is below
the level of its test.

**ROS** (``sensor_msgs/Imu``) has the noise of single readings in SI units and the axes
of the calibration: with M the matrix of a sensor and :math:`\sigma_k` the white noise
of a reading on its axis k, the covariance of a corrected reading is
:math:`M\,\mathrm{diag}(\sigma^2)\,M^T`, row by row.
"""

from typing import Any, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate import MagnetometerFit
from simval.imu.calibrate.diagnosis import Diagnosis, order_words
from simval.imu.calibrate.drift import DRIFT_FALSE_ALARM, HIDDEN, Drift
from simval.imu.calibrate.estimate import (
    gyroscope_lines,
    magnetometer_lines,
    matrix_lines,
    parameter_lines,
    residual_line,
    status_line,
)
from simval.imu.calibrate.factors import NoiseFactors
from simval.imu.calibrate.files import to_json
from simval.imu.calibrate.goodness_of_fit import (
    BELIEVED,
    BEYOND,
    FALSE_ALARM,
    chi_square_chance,
)
from simval.imu.calibrate.magnetometer.findings import FALSE_ALARM as ONE_POSE
from simval.imu.calibrate.magnetometer.result import OWN_NAMES
from simval.imu.calibrate.reduction import variance_within
from simval.imu.calibrate.rest_temperatures import LEAST_SPAN, Within
from simval.imu.calibrate.thermal import Thermal
from simval.imu.explain.judgement import CHANCE
from simval.imu.logs import Log
from simval.imu.statics import Intervals
from simval.shapes import Float


class Condition(NamedTuple):
    """One question about the error bars, and the answer of its test.

    Attributes
    ----------
    about : str
        What is judged.
    holds : bool or None
        Whether all is as the error bars take it; None where the log does not tell.
    p_value : float
        Chance of what is seen if it is; NaN where the test has none.
    level : float
        The test says no below it.
    words : str
        The answer.
    """

    about: str
    holds: bool | None
    p_value: float
    level: float
    words: str

    def as_object(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        known = np.isfinite(self.p_value)
        return self._asdict() | {"p_value": self.p_value if known else None}


def conditions(whole: Any) -> tuple[Condition, ...]:
    """Judge the sensors of a log, the accelerometer first."""
    found = [
        _rests(whole.log),
        _order(whole.log.diagnosis),
    ]
    if whole.log.warm.rests is not None:
        found += [_temperature(whole), _within(whole.log.warm.within)]
    gyroscope, compass = whole.gyroscope, whole.magnetometer
    if gyroscope is not None:
        judged = gyroscope.noise.sources
        found.append(_joint(gyroscope.noise) if judged else _rows(gyroscope))
        if gyroscope.drift is not None:
            found.append(_drift("gyroscope", gyroscope.drift))
    if compass is not None:
        if whole.together is None and compass.noise.sources:
            found.append(_joint(compass.noise))
        found += [poses_alike(compass, whole.log.numbers), steady(compass)]
    return tuple(found)


def honest(found: tuple[Condition, ...]) -> tuple[bool | None, str]:
    """Say whether the error bars are honest, with the gravest answer."""
    for answer, begin in ((False, "No: "), (None, "Not told: ")):
        said = [each.words for each in found if each.holds is answer]
        if said:
            return answer, begin + said[0]
    said = [each.words for each in found if np.isfinite(each.p_value)]
    return True, f"Yes: {said[0]}"


def _rests(log: Any) -> Condition:
    # a Type A error bar takes the scatter as it is, whatever the noise was said to be
    found, answer = log.diagnosis, log.diagnosis.judgement.answer
    by_scatter = log.fit.covariance_kind == "type A"
    seen = f"chi-square per degree of freedom {found.chi2_per_dof:.3g}"
    holds = {"sound": True, "unknown": None if by_scatter else False}.get(answer, False)
    words = found.wrong or f"the residuals are what the noise explains: {seen}"
    if answer == "unknown" and by_scatter:
        words += "; the error bars are as wide as that"
    if answer == "sound" and found.p_value > 1.0 - BELIEVED:
        holds, words = by_scatter, f"the residuals are smaller than the noise: {seen}"
    if answer == "sound" and not np.isfinite(found.p_value):
        holds, words = None, "the noise of a pose, or a degree of freedom, is not there"
    p = found.judgement.chance
    return Condition("rests of the accelerometer", holds, p, CHANCE, words)


def _order(found: Diagnosis) -> Condition:
    hides = found.hidden > HIDDEN
    of = f" of {found.hides} of the accelerometer" if hides else ""
    return Condition(
        about="order of the poses",
        holds=None if hides else True,
        p_value=float("nan"),
        level=HIDDEN,
        words=f"the order of the poses hides {'a' if hides else 'no'} drift{of}",
    )


def _drift(name: str, found: Drift) -> Condition:
    hidden = not (found.seen or found.excluded)
    words = f"the residuals of the {name} do not follow the time"
    if found.seen:
        words = f"the {name} drifts: its residuals follow the time by {found.what}"
    elif not np.isfinite(found.p_value):
        words = f"too few poses to tell a drift of the {name}"
    elif hidden:
        words = f"the order of the poses hides a drift of {found.hides} of the {name}"
    told = _by_chance(f"drift of the {name}", found.p_value, DRIFT_FALSE_ALARM, words)
    return told._replace(holds=None) if hidden else told


def _temperature(whole: Any) -> Condition:
    # whether its effect is in the bars: tested, and not the same as a drift in time
    warm, words = whole.log.warm, "the temperature has no effect that is left out"
    untold = warm.rests.confounded if whole.thermal else ""
    if not warm.tested and warm.rests.span >= LEAST_SPAN:
        untold = untold or warm.reason
    return Condition(
        about="temperature of the rests",
        holds=None if untold else True,
        p_value=float("nan"),
        level=FALSE_ALARM,
        words=untold or words,
    )


def _within(found: Within) -> Condition:
    about = "drift within the rests"
    told = _by_chance(about, found.chance, DRIFT_FALSE_ALARM, found.words)
    # none is judged where the temperature hardly changes within a rest
    return told if np.isfinite(found.chance) else told._replace(holds=True)


def _joint(noise: NoiseFactors) -> Condition:
    names = " and ".join(noise.sources)
    return _by_chance(
        f"joint fit of {names}",
        noise.p_value,
        CHANCE,
        "; ".join(noise.sentences) or "every sensor bears its stated noise",
    )


def _rows(fit: Any) -> Condition:
    # of a fit whose sensors were not judged one by one
    p = chi_square_chance(float(fit.chi2_per_dof) * fit.dof, fit.dof)
    words = f"chi-square per degree of freedom {float(fit.chi2_per_dof):.3g}"
    return _by_chance("moves of the gyroscope", p, BEYOND, words)


def poses_alike(fit: Any, numbers: Intervals) -> Condition:
    """Judge whether the field is the same in every pose, as far as noise tells."""
    p = chi_square_chance(float(fit.chi_square), fit.dof)
    mean = f"chi-square {np.nanmean(fit.pose_chi_square):.2g} a pose, of about 3"
    words = f"the field is that of its noise in every pose: {mean}"
    if fit.disturbed:
        named = ", ".join(str(numbers[k]) for k in fit.disturbed)
        words = f"the field is another in rest {named}"
    elif p < BEYOND:
        words = f"the field differs from pose to pose by more than its noise: {mean}"
    told = _by_chance("poses of the magnetometer", p, BEYOND, words)
    return told._replace(holds=False) if fit.disturbed else told


def steady(fit: Any) -> Condition:
    """Judge whether the strength of the field changes with time."""
    p = float(fit.steady_p_value)
    words = "the strength of the field varies with time" if p < ONE_POSE else ""
    return _by_chance(
        "field over time", p, ONE_POSE, words or "the field does not follow the time"
    )


def _by_chance(about: str, p: float, level: float, words: str) -> Condition:
    holds = bool(p >= level) if np.isfinite(p) else None
    return Condition(about=about, holds=holds, p_value=p, level=level, words=words)


def log_lines(result: Any, whole: Any = None) -> list[str]:
    """Describe the result in lines of text, with the numbers of the fit of all."""
    diagnosis = result.diagnosis
    hidden = order_words(diagnosis.hidden, diagnosis.hides)
    fit = result.fit if whole is None else whole.accelerometer
    joint = "" if whole is None else fit_of(whole)
    how = "found" if result.rest.found else "given"
    noise, by_white = result.pose_noise, "white noise alone"
    bounding, by_white_lines = by_white, []
    if noise.source != "white":
        bounding = "the noise of the poses"
        by_white_lines = [
            f"                  {by_white}, {np.median(noise.white):.4g}, would "
            f"leave a chi2 per dof of {result.white_chi2_per_dof:.3g}"
        ]
    lines = [
        f"initial rest      {result.rest_seconds:.2f} s ({how})",
        f"static intervals  {len(result.intervals)} "
        f"(threshold {result.multiplier:g} times the rest's variance)",
        *(f"{'':18s}{cut}" for cut in (*result.steps, *result.cuts)),
        *temperature_lines(result, {} if whole is None else whole.thermal),
        status_line(fit),
        "",
        *([f"accelerometer     {joint}"] if joint else []),
        *parameter_lines(fit, bound_sd(result)),
        *_term_lines(result.warm.thermal, fit.g / fit.raw_per_g, "m/s^2"),
        "",
        *matrix_lines(fit),
        "",
        residual_line(fit),
        f"chi2 per dof      {diagnosis.chi2_per_dof:.3g} with {fit.dof} degrees of "
        "freedom",
        _noise_line(noise),
        *by_white_lines,
        f"verdict           {diagnosis.verdict}",
        *([f"order of poses    {hidden}"] if hidden else []),
        f"least determined  {diagnosis.least_determined.sentence}",
        f"bound             least sd that {bounding} would allow with these "
        f"poses{', without rotations' * bool(joint)} (Cramer-Rao)",
        f"gravity           {fit.g:g} m/s^2 was assumed; a g wrong by 0.1 % makes "
        "every K wrong by 0.1 %, and leaves T and B",
    ]
    further = ", ".join(f"{x:.2f}" for x in result.next_direction)
    lines.append(
        f"next pose         specific force along ({further}) in sensor axes would "
        "lower the total variance most"
    )
    for pose in diagnosis.outliers:
        start, stop = result.intervals[pose]
        lines.append(
            f"outlier           rest {result.numbers[pose]} "
            f"(samples {start} to {stop - 1}): "
            f"{diagnosis.standardized[pose]:.1f} standard deviations off"
        )
    return lines


def temperature_lines(result: Any, thermal: Any) -> list[str]:
    """Say the range over the rests, what was made of it, and if time looks the same."""
    warm = result.warm
    if warm.rests is None:
        return []
    more = [
        warm.reason,
        warm.rests.confounded if thermal or warm.thermal is not None else "",
        warm.within.words if warm.within.chance < DRIFT_FALSE_ALARM else "",
    ]
    said = [f"{'':18s}{each}" for each in more if each]
    return [f"temperature       {warm.rests.line}", *said]


def _term_lines(
    thermal: Thermal | None, size: Float[Array, "3"], unit: str
) -> list[str]:
    return [] if thermal is None else thermal.lines(size, unit)


def bound_sd(result: Any) -> Float[Array, "9"]:
    """Square root of the Cramer-Rao bound on each variance; NaN if not known."""
    if result.predicted is None:
        return np.full(9, np.nan)
    return np.sqrt(np.diagonal(result.predicted.cramer_rao))


def _noise_line(noise: Any) -> str:
    return f"noise of a pose   {np.median(noise.std):.4g} raw units, {noise.words}"


def fit_of(whole: Any) -> str:
    """The fit that the accelerometer's numbers are from, if not its own."""
    if whole.together is not None:
        return "one fit of all three sensors, in which the rotations help the others"
    if whole.gyroscope is not None:
        return "fit together with the gyroscope, whose rotations help it"
    return ""


def sensor_lines(whole: Any) -> list[str]:
    """Describe the other sensors, what was left out, and whether to trust the bars."""
    lines: list[str] = []
    if whole.gyroscope is not None:
        others = "accelerometer"
        if whole.together is not None:
            others += " and the magnetometer"
        fit, G, sd = whole.gyroscope, whole.sensitivity, whole.sensitivity_sd
        lines += ["", *gyroscope_lines(fit, others, G, sd)]
        lines += [f"{'':18s}{reason}" for reason in whole.reasons]
        size = np.linalg.norm(fit.M, axis=0)
        lines += _term_lines(whole.thermal.get("gyroscope"), size, "rad/s")
    if whole.magnetometer is not None:
        lines += [
            "",
            *magnetometer_lines(
                whole.magnetometer, together=whole.together is not None
            ),
        ]
        lines.append(_noise_line(whole.compass_noise))
        size = np.linalg.norm(whole.magnetometer.M, axis=0)
        own = whole.thermal.get("magnetometer")
        lines += _term_lines(own, size, "of the field's unit")
        lines += [f"{'':18s}{each}" for each in whole.thermal_reasons[1:]]
    for name, why in whole.left_out.items():
        lines += ["", f"left out          the {name}: {why}"]
    _, said = honest(conditions(whole))
    return [*lines, "", f"honest bars       {said}"]


def log_object(log: Log) -> dict[str, Any]:
    """Return what was taken of a log and at what rate, as plain JSON values."""
    taken = {each.role: [each.place + 1, each.name] for each in log.columns}
    return {
        "source": [list(each) for each in log.source],
        "columns": taken,
        "rate": log.rate,
        "clock_unit_seconds": log.second,
    }


def as_object(whole: Any) -> dict[str, Any]:
    """Return the accelerometer as one JSON object; a calibration file and more."""
    result = whole.log
    diagnosis = result.diagnosis
    known = not np.isnan(diagnosis.chi2_per_dof)
    white = result.white_chi2_per_dof
    return to_json(whole.accelerometer) | {
        "intervals": len(result.intervals),
        "interval_samples": result.intervals.tolist(),
        "multiplier": result.multiplier,
        "rest_seconds": result.rest_seconds,
        "rest_found": result.rest.found,
        "chi2_per_dof": diagnosis.chi2_per_dof if known else None,
        "p_value": diagnosis.p_value if known else None,
        "white_chi2_per_dof": None if np.isnan(white) else white,
        "pose_noise": result.pose_noise.source,
        "pose_noise_std": result.pose_noise.std.tolist(),
        "pose_noise_white_std": result.pose_noise.white.tolist(),
        "verdict": diagnosis.verdict,
        "least_determined": diagnosis.least_determined.sentence,
        "outliers": list(diagnosis.outliers),
        "next_direction": result.next_direction.tolist(),
        "bound_sd": None if result.predicted is None else bound_sd(result).tolist(),
        "bias": None if result.predicted is None else result.predicted.bias.tolist(),
    }


def sensors_object(whole: Any, log: Log) -> dict[str, Any]:
    """The sensors after the accelerometer, and the conditions of all error bars."""
    units = {name: each.as_object() for name, each in whole.units.items()}
    values: dict[str, Any] = {"left_out": dict(whole.left_out), "units": units}
    seen = whole.log.warm.rests
    if seen is not None:
        values["temperature"] = {
            "rests_degC": seen.mean.tolist(),
            "change_within_rest_K": seen.change.tolist(),
            "reasons": list(whole.thermal_reasons),
            "confounded_with_time": seen.monotone,
            "sensors": {name: own.as_object() for name, own in whole.thermal.items()},
        }
    if whole.gyroscope is not None:
        values["gyroscope"] = whole.gyroscope.as_object() | {
            "G": whole.sensitivity.tolist(),
            "G_sd": whole.sensitivity_sd.tolist(),
            "reasons": list(whole.reasons),
            "residuals": whole.gyroscope.noise.as_object(),
        }
    if whole.magnetometer is not None:
        values["magnetometer"] = _magnetometer_object(whole.magnetometer)
        noise = whole.compass_noise
        values["magnetometer"] |= {
            "pose_noise": noise.source,
            "pose_noise_std": noise.std.tolist(),
            "pose_noise_white_std": noise.white.tolist(),
            "residuals": whole.magnetometer.noise.as_object(),
        }
    if whole.together is not None:
        values["together"] = whole.together.as_object()
    values["judgements"] = [each.as_object() for each in conditions(whole)]
    values["ros_imu"] = message_covariances(log, whole)
    return values


def _magnetometer_object(fit: MagnetometerFit) -> dict[str, Any]:
    # without the accelerometer, which the file states once
    document, first = fit.as_document(), len(fit.names) - len(OWN_NAMES)
    return document | {
        "parameters": {name: document["parameters"][name] for name in OWN_NAMES},
        "names": list(OWN_NAMES),
        "covariance": fit.covariance[first:, first:].tolist(),
    }


def message_covariances(log: Log, whole: Any) -> dict[str, Any]:
    """Fields of a message: nine numbers each; -1 first where nothing is known."""
    unknown = [-1.0] + [0.0] * 8
    rests = whole.log.intervals
    force = whole.accelerometer.sensor().matrix
    rate = unknown
    if whole.gyroscope is not None and log.gyro is not None:
        rate = _covariance(log.gyro, rests, whole.gyroscope.M)
    return {
        "orientation_covariance": unknown,
        "angular_velocity_covariance": rate,
        "linear_acceleration_covariance": _covariance(log.accelerometer, rests, force),
    }


def _covariance(
    samples: Float[Array, "n 3"], rests: Intervals, M: Float[Array, "3 3"]
) -> list[float]:
    return (M * variance_within(samples, rests) @ M.T).ravel().tolist()
