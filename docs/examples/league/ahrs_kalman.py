"""The Kalman filters of ahrs: EKF and UKF over a quaternion, without a gyroscope bias.

Told the truth they get variances: of the rate per row, N^2 / h, and of the vectors,
which have length 1, relative to gravity and field. Their process noise and start are
matrices of the quaternion's four numbers, and so is their covariance; what is answered
is that of the rotation vector. Both have gravity for the vertical, (0, 0, 1) in NED.
"""

import numpy as np
from adapting import needed
from quaternions import of_quaternion, of_rotation

from simval.plugins import Filter

with needed():
    from ahrs import filters


def _stepped(kalman, q):
    """Keep the quaternion between rows."""

    def update(dt, gyroscope, accelerometer, magnetometer):
        nonlocal q
        a = accelerometer / np.linalg.norm(accelerometer)
        m = magnetometer / np.linalg.norm(magnetometer)
        q = np.asarray(kalman.update(q, gyroscope, a, m, dt))
        return q, of_rotation(q, kalman.P)

    return update


def _nine_axes(ekf):
    # its `update` expects the magnetometer's reading only where this is set
    ekf.mag = np.zeros(3)
    return ekf


def _ekf(start, rate, field):
    ekf = filters.EKF(frequency=rate, magnetic_ref=field)
    return _stepped(_nine_axes(ekf), start)


def _ekf_told(start, rate, field, start_std, gravity, **noise):
    ekf = filters.EKF(
        frequency=rate,
        magnetic_ref=field,
        var_gyr=noise["gyroscope_noise"] ** 2 * rate,
        var_acc=(noise["accelerometer_noise"] / gravity) ** 2,
        var_mag=(noise["magnetometer_noise"] / np.linalg.norm(field)) ** 2,
        P=of_quaternion(start, start_std**2 * np.eye(3)),
    )
    return _stepped(_nine_axes(ekf), start)


def _placed(ukf, field):
    # its constructor has no word for the field, and takes Munich's
    ukf.m_ref = field / np.linalg.norm(field)
    return ukf


def _ukf(start, rate, field):
    return _stepped(_placed(filters.UKF(frequency=rate), field), start)


def _ukf_told(start, rate, field, start_std, gravity, **noise):
    # of a turn by N sqrt(h); the same matrix R serves both vectors: their mean
    walk = noise["gyroscope_noise"] ** 2 / rate / 4.0
    variances = (
        (noise["accelerometer_noise"] / gravity) ** 2,
        (noise["magnetometer_noise"] / np.linalg.norm(field)) ** 2,
    )
    ukf = filters.UKF(
        frequency=rate,
        P=start_std**2 / 4.0 * np.eye(4),
        process_noise_covariance=walk * np.eye(4),
        measurement_noise_covariance=np.mean(variances) * np.eye(3),
    )
    return _stepped(_placed(ukf, field), start)


QUATERNION = {"components": "sxyz", "matrix": "passive"}
PLACE = ("start", "rate", "field")
NOISE = ("start_std", "gravity", "gyroscope_noise", "accelerometer_noise",
         "magnetometer_noise")  # fmt: skip
OWN = {**QUATERNION, "world": "NED", "accelerometer": "gravity"}

ekf = Filter(name="EKF", make=_ekf, reads=PLACE, **OWN)
ekf_told = Filter(name="EKF told", make=_ekf_told, reads=PLACE + NOISE, **OWN)
ukf = Filter(name="UKF", make=_ukf, reads=PLACE, **OWN)
ukf_told = Filter(name="UKF told", make=_ukf_told, reads=PLACE + NOISE, **OWN)
