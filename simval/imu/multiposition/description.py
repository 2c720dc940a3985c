"""The text of a log's calibration, and how surely its findings are told.

**What is asked of the error bars of a log's calibration, each with its test.**

Every sentence that says yes or no of them, in the terminal, in files and on the page,
is one of these: no where the chance of what is seen is below the level of its test.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.imu.calibrate.diagnosis import drift_words
from simval.imu.calibrate.drift import DRIFT_FALSE_ALARM, Drift
from simval.imu.calibrate.estimate import (
    gyroscope_lines,
    magnetometer_lines,
    matrix_lines,
    parameter_lines,
    residual_line,
    status_line,
)
from simval.imu.calibrate.factors import CHANCE, NoiseFactors
from simval.imu.calibrate.magnetometer.findings import FALSE_ALARM as ONE_POSE
from simval.imu.calibrate.outliers import BELIEVED, BEYOND, chi_square_chance
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
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
        return {
            "about": self.about,
            "holds": self.holds,
            "p_value": self.p_value if known else None,
            "level": self.level,
            "words": self.words,
        }


def judgements(whole: Any) -> tuple[Judgement, ...]:
    """Judge the sensors of a log, the accelerometer first."""
    found = [
        _outliers(whole.log),
        _scatter(whole.log),
        _drift("accelerometer", whole.log.diagnosis.drift),
    ]
    gyroscope, compass = whole.gyroscope, whole.magnetometer
    if gyroscope is not None:
        judged = gyroscope.noise.sources
        found.append(_joint(gyroscope.noise) if judged else _rows(gyroscope))
        if gyroscope.drift is not None:
            found.append(_drift("gyroscope", gyroscope.drift))
    if compass is not None:
        if whole.together is None and compass.noise.sources:
            found.append(_joint(compass.noise))
        found += [poses_alike(compass), steady(compass)]
    return tuple(found)


def honest(found: tuple[Judgement, ...]) -> tuple[bool | None, str]:
    """Say whether the error bars are honest, with the gravest answer."""
    for answer, begin in ((False, "No: "), (None, "Not told: ")):
        said = [each.words for each in found if each.holds is answer]
        if said:
            return answer, begin + said[0]
    said = [each.words for each in found if np.isfinite(each.p_value)]
    return True, f"Yes: {said[0]}"


def _outliers(log: Any) -> Judgement:
    named = log.diagnosis.outliers
    count = len(named)
    return Judgement(
        about="poses of the accelerometer",
        holds=not named,
        p_value=float("nan"),
        level=BELIEVED,
        words=f"{count} outlier{'s' * (count > 1)} among the poses"
        if named
        else "no pose is off the ellipsoid of the others",
    )


def _scatter(log: Any) -> Judgement:
    found = log.diagnosis
    p = found.p_value
    seen = f"chi-square per degree of freedom {found.chi2_per_dof:.3g}"
    words = f"the residuals are what the noise explains: {seen}"
    if not np.isfinite(p):
        words = "the noise of a pose, or a degree of freedom, is not there"
    elif p < BELIEVED:
        words = f"the residuals are greater than the noise: {seen}"
    elif p > 1.0 - BELIEVED:
        words = f"the residuals are smaller than the noise: {seen}"
    return _by_chance(
        "residuals of the accelerometer",
        2.0 * min(p, 1.0 - p) if np.isfinite(p) else p,
        2.0 * BELIEVED,
        words,
    )


def _drift(name: str, found: Drift) -> Judgement:
    hidden = not (found.seen or found.excluded)
    words = f"the residuals of the {name} do not follow the time"
    if found.seen:
        words = f"the {name} drifts: its residuals follow the time by {found.what}"
    elif not np.isfinite(found.p_value):
        words = f"too few poses to tell a drift of the {name}"
    elif hidden:
        words = f"the order of the poses hides a drift of {found.hides} of the {name}"
    told = _by_chance(f"drift of the {name}", found.p_value, DRIFT_FALSE_ALARM, words)
    return replace(told, holds=None) if hidden else told


def _joint(noise: NoiseFactors) -> Judgement:
    names = " and ".join(noise.sources)
    return _by_chance(
        f"joint fit of {names}",
        noise.p_value,
        CHANCE,
        "; ".join(noise.sentences) or "every sensor bears its stated noise",
    )


def _rows(fit: Any) -> Judgement:
    # of a fit whose sensors were not judged one by one
    p = chi_square_chance(float(fit.chi2_per_dof) * fit.dof, fit.dof)
    words = f"chi-square per degree of freedom {float(fit.chi2_per_dof):.3g}"
    return _by_chance("moves of the gyroscope", p, BEYOND, words)


def poses_alike(fit: Any) -> Judgement:
    """Judge whether the field is the same in every pose, as far as noise tells."""
    p = chi_square_chance(float(fit.chi_square), fit.dof)
    mean = f"chi-square {np.nanmean(fit.pose_chi_square):.2g} a pose, of about 3"
    words = f"the field is that of its noise in every pose: {mean}"
    if fit.disturbed:
        named = ", ".join(str(k) for k in fit.disturbed)
        words = f"the field is another in static interval {named}"
    elif p < BEYOND:
        words = f"the field differs from pose to pose by more than its noise: {mean}"
    told = _by_chance("poses of the magnetometer", p, BEYOND, words)
    return replace(told, holds=False) if fit.disturbed else told


def steady(fit: Any) -> Judgement:
    """Judge whether the strength of the field changes with time."""
    p = float(fit.steady_p_value)
    words = "the strength of the field varies with time" if p < ONE_POSE else ""
    return _by_chance(
        "field over time", p, ONE_POSE, words or "the field does not follow the time"
    )


def _by_chance(about: str, p: float, level: float, words: str) -> Judgement:
    holds = bool(p >= level) if np.isfinite(p) else None
    return Judgement(about=about, holds=holds, p_value=p, level=level, words=words)


def log_lines(result: Any, whole: Any = None) -> list[str]:
    """Describe the result in lines of text, with the numbers of the fit of all."""
    diagnosis = result.diagnosis
    fit = result.fit if whole is None else whole.accelerometer
    joint = "" if whole is None else fit_of(whole)
    how = "found" if result.rest.found else "given"
    lines = [
        f"initial rest      {result.rest_seconds:.2f} s ({how})",
        f"static intervals  {len(result.intervals)} "
        f"(threshold {result.multiplier:g} times the rest's variance)",
        *(f"{'':18s}{cut}" for cut in result.cuts),
        status_line(fit),
        "",
        *([f"accelerometer     {joint}"] if joint else []),
        *parameter_lines(fit, bound_sd(result)),
        "",
        *matrix_lines(fit),
        "",
        residual_line(fit),
        f"chi2 per dof      {diagnosis.chi2_per_dof:.3g} with {fit.dof} degrees of "
        "freedom",
        *_noise_lines(result),
        f"verdict           {diagnosis.verdict}",
        f"drift             {drift_words(diagnosis.drift)}",
        f"bound             least sd that {_noise(result)} would allow with these "
        f"poses{', without the moves' * bool(joint)} (Cramer-Rao)",
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
            f"outlier           interval {pose} (samples {start} to {stop - 1}): "
            f"{diagnosis.standardized[pose]:.1f} standard deviations off; look at it, "
            "or use --loss cauchy"
        )
    return lines


def bound_sd(result: Any) -> Float[Array, "9"]:
    """Square root of the Cramer-Rao bound on each variance; NaN if not known."""
    if result.predicted is None:
        return np.full(9, np.nan)
    return np.sqrt(np.diagonal(result.predicted.cramer_rao))


def _noise(result: Any) -> str:
    white = result.pose_noise.source == "white"
    return "white noise alone" if white else "the noise of the poses"


def _noise_lines(result: Any) -> list[str]:
    # which noise the chi-square and the bound take, and what white noise would give
    noise = result.pose_noise
    lines = [f"noise of a pose   {np.median(noise.std):.4g} raw units, {noise.words}"]
    if noise.source != "white":
        lines.append(
            f"                  white noise alone, {np.median(noise.white):.4g}, would "
            f"leave a chi2 per dof of {result.white_chi2_per_dof:.3g}"
        )
    return lines


def fit_of(whole: Any) -> str:
    """The fit that the accelerometer's numbers are from, if not its own."""
    if whole.together is not None:
        return "one fit of all three sensors, in which the moves help the others"
    if whole.gyroscope is not None:
        return "fit together with the gyroscope, whose moves help it"
    return ""


def sensor_lines(whole: Any) -> list[str]:
    """Describe the other sensors, what was left out, and whether to trust the bars."""
    lines: list[str] = []
    if whole.gyroscope is not None:
        others = "accelerometer"
        if whole.together is not None:
            others += " and the magnetometer"
        lines += ["", *_gyroscope_lines(whole, others)]
        lines += [f"{'':18s}{reason}" for reason in whole.reasons]
    if whole.magnetometer is not None:
        lines += [
            "",
            *magnetometer_lines(
                whole.magnetometer, together=whole.together is not None
            ),
        ]
        lines += noise_lines(whole)
    for name, why in whole.left_out.items():
        lines += ["", f"left out          the {name}: {why}"]
    _, said = honest(judgements(whole))
    return [*lines, "", f"honest bars       {said}"]


def _gyroscope_lines(whole: Any, others: str) -> list[str]:
    return gyroscope_lines(
        whole.gyroscope, others, whole.sensitivity, whole.sensitivity_sd
    )


def noise_lines(whole: Any) -> list[str]:
    """Say which noise the magnetometer's error bars are by."""
    noise = whole.compass_noise
    if noise is None:
        return []
    return [f"noise of a pose   {np.median(noise.std):.4g} raw units, {noise.words}"]
