r"""Noise of single readings, in SI units and the axes of the calibration.

What ROS's ``sensor_msgs/Imu`` carries: with M the matrix of a sensor and
:math:`\sigma_k` the white noise of a reading on its axis k, the covariance of a
corrected reading is :math:`M\,\mathrm{diag}(\sigma^2)\,M^T`, row by row.
"""

from typing import Any

from simval.arrays import Array
from simval.calibrate.gyroscope.imu import variance_within
from simval.logs import Log
from simval.multiposition.imu import ImuCalibration
from simval.shapes import Float
from simval.statics import Intervals


def message_covariances(log: Log, whole: ImuCalibration) -> dict[str, Any]:
    """Fields of a message: nine numbers each; -1 first where nothing is known."""
    unknown = [-1.0] + [0.0] * 8
    rests = whole.log.intervals
    force = whole.accelerometer.sensor().matrix
    rate = unknown
    if whole.gyroscope is not None and log.gyro is not None:
        rate = _covariance(log.gyro, rests, whole.gyroscope.M)
    return {
        "orientation_covariance": unknown,
        "angular_velocity_covariance": rate,
        "linear_acceleration_covariance": _covariance(log.accelerometer, rests, force),
    }


def _covariance(
    samples: Float[Array, "n 3"], rests: Intervals, M: Float[Array, "3 3"]
) -> list[float]:
    return (M * variance_within(samples, rests) @ M.T).ravel().tolist()
