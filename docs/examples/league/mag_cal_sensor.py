"""circuitpython-mag-cal's fit of an ellipsoid to one sensor."""

from adapting import needed

from simval.plugins import Calibrator

with needed():
    from mag_cal import sensor


def _fit(poses, g):
    accelerometer = sensor.Sensor()
    accelerometer.fit_ellipsoid(poses)
    return g * accelerometer.transform, accelerometer.centre


fit_ellipsoid = Calibrator(name="circuitpython-mag-cal", calibrate=_fit)
