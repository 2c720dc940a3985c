"""The EKF of imumaster over a quaternion, without a gyroscope bias.

It learns the field's dip from each reading, and lets the accelerometer leave the last,
the magnetometer the second and third number of the quaternion as they are.
"""

import numpy as np
from adapting import needed
from quaternions import of_quaternion

from simval.plugins import Filter

with needed():
    from imumaster.filters.EKF import EKF_AHRS


def _stepped(own):
    def update(dt, gyroscope, accelerometer, magnetometer):
        own.dt = dt
        return own.ekf_update(accelerometer, gyroscope, magnetometer).ravel().copy()

    return update


def _ekf(start, rate):
    return _stepped(EKF_AHRS(sample_rate=rate, frame="NED", q0=start))


def _ekf_told(start, rate, start_std, gravity, field, **noise):
    own = EKF_AHRS(
        sample_rate=rate,
        frame="NED",
        q0=start,
        P=of_quaternion(start, start_std**2 * np.eye(3)),
        Q_noise=noise["gyroscope_noise"] ** 2 / rate / 4.0 * np.eye(4),
        accel_noise=(noise["accelerometer_noise"] / gravity) ** 2 * np.eye(3),
        mag_noise=(noise["magnetometer_noise"] / np.linalg.norm(field)) ** 2
        * np.eye(3),
    )
    return _stepped(own)


OWN = {"components": "sxyz", "matrix": "passive", "world": "NED"}
NOISE = ("start_std", "gravity", "field", "gyroscope_noise", "accelerometer_noise",
         "magnetometer_noise")  # fmt: skip
ekf = Filter(name="EKF", make=_ekf, reads=("start", "rate"), **OWN)
ekf_told = Filter(
    name="EKF told", make=_ekf_told, reads=("start", "rate", *NOISE), **OWN
)
