"""ctef: an ellipsoid by the Cayley transform and a trust region."""

from adapting import needed

from simval.plugins import Calibrator

with needed():
    from ctef.ctef import ctef


def _fit(poses, g):
    found = ctef(poses)
    return g * found["Lambda_inv"], found["center"]


cayley = Calibrator(name="ctef", calibrate=_fit)
