"""The text of a log's calibration: what `print` and `simval calibrate` say of it."""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate.diagnosis import drift_words
from simval.calibrate.estimate import (
    gyroscope_lines,
    magnetometer_lines,
    matrix_lines,
    parameter_lines,
    residual_line,
    status_line,
)
from simval.multiposition.judgements import honest, judgements
from simval.shapes import Float


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
