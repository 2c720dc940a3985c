"""Calibration of a magnetometer on the axes of the accelerometer beside it."""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.calibrate.magnetometer.fit import calibrate_magnetometer
    from simval.calibrate.magnetometer.recipe import ellipsoid_then_rotation
    from simval.calibrate.magnetometer.result import MagnetometerFit
else:
    present(__name__, __file__)

__all__ = ["MagnetometerFit", "calibrate_magnetometer", "ellipsoid_then_rotation"]
