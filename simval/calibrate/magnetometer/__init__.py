"""Calibration of a magnetometer on the axes of the accelerometer beside it."""

from simval.calibrate.magnetometer.fit import calibrate_magnetometer
from simval.calibrate.magnetometer.recipe import ellipsoid_then_rotation
from simval.calibrate.magnetometer.result import MagnetometerFit

__all__ = ["MagnetometerFit", "calibrate_magnetometer", "ellipsoid_then_rotation"]
