"""The AHRS of smsfusion, a multiplicative Kalman filter with a gyroscope bias.

It takes the vertical from a velocity and a position that stay near zero, and a heading,
which is made here of both vectors, with its variance, where x is not near the vertical.
Told the truth it is the class below it, `AidedINS`, aided by the direction of gravity.

A call aids first and then goes forward by the rate; the rate of a row is the average
before its vectors. So a row hands in the vectors of the row before, and what is
answered is the state that the row's own vectors have not entered yet.
"""

import numpy as np
from adapting import needed
from compass import Compass

from simval.plugins import Filter

with needed():
    import smsfusion

BIAS = slice(9, 12)
ATTITUDE = slice(6, 9)
HOURS = 1e4  # s: of a bias that walks, over any of these runs


def _stepped(own, compass, aid):
    before = None

    def update(dt, gyroscope, accelerometer, magnetometer):
        nonlocal before
        if before is None:  # nothing aids the start
            aid(accelerometer, gyroscope, None, None)
        else:
            aid(before[0], gyroscope, *compass(*before))
        before = accelerometer, magnetometer
        P = own.P_prior[6:12, 6:12]
        return {
            "attitude": own.x_prior[6:10],
            "bias": own.x_prior[13:],
            "covariance": (P + P.T) / 2.0,
        }

    return update


def _state(start):
    x = smsfusion.constants.X0.copy()
    x[6:10] = start
    return x


def _ahrs(start, rate, gravity, **sensors):
    own = smsfusion.AHRS(rate, x0_prior=_state(start), g=gravity, cold_start=False)

    def aid(force, gyroscope, head, variance):
        own.update(force, gyroscope, head=head, head_var=variance, head_degrees=False)

    return _stepped(own, Compass(gravity, **sensors), aid)


def _ins_told(start, rate, gravity, field, start_std, bias_std, **noise):
    P = smsfusion.constants.P0.copy()
    P[ATTITUDE, ATTITUDE] = start_std**2 * np.eye(3)
    P[BIAS, BIAS] = bias_std**2 * np.eye(3)
    walk = noise["gyroscope_walk"] * np.sqrt(HOURS / 2.0)
    force_noise = noise["accelerometer_noise"]
    own = smsfusion.AidedINS(
        rate,
        x0_prior=_state(start),
        P0_prior=P,
        err_acc={"N": force_noise / np.sqrt(rate), "B": 0.0, "tau_cb": HOURS},
        err_gyro={"N": noise["gyroscope_noise"], "B": walk, "tau_cb": HOURS},
        g=gravity,
        cold_start=False,
    )
    compass = Compass(gravity, field, force_noise, noise["magnetometer_noise"])
    vertical = np.full(3, (force_noise / gravity) ** 2)

    def aid(force, gyroscope, head, variance):
        own.update(
            force, gyroscope, head=head, head_var=variance, head_degrees=False,
            g_ref=True, g_var=vertical,
        )  # fmt: skip

    return _stepped(own, compass, aid)


OWN = {"components": "sxyz", "matrix": "passive", "world": "NED"}
READS = ("start", "rate", "gravity", "field", "accelerometer_noise",
         "magnetometer_noise")  # fmt: skip
NOISE = ("start_std", "bias_std", "gyroscope_noise", "gyroscope_walk")
ahrs = Filter(name="AHRS", make=_ahrs, reads=READS, **OWN)
told = Filter(name="AidedINS told", make=_ins_told, reads=READS + NOISE, **OWN)
