"""The AHRS of attipy, a multiplicative Kalman filter with a gyroscope bias.

It takes the vertical from a velocity that stays near zero, and a heading, which is made
here of both vectors, with its variance, where x is not near the vertical. A call goes
forward by the rate of the call before; the rate of a row is the average before its
vectors. So a row hands in the vectors of the row before with its own rate, and what is
answered is turned by that rate.
"""

import numpy as np
from adapting import needed
from compass import Compass
from quaternions import turned

from simval.plugins import Filter

with needed():
    import attipy

HOURS = 1e4  # s: of a bias that walks, over any of these runs


def _stepped(own, compass, **aiding):
    before, answer = None, own.q_nb

    def update(dt, gyroscope, accelerometer, magnetometer):
        nonlocal before, answer
        if before is None:  # nothing aids the start
            own.update(accelerometer, gyroscope, **aiding)
        else:
            yaw, variance = compass(*before)
            own.update(before[0], gyroscope, yaw=yaw, yaw_var=variance, **aiding)
        before, answer = (accelerometer, magnetometer), turned(own.q_nb, dt * own.w_b)
        P = own.P[:6, :6]
        return {
            "attitude": answer,
            "bias": own.bg_b,
            "covariance": (P + P.T) / 2.0,
        }

    return update


def _ahrs(start, rate, gravity, **sensors):
    own = attipy.AHRS(rate, q_nb=start, g=gravity)
    return _stepped(own, Compass(gravity, **sensors))


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
    compass = Compass(
        gravity, field, noise["accelerometer_noise"], noise["magnetometer_noise"]
    )
    return _stepped(own, compass, v_var=still)


OWN = {"components": "sxyz", "matrix": "passive", "world": "NED"}
READS = ("start", "rate", "gravity", "field", "accelerometer_noise",
         "magnetometer_noise")  # fmt: skip
NOISE = ("start_std", "bias_std", "gyroscope_noise", "gyroscope_walk")
ahrs = Filter(name="AHRS", make=_ahrs, reads=READS, **OWN)
told = Filter(name="AHRS told", make=_ahrs_told, reads=READS + NOISE, **OWN)
