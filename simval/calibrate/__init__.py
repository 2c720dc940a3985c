"""Calibration of an accelerometer, a gyroscope and a magnetometer, from rests.

The package can be called: ``from simval import calibrate`` gives the function, or,
once anything has imported this package, the package itself under the same name, and
both do the same.
"""

import inspect
import sys
from types import ModuleType
from typing import Any

from simval.calibrate.accelerometer import calibrate
from simval.calibrate.diagnosis import Diagnosis, diagnose
from simval.calibrate.files import load_calibration, save_calibration
from simval.calibrate.gyroscope import (
    GyroscopeFit,
    ImuFit,
    Moves,
    calibrate_gyroscope,
    calibrate_imu,
    moves_between,
)
from simval.calibrate.magnetometer import (
    MagnetometerFit,
    calibrate_magnetometer,
    ellipsoid_then_rotation,
)
from simval.calibrate.nine_axis import NineAxisFit, calibrate_nine_axis
from simval.calibrate.result import FitResult

__all__ = [
    "Diagnosis",
    "FitResult",
    "GyroscopeFit",
    "ImuFit",
    "MagnetometerFit",
    "Moves",
    "NineAxisFit",
    "calibrate",
    "calibrate_gyroscope",
    "calibrate_imu",
    "calibrate_magnetometer",
    "calibrate_nine_axis",
    "diagnose",
    "ellipsoid_then_rotation",
    "load_calibration",
    "moves_between",
    "save_calibration",
]


class _Callable(ModuleType):
    # the import system binds a subpackage to its name in the parent, over whatever
    # the parent offers under it
    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return calibrate(*arguments, **options)

    __signature__ = inspect.signature(calibrate)


__doc__ = f"{__doc__}\n{inspect.getdoc(calibrate)}\n"
sys.modules[__name__].__class__ = _Callable
