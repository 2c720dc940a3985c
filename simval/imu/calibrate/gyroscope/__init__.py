"""Calibration of a gyroscope, alone or with the accelerometer, between rests."""

from simval.imu.calibrate.gyroscope.calibration import fit_gyroscope
from simval.imu.calibrate.gyroscope.result import GyroscopeFit

__all__ = ["GyroscopeFit", "fit_gyroscope"]
