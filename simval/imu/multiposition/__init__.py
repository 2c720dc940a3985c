"""Multi-position calibration: from a user's log to parameters with error bars.

The log shows a sensor that is held still in many poses. Its way, from top to bottom:

    `simval.imu.logs`     file -> columns, clock -> `Log`
    `rests`               -> rests, by `simval.imu.statics`; their means are the poses
    `ranges`              readings at the end of a range, axes of different units
    `noise`               -> noise of the pose means
    `calibration`         -> fit of the accelerometer, then of all sensors together
    `faults`              causes for which a fit is not given out, and of a refusal
    `description`         -> text and files
    `correction`          a log by such a file

`log_units` and `noise_description` serve the measurement of a log's noise.
"""

from simval.imu.multiposition.calibration import (
    LogCalibration,
    calibrate_log,
    calibrate_sensors,
)

__all__ = ["LogCalibration", "calibrate_log", "calibrate_sensors"]
