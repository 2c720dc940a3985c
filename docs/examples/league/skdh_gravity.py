"""scikit-digital-health's `CalibrateAccelerometer`: scales and offsets by van Hees.

It takes a recording in units of g, of 12 hours or more. Each pose lasts so long that
all are in the first 12 hours, at one sample in a second and without noise of its own:
the noise of a pose is in its mean already. It stops where its residual changes by less
than `tol`, 1e-10 by default.
"""

import numpy as np
from adapting import needed

from simval.plugins import Calibrator

with needed():
    from skdh import preprocessing

HOURS = 12


def _fit(poses, g, **options):
    unit = np.linalg.norm(poses, axis=1).mean()  # of one g, nearly
    each = 10 * (HOURS * 360 // len(poses) + 1)  # whole windows of 10 s
    readings = np.repeat(poses / unit, each, axis=0)
    time = np.arange(float(len(readings)))
    fit = preprocessing.CalibrateAccelerometer(min_hours=HOURS, **options)
    found = fit.predict(time=time, accel=readings, fs=1.0, apply=False)
    return np.diag(found["scale"] * g / unit), -found["offset"] * unit


van_hees = Calibrator(name="van Hees", calibrate=_fit, estimates=("scale", "bias"))
