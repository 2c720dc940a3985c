"""A complementary filter: the rate integrated, and a pull towards up and west."""

import numpy as np
from scipy.spatial.transform import Rotation

from simval.plugins import Filter


class _Pulled:
    def __init__(self, start):
        self.R = Rotation.from_quat(start)  # body to world

    def update(self, dt, gyroscope, accelerometer, magnetometer):
        turned = self.R * Rotation.from_rotvec(gyroscope * dt)
        up, field = turned.apply([accelerometer, magnetometer])
        west = np.cross(up, field)
        pull = np.cross(up / np.linalg.norm(up), [0, 0, 1])
        pull += np.cross(west / np.linalg.norm(west), [0, 1, 0])
        self.R = Rotation.from_rotvec(0.02 * pull) * turned
        return self.R.as_quat()


pulled = Filter(
    name="pulled",
    make=_Pulled,
    reads=("start",),
    components="xyzs",
    matrix="passive",
    world="NWU",
)
