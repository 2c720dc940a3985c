"""A gyroscope and a magnetometer of a log, in lines of text and as JSON values."""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate import FitResult, GyroscopeFit, MagnetometerFit, NineAxisFit
from simval.calibrate.files import to_json
from simval.logs import Log
from simval.multiposition import ImuCalibration
from simval.multiposition.rates import message_covariances
from simval.sensor import forms
from simval.shapes import Float

KNOWN_UNITS = (
    (1.0, "rad/s"),
    (np.pi / 180.0, "deg/s"),
    (np.pi / 180.0e3, "mdeg/s"),
    (np.pi / 30.0, "rev/min"),
)
NEAR = 1.2  # ratio of a scale to a unit's within which the readings are in that unit


def sensors_object(whole: ImuCalibration, log: Log) -> dict[str, Any]:
    """Every sensor as plain JSON values, the accelerometer as the joint fit has it."""
    values: dict[str, Any] = {"left_out": dict(whole.left_out)}
    if whole.gyroscope is not None:
        joint = to_json(whole.accelerometer)
        values |= {k: v for k, v in joint.items() if k not in ("rms", "status")}
        values["gyroscope"] = whole.gyroscope.as_object() | {
            "G": whole.sensitivity.tolist(),
            "reasons": list(whole.reasons),
        }
    if whole.magnetometer is not None:
        values["magnetometer"] = whole.magnetometer.as_document() | noise_object(whole)
    if whole.together is not None:
        values["together"] = whole.together.as_object()
    values["ros_imu"] = message_covariances(log, whole)
    return values


def sensor_lines(whole: ImuCalibration) -> list[str]:
    """Describe the other sensors, and what was left out."""
    lines: list[str] = []
    if whole.together is not None:
        lines += ["", *accelerometer_lines(whole.accelerometer)]
    if whole.gyroscope is not None:
        others = "accelerometer"
        if whole.together is not None:
            others += " and the magnetometer"
        lines += ["", *gyroscope_lines(whole.gyroscope, whole.sensitivity, others)]
        lines += [f"{'':18s}{reason}" for reason in whole.reasons]
    if whole.magnetometer is not None:
        lines += ["", *magnetometer_lines(whole.magnetometer, whole.together)]
        lines += noise_lines(whole)
    for name, why in whole.left_out.items():
        lines += ["", f"left out          the {name}: {why}"]
    return lines


def noise_object(whole: ImuCalibration) -> dict[str, Any]:
    """Noise of the magnetometer's pose means as plain JSON values."""
    noise = whole.compass_noise
    if noise is None:
        return {}
    return {
        "pose_noise": noise.source,
        "pose_noise_std": noise.std.tolist(),
        "pose_noise_white_std": noise.white.tolist(),
    }


def noise_lines(whole: ImuCalibration) -> list[str]:
    """Say which noise the magnetometer's error bars are by."""
    noise = whole.compass_noise
    if noise is None:
        return []
    return [f"noise of a pose   {np.median(noise.std):.4g} raw units, {noise.words}"]


def accelerometer_lines(fit: FitResult) -> list[str]:
    """T, K and B as the one fit of three sensors has them."""
    lines = [
        "together          accelerometer, gyroscope and magnetometer in one fit, whose "
        "numbers all files have;",
        f"                  above is the accelerometer alone, here its {fit.model} "
        "form in the fit of all",
        "                  value           sd   95 % interval",
    ]
    columns = (fit.parameters, fit.sd, fit.intervals)
    for (name, sign), value, sd, ends in zip(
        forms.entries(fit.model), *columns, strict=True
    ):
        low, high = sorted(sign * ends)
        lines.append(
            f"  {name:7s} {sign * value:15.8g} {sd:12.3g}   {low:.8g} to {high:.8g}"
        )
    return lines


def gyroscope_lines(fit: GyroscopeFit, sensitivity: Array, others: str) -> list[str]:
    """M, B and G with their error bars."""
    wide = fit.chi2_per_dof > 1.0
    sd = fit.sd_from_residuals if wide else fit.sd
    said = "as wide as the residuals ask" if wide else "by the noise"
    lines = [
        f"gyroscope         rate = M (reading - B{_force_term(sensitivity)}), axes of "
        f"the accelerometer's {fit.model} form, rad/s; readings "
        f"{_unit(fit.M)}",
        f"                  fitted together with the {others}; chi2 per dof "
        f"{float(fit.chi2_per_dof):.3g} with {fit.dof}, error bars {said}",
        "                  value           sd",
    ]
    lines += _values(fit.names, fit.parameters, sd)
    if np.any(sensitivity):
        lines.append("  G, raw units per m/s^2:")
        lines += [
            "  ".join(["  ", *(f"{x:12.5g}" for x in row)]) for row in sensitivity
        ]
    return lines


def magnetometer_lines(fit: MagnetometerFit, together: NineAxisFit | None) -> list[str]:
    """M, b and the dip with their error bars, and the findings."""
    others, chi2 = "accelerometer", "chi2 per dof"
    if together is not None:  # poses are judged without the moves
        others, chi2 = "accelerometer and the gyroscope", "chi2 per dof of its poses"
    lines = [
        f"magnetometer      field = M (reading - b), axes of the accelerometer's "
        f"{fit.model} form, of a field of {fit.field:g}",
        f"                  fitted together with the {others}; {chi2} "
        f"{float(fit.chi2_per_dof):.3g} with {fit.dof}; {fit.assumption}",
        "                  value           sd",
    ]
    own = slice(9, 21)
    lines += _values(fit.names[own], fit.parameters[own], fit.sd[own])
    lines.append(
        f"  dip     {np.degrees(fit.dip):15.6f} {np.degrees(fit.sd[-1]):12.3g}   "
        "degrees below the horizon"
    )
    lines += [f"finding           {each}" for each in fit.findings]
    return lines


def _values(names: tuple[str, ...], values: Array, sd: Array) -> list[str]:
    return [
        f"  {name:7s} {value:15.8g} {error:12.3g}"
        for name, value, error in zip(names, values, sd, strict=True)
    ]


def _force_term(sensitivity: Array) -> str:
    return " - G f" if np.any(sensitivity) else ""


def _unit(M: Float[Array, "3 3"]) -> str:
    scale = float(np.cbrt(abs(np.linalg.det(M))))
    for size, name in KNOWN_UNITS:
        if 1.0 / NEAR < scale / size < NEAR:
            return f"are in {name} by their scale, {scale:.5g}"
    return f"are counts of {scale:.4g} rad/s"
