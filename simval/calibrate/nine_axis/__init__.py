"""Calibration of accelerometer, gyroscope and magnetometer in one fit."""

from typing import TYPE_CHECKING

from simval.faces import present

if TYPE_CHECKING:
    from simval.calibrate.nine_axis.calibration import calibrate_nine_axis
    from simval.calibrate.nine_axis.result import NineAxisFit
else:
    present(__name__, __file__)

__all__ = ["NineAxisFit", "calibrate_nine_axis"]
