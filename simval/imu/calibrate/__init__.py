"""Calibration of an accelerometer, a gyroscope and a magnetometer, from rests."""

from simval.imu.calibrate.accelerometer import calibrate
from simval.imu.calibrate.diagnosis import Diagnosis, diagnose
from simval.imu.calibrate.files import load_calibration, save_calibration
from simval.imu.calibrate.gyroscope import (
    GyroscopeFit,
    ImuFit,
    InterRestRotations,
    calibrate_gyroscope,
    calibrate_imu,
    inter_rest_rotations,
)
from simval.imu.calibrate.magnetometer import (
    MagnetometerFit,
    calibrate_magnetometer,
    ellipsoid_then_rotation,
)
from simval.imu.calibrate.nine_axis import NineAxisFit, calibrate_nine_axis
from simval.imu.calibrate.result import FitResult

__all__ = [
    "Diagnosis",
    "FitResult",
    "GyroscopeFit",
    "ImuFit",
    "InterRestRotations",
    "MagnetometerFit",
    "NineAxisFit",
    "calibrate",
    "calibrate_gyroscope",
    "calibrate_imu",
    "calibrate_magnetometer",
    "calibrate_nine_axis",
    "diagnose",
    "ellipsoid_then_rotation",
    "inter_rest_rotations",
    "load_calibration",
    "save_calibration",
]
