"""Predictions: what the errors must be. Imports nothing that it predicts."""

from simval.theory.attitude import AttitudeMoments, attitude_moments
from simval.theory.calibration import CalibrationMoments, calibration_moments

__all__ = [
    "AttitudeMoments",
    "CalibrationMoments",
    "attitude_moments",
    "calibration_moments",
]
