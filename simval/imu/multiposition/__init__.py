"""Multi-position calibration: from a user's log to a calibration with error bars.

The log shows a sensor that is held still in many poses; `calibration` goes

    log -> rests -> poses (their means) -> fit -> faults -> answer

from top to bottom. `noise` measures the noise of a log and of its poses, and
`description` says all of it in text and in files.
"""

from simval.imu.multiposition.calibration import (
    ImuCalibration,
    LogCalibration,
    calibrate_log,
    calibrate_sensors,
)

__all__ = ["ImuCalibration", "LogCalibration", "calibrate_log", "calibrate_sensors"]
