"""RIANN, a neural network over gyroscope and accelerometer, in single precision.

It has no magnetometer and takes no start; its heading is its own, and is turned here to
that of the start at the first row.
"""

from importlib.resources import files

import numpy as np
from adapting import needed
from quaternions import body_to_world

from simval.plugins import Filter

with needed():
    from riann.riann import RIANN


def _network(start, rate):
    own = RIANN(str(files("riann") / "riann.onnx"))
    own.set_sampling_rate(rate)
    turn = None

    def update(dt, gyroscope, accelerometer):
        nonlocal turn
        found = own.predict_step(accelerometer, gyroscope).astype(float)
        R = body_to_world(found / np.linalg.norm(found))
        if turn is None:
            both = start @ R.T  # the nearest turn of its level part
            angle = np.arctan2(both[1, 0] - both[0, 1], both[0, 0] + both[1, 1])
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return turn @ R

    return update


network = Filter(
    name="RIANN",
    make=_network,
    components="matrix",
    matrix="passive",
    world="NWU",
    magnetometer=False,
    reads=("start", "rate"),
)
