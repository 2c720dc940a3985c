"""Calibration of a gyroscope, alone or with the accelerometer, between rests."""

from simval.imu.calibrate.gyroscope.calibration import calibrate_gyroscope
from simval.imu.calibrate.gyroscope.imu import ImuFit, calibrate_imu
from simval.imu.calibrate.gyroscope.path_statistics import (
    InterRestRotations,
    Moves,
    inter_rest_rotations,
    moves_between,
)
from simval.imu.calibrate.gyroscope.result import GyroscopeFit

__all__ = [
    "GyroscopeFit",
    "ImuFit",
    "InterRestRotations",
    "Moves",
    "calibrate_gyroscope",
    "calibrate_imu",
    "inter_rest_rotations",
    "moves_between",
]
