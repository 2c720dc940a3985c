"""actipy's `calibrate_gravity`: scales and offsets by van Hees.

It takes a recording in units of g. Each pose lasts 60 s at one sample in a second and
without noise of its own: the noise of a pose is in its mean already.
"""

import numpy as np
from adapting import needed

from simval.plugins import Calibrator

with needed():
    from actipy import processing as actipy
with needed():
    import pandas


def _fit(poses, g):
    unit = np.linalg.norm(poses, axis=1).mean()  # of one g, nearly
    readings = np.repeat(poses / unit, 60, axis=0)
    time = pandas.date_range("2020-01-01", periods=len(readings), freq="1s")
    recording = pandas.DataFrame(readings, columns=["x", "y", "z"], index=time)
    corrected, _ = actipy.calibrate_gravity(recording)
    # the correction is a line for each axis
    lines = [
        np.polyfit(readings[:, k], corrected.to_numpy()[:, k], 1) for k in range(3)
    ]
    slope, intercept = np.transpose(lines)
    return np.diag(slope * g / unit), -intercept / slope * unit


van_hees = Calibrator(name="van Hees", calibrate=_fit, estimates=("scale", "bias"))
