"""Calibration of accelerometer, gyroscope and magnetometer in one fit."""

from simval.calibrate.nine_axis.calibration import calibrate_nine_axis
from simval.calibrate.nine_axis.result import NineAxisFit

__all__ = ["NineAxisFit", "calibrate_nine_axis"]
