"""RIANN, a neural network over gyroscope and accelerometer, in single precision.

It has no magnetometer and takes no start: its heading counts from its first one. The
network's file is named, since 0.2.0 finds it by itself only with Python 3.12 or above.
"""

from importlib.resources import files

import numpy as np
from adapting import needed

from simval.plugins import Filter

with needed():
    from riann.riann import RIANN


def _network(rate):
    own = RIANN(str(files("riann") / "riann.onnx"))
    own.set_sampling_rate(rate)

    def update(dt, gyroscope, accelerometer):
        found = own.predict_step(accelerometer, gyroscope).astype(float)
        return found / np.linalg.norm(found)

    return update


network = Filter(
    name="RIANN",
    make=_network,
    components="sxyz",
    matrix="passive",
    world="ENU",
    magnetometer=False,
    reads=("rate",),
)
