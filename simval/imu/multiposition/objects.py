"""A log and its calibration as plain JSON values."""

from typing import Any

import numpy as np

from simval.imu.calibrate import MagnetometerFit
from simval.imu.calibrate.files import to_json
from simval.imu.calibrate.magnetometer.result import OWN_NAMES
from simval.imu.logs import Log
from simval.imu.multiposition import (
    ImuCalibration,
)
from simval.imu.multiposition.description import bound_sd, judgements


def log_object(log: Log) -> dict[str, Any]:
    """Return which columns were taken and at what rate, as plain JSON values."""
    taken = {each.role: [each.place + 1, each.name] for each in log.columns}
    return {"columns": taken, "rate": log.rate, "clock_unit_seconds": log.second}


def as_object(whole: ImuCalibration) -> dict[str, Any]:
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
        "outliers": list(diagnosis.outliers),
        "next_direction": result.next_direction.tolist(),
        "bound_sd": None if result.predicted is None else bound_sd(result).tolist(),
        "bias": None if result.predicted is None else result.predicted.bias.tolist(),
    }


def sensors_object(whole: ImuCalibration, log: Log) -> dict[str, Any]:
    """The sensors beside the accelerometer, and what is asked of all error bars."""
    from simval.imu.multiposition.imu import message_covariances

    values: dict[str, Any] = {"left_out": dict(whole.left_out)}
    if whole.gyroscope is not None:
        values["gyroscope"] = whole.gyroscope.as_object() | {
            "G": whole.sensitivity.tolist(),
            "G_sd": whole.sensitivity_sd.tolist(),
            "reasons": list(whole.reasons),
        }
    if whole.magnetometer is not None:
        values["magnetometer"] = _own(whole.magnetometer) | noise_object(whole)
    if whole.together is not None:
        values["together"] = whole.together.as_object()
    values["judgements"] = [each.as_object() for each in judgements(whole)]
    values["ros_imu"] = message_covariances(log, whole)
    return values


def _own(fit: MagnetometerFit) -> dict[str, Any]:
    # without the accelerometer, which the file states once
    document, first = fit.as_document(), len(fit.names) - len(OWN_NAMES)
    return document | {
        "parameters": {name: document["parameters"][name] for name in OWN_NAMES},
        "names": list(OWN_NAMES),
        "covariance": fit.covariance[first:, first:].tolist(),
    }


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
