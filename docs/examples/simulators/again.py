"""Readings of Newton and Genesis, made again from their own poses and rates.

`python again.py newton_imu` or `python again.py genesis_imu`, in their environment.
"""

import sys
from importlib import import_module
from types import SimpleNamespace

import numpy as np
from body import INERTIA, LEVER, MASS, G, wrench
from scipy.spatial.transform import Rotation

RATE, UP = 200.0, np.array([0.0, 0.0, G])

made = import_module(sys.argv[1]).simulate(SimpleNamespace(rate=RATE, seconds=8.0))
turned = Rotation.from_quat(made["attitude"])
mount = Rotation.from_quat(made["mount"])
rate = mount.apply(made["gyroscope"])  # after each step, body axes
force, torque = np.swapaxes([wrench(t / RATE) for t in range(len(rate))], 0, 1)[:, 1:]
before, after = turned[:-1], turned[1:]

# the accelerations that the step before each pose begins with, world axes
linear = force / MASS - UP
turn = before.inv().apply(torque) - np.cross(rate[:-1], INERTIA * rate[:-1])
angular = before.apply(turn / INERTIA)
arm, swing = after.apply(LEVER), after.apply(rate[1:])
point = linear + np.cross(angular, arm) + np.cross(swing, np.cross(swing, arm))

# a spatial acceleration of before, with the rate and velocity of after
velocity = np.diff(made["position"], axis=0) * RATE
other = np.cross(swing, velocity)
other -= np.cross(before.apply(rate[:-1]), velocity - linear / RATE)
for said, value in (
    ("accelerations of before, all else of after the step", point),
    ("and so are the rate and velocity of a spatial one", point + other),
):
    reading = (after * mount).inv().apply(value + UP)
    off = np.sqrt(np.mean((reading - made["accelerometer"][1:]) ** 2))
    sys.stdout.write(f"{said}: {off:.1e} m/s^2 off\n")
