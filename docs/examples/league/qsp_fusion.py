"""The updates of qsp-orientation, functions whose caller keeps the quaternion."""

import numpy as np
from adapting import needed

from simval.plugins import Filter

with needed():
    from qsp.orientation import fusion


def _madgwick(beta=0.1):
    def make(start):
        q = start

        def update(dt, gyroscope, accelerometer, magnetometer):
            nonlocal q
            q = fusion.madgwick_update(
                q, gyroscope, accelerometer, beta=beta, dt=dt, mag=magnetometer
            )
            return q

        return update

    return make


def _mahony(Kp=2.0, Ki=0.005):
    def make(start):
        q, integral = start, np.zeros(3)

        def update(dt, gyroscope, accelerometer, magnetometer):
            nonlocal q, integral
            q, integral = fusion.mahony_update(
                q, gyroscope, accelerometer, Kp=Kp, Ki=Ki, dt=dt,
                integral_error=integral, mag=magnetometer,
            )  # fmt: skip
            return q

        return update

    return make


OWN = {"components": "sxyz", "matrix": "passive", "world": "NWU", "reads": ("start",)}
madgwick = Filter(name="Madgwick", make=_madgwick(), **OWN)
mahony = Filter(name="Mahony", make=_mahony(), **{**OWN, "world": "ENU"})
madgwick_tuned = Filter(name="Madgwick tuned", make=_madgwick(0.005), **OWN)
SEARCHED = {"Madgwick tuned": (_madgwick, (0.1,))}
