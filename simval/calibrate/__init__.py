"""Calibration of an accelerometer, a gyroscope and a magnetometer, from rests.

The package can be called: ``from simval import calibrate`` gives the function, or,
once anything has imported this package, the package itself under the same name, and
both do the same.
"""

import inspect
import sys
from typing import TYPE_CHECKING, Any

from simval.faces import Face, present

if TYPE_CHECKING:
    from simval.calibrate.diagnosis import Diagnosis, diagnose
    from simval.calibrate.files import load_calibration, save_calibration
    from simval.calibrate.fit import calibrate
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
else:
    present(__name__, __file__)

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


class _CallableFace(Face):
    # the import system binds a subpackage to its name in the parent, over whatever
    # the parent offers under it
    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return self.calibrate(*arguments, **options)

    @property
    def __signature__(self) -> inspect.Signature:
        return inspect.signature(self.calibrate)

    @property
    def __doc__(self) -> str:  # type: ignore[override]
        return f"{vars(self)['__doc__']}\n{inspect.getdoc(self.calibrate)}\n"


sys.modules[__name__].__class__ = _CallableFace
