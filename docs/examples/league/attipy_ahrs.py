"""The AHRS of attipy, a multiplicative Kalman filter with a gyroscope bias.

It takes the vertical from a velocity that stays near zero, and a heading, which is made
here of the magnetometer's reading, levelled by the filter's own attitude. A call goes
forward by the rate of the call before; the rate of a row is the average before its
vectors. So a row hands in the vectors of the row before with its own rate, and what is
answered is turned by that rate.
"""

import numpy as np
from adapting import heading_of, needed, turned

from simval.plugins import Filter

with needed():
    import attipy

HOURS = 1e4  # s: of a bias that walks, over any of these runs


def _stepped(own, heading_variance, **aiding):
    before, answer = None, own.q_nb

    def update(dt, gyroscope, accelerometer, magnetometer):
        nonlocal before, answer
        if before is None:  # nothing aids the start
            own.update(accelerometer, gyroscope, **aiding)
        else:
            force, field = before
            head = heading_of(answer, field)
            own.update(force, gyroscope, yaw=head, yaw_var=heading_variance, **aiding)
        before, answer = (accelerometer, magnetometer), turned(own.q_nb, dt * own.w_b)
        P = own.P[:6, :6]
        return {
            "attitude": answer,
            "bias": own.bg_b,
            "covariance": (P + P.T) / 2.0,
        }

    return update


def _heading_variance(field, magnetometer_noise):
    return float((magnetometer_noise / np.hypot(field[0], field[1])) ** 2)


def _ahrs(start, rate, gravity, field, magnetometer_noise):
    own = attipy.AHRS(rate, q_nb=start, g=gravity)
    return _stepped(own, _heading_variance(field, magnetometer_noise))


def _ahrs_told(start, rate, gravity, field, start_std, bias_std, **noise):
    own = attipy.AHRS(
        rate,
        q_nb=start,
        g=gravity,
        P=np.diag([start_std**2] * 3 + [bias_std**2] * 3 + [1e-12] * 3),
        acc_noise_density=noise["accelerometer_noise"] / np.sqrt(rate),
        gyro_noise_density=noise["gyroscope_noise"],
        gyro_bias_stability=noise["gyroscope_walk"] * np.sqrt(HOURS / 2.0),
        bias_corr_time=HOURS,
    )
    still = np.full(3, 1e-12)  # (m/s)^2: it stays where it is
    variance = _heading_variance(field, noise["magnetometer_noise"])
    return _stepped(own, variance, v_var=still)


OWN = {"components": "sxyz", "matrix": "passive", "world": "NED"}
READS = ("start", "rate", "gravity", "field", "magnetometer_noise")
NOISE = ("start_std", "bias_std", "gyroscope_noise", "gyroscope_walk",
         "accelerometer_noise")  # fmt: skip
ahrs = Filter(name="AHRS", make=_ahrs, reads=READS, **OWN)
told = Filter(name="AHRS told", make=_ahrs_told, reads=READS + NOISE, **OWN)
