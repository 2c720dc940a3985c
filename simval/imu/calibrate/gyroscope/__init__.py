"""Calibration of a gyroscope, alone or with the accelerometer, between rests."""

from simval.imu.calibrate.gyroscope.calibration import calibrate_gyroscope
from simval.imu.calibrate.gyroscope.imu import ImuFit, calibrate_imu
from simval.imu.calibrate.gyroscope.path_statistics import Moves, moves_between
from simval.imu.calibrate.gyroscope.result import GyroscopeFit

__all__ = [
    "GyroscopeFit",
    "ImuFit",
    "Moves",
    "calibrate_gyroscope",
    "calibrate_imu",
    "moves_between",
]
