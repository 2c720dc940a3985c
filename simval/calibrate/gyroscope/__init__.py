"""Calibration of a gyroscope, alone or with the accelerometer, between rests."""

from simval.calibrate.gyroscope.calibration import calibrate_gyroscope
from simval.calibrate.gyroscope.imu import ImuFit, calibrate_imu
from simval.calibrate.gyroscope.moves import Moves, moves_between
from simval.calibrate.gyroscope.result import GyroscopeFit

__all__ = [
    "GyroscopeFit",
    "ImuFit",
    "Moves",
    "calibrate_gyroscope",
    "calibrate_imu",
    "moves_between",
]
