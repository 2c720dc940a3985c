"""Calibration of an accelerometer from its readings at rest."""

from simval.calibrate.diagnosis import Diagnosis, diagnose
from simval.calibrate.files import load_calibration, save_calibration
from simval.calibrate.fit import calibrate
from simval.calibrate.result import FitResult

__all__ = [
    "Diagnosis",
    "FitResult",
    "calibrate",
    "diagnose",
    "load_calibration",
    "save_calibration",
]
