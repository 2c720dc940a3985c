"""Calibration of a magnetometer on the axes of the accelerometer beside it."""

from simval.imu.calibrate.magnetometer.calibration import calibrate_magnetometer
from simval.imu.calibrate.magnetometer.result import MagnetometerFit
from simval.imu.calibrate.magnetometer.start import ellipsoid_then_rotation

__all__ = ["MagnetometerFit", "calibrate_magnetometer", "ellipsoid_then_rotation"]
