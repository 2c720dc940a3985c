"""Madgwick and Mahony of scikit-kinematics.

Both are handed vectors of length 1: neither normalises them, though the pages say that
units do not matter. Mahony adds to the gyroscope's reading in place, so it is handed a
copy. Tuned gains are those that `tuning.py` finds.
"""

import numpy as np
from adapting import needed

from simval.plugins import Filter

with needed():
    from skinematics.imus import Madgwick, Mahony


def _stepped(own):
    def update(dt, gyroscope, accelerometer, magnetometer):
        a = accelerometer / np.linalg.norm(accelerometer)
        own.Update(gyroscope.copy(), a, magnetometer / np.linalg.norm(magnetometer))
        return np.array(own.Quaternion)

    return update


def _madgwick(Beta=1.0):
    def make(start, rate):
        return _stepped(Madgwick(rate=rate, Beta=Beta, Quaternion=start))

    return make


def _mahony(Kp=1.0, Ki=0.0):
    def make(start, rate):
        return _stepped(Mahony(rate=rate, Kp=Kp, Ki=Ki, Quaternion=start))

    return make


OWN = {
    "components": "sxyz",
    "matrix": "passive",
    "world": "NWU",
    "reads": ("start", "rate"),
}
madgwick = Filter(name="Madgwick", make=_madgwick(), **OWN)
mahony = Filter(name="Mahony", make=_mahony(), **OWN)
madgwick_tuned = Filter(name="Madgwick tuned", make=_madgwick(0.005), **OWN)
mahony_tuned = Filter(name="Mahony tuned", make=_mahony(0.742, 0.0339), **OWN)
SEARCHED = {
    "Madgwick tuned": (_madgwick, (1.0,)),
    "Mahony tuned": (_mahony, (1.0, 0.3)),
}
