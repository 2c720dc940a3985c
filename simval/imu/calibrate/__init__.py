"""Calibration of an accelerometer, a gyroscope and a magnetometer, from rests."""

from simval.imu.calibrate.accelerometer import calibrate
from simval.imu.calibrate.diagnosis import Diagnosis, diagnose
from simval.imu.calibrate.files import load_calibration, save_calibration
from simval.imu.calibrate.gravity import Gravity, local_gravity
from simval.imu.calibrate.gyroscope import GyroscopeFit
from simval.imu.calibrate.joint import Calibration, fit
from simval.imu.calibrate.magnetometer import MagnetometerFit, ellipsoid_then_rotation
from simval.imu.calibrate.path_statistics import (
    InterRestRotations,
    inter_rest_rotations,
)
from simval.imu.calibrate.recording import Recording
from simval.imu.calibrate.reduction import recording_of
from simval.imu.calibrate.result import FitResult

__all__ = [
    "Calibration",
    "Diagnosis",
    "FitResult",
    "Gravity",
    "GyroscopeFit",
    "InterRestRotations",
    "MagnetometerFit",
    "Recording",
    "calibrate",
    "diagnose",
    "ellipsoid_then_rotation",
    "fit",
    "inter_rest_rotations",
    "load_calibration",
    "local_gravity",
    "recording_of",
    "save_calibration",
]
