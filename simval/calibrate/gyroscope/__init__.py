"""Calibration of a gyroscope, and of both sensors together, from moves between rests."""

from simval.calibrate.gyroscope.calibration import calibrate_gyroscope
from simval.calibrate.gyroscope.moves import Moves, moves_between
from simval.calibrate.gyroscope.result import GyroscopeFit, ImuFit

__all__ = [
    "GyroscopeFit",
    "ImuFit",
    "Moves",
    "calibrate_gyroscope",
    "moves_between",
]
