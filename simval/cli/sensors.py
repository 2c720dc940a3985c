"""A gyroscope and a magnetometer of a log as JSON values."""

from typing import Any

from simval.calibrate import MagnetometerFit
from simval.calibrate.magnetometer.result import OWN_NAMES
from simval.logs import Log
from simval.multiposition import ImuCalibration
from simval.multiposition.judgements import judgements


def sensors_object(whole: ImuCalibration, log: Log) -> dict[str, Any]:
    """The sensors beside the accelerometer, and what is asked of all error bars."""
    from simval.multiposition.rates import message_covariances

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
