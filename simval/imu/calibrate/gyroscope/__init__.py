"""Calibration of a gyroscope, alone or with the accelerometer, between rests."""

from simval.imu.calibrate.gyroscope.calibration import calibrate_gyroscope
from simval.imu.calibrate.gyroscope.imu import ImuFit, calibrate_imu
from simval.imu.calibrate.gyroscope.path_statistics import (
    InterRestRotations,
    inter_rest_rotations,
)
from simval.imu.calibrate.gyroscope.result import GyroscopeFit

__all__ = [
    "GyroscopeFit",
    "ImuFit",
    "InterRestRotations",
    "calibrate_gyroscope",
    "calibrate_imu",
    "inter_rest_rotations",
]
