"""Calibration of a magnetometer in the axes of the accelerometer mounted with it."""

from simval.imu.calibrate.magnetometer.calibration import fit_magnetometer
from simval.imu.calibrate.magnetometer.result import MagnetometerFit
from simval.imu.calibrate.magnetometer.start import ellipsoid_then_rotation

__all__ = ["MagnetometerFit", "ellipsoid_then_rotation", "fit_magnetometer"]
