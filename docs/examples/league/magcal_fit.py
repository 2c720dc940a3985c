"""magcal's `ellipsoid_fit`: centre by the mean of the readings."""

from adapting import needed

from simval.plugins import Calibrator

with needed():
    from magcal import core


def _fit(poses, g):
    found = core.MagnetometerCalibrator().ellipsoid_fit(poses)
    return g * found["transform_matrix"], found["center"]


ellipsoid_fit = Calibrator(name="magcal", calibrate=_fit)
