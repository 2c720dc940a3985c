"""The Madgwick filter of py-imu, whose messages at each row are switched off."""

import numpy as np
from adapting import needed

from simval.plugins import Filter

with needed():
    from loguru import logger
    from py_imu.fusion.madgwick import Madgwick
    from py_imu.fusion.quaternion import Quaternion, Vector3D


def _madgwick(gain=0.041):
    def make(start, rate):
        logger.disable("py_imu")
        own = Madgwick(frequency=rate, gain_marg=gain)
        own.q = Quaternion(*start.tolist())

        def update(dt, *sensors):
            q = own.update(*(Vector3D(*reading.tolist()) for reading in sensors), dt=dt)
            return np.array([q.w, q.x, q.y, q.z])

        return update

    return make


OWN = {
    "components": "sxyz",
    "matrix": "passive",
    "world": "NWU",
    "reads": ("start", "rate"),
}
madgwick = Filter(name="Madgwick", make=_madgwick(), **OWN)
madgwick_tuned = Filter(name="Madgwick tuned", make=_madgwick(0.005), **OWN)
SEARCHED = {"Madgwick tuned": (_madgwick, (0.041,))}
