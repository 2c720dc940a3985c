"""Calibration of an accelerometer from its readings at rest."""

from simval.calibrate.fit import calibrate
from simval.calibrate.result import FitResult

__all__ = ["FitResult", "calibrate"]
