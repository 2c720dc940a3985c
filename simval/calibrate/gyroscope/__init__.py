"""Calibration of a gyroscope, alone or with the accelerometer, between rests."""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.calibrate.gyroscope.calibration import calibrate_gyroscope
    from simval.calibrate.gyroscope.imu import calibrate_imu
    from simval.calibrate.gyroscope.moves import Moves, moves_between
    from simval.calibrate.gyroscope.pair import ImuFit
    from simval.calibrate.gyroscope.result import GyroscopeFit
else:
    present(__name__, __file__)

__all__ = [
    "GyroscopeFit",
    "ImuFit",
    "Moves",
    "calibrate_gyroscope",
    "calibrate_imu",
    "moves_between",
]
