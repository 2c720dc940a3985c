"""Multi-position calibration: from a user's log to a calibration with error bars.

The log shows a sensor that is held still in many poses. The way of a calibration, which
`calibration` writes down from top to bottom:

    log -> rests -> poses (their means) -> fit -> health -> answer

`rests` finds the rests, `faults` looks for what a broken sensor, cable or
logger leaves in them, and `health` decides whether the fit may be given out.
"""

from simval.imu.multiposition.calibration import LogCalibration, calibrate_log
from simval.imu.multiposition.imu import ImuCalibration, calibrate_sensors

__all__ = ["ImuCalibration", "LogCalibration", "calibrate_log", "calibrate_sensors"]
