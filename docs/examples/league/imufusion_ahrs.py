"""The AHRS of imufusion, in single precision: one gain, and no bias of the gyroscope.

It takes degrees per second and gravities. Being told the start, it skips the three
seconds of higher gain that it starts with otherwise. Its settings turn the rejection of
accelerations and fields off by default.
"""

import numpy as np
from adapting import needed

from simval.plugins import Filter

with needed():
    import imufusion


def _ahrs(*gain):
    def make(start, rate, gravity):
        own = imufusion.Ahrs()
        settings = imufusion.AhrsSettings(sample_rate=rate)
        if gain:
            settings.gain = gain[0]
        own.set_settings(settings)
        own.set_quaternion(start)
        own.skip_startup()
        degrees = 180.0 / np.pi

        def update(dt, gyroscope, accelerometer, magnetometer):
            own.set_sample_period(dt)
            own.update(degrees * gyroscope, accelerometer / gravity, magnetometer)
            return own.get_quaternion().astype(float)

        return update

    return make


OWN = {
    "components": "sxyz",
    "matrix": "passive",
    "world": "NWU",
    "reads": ("start", "rate", "gravity"),
}
ahrs = Filter(name="Ahrs", make=_ahrs(), **OWN)
ahrs_tuned = Filter(name="Ahrs tuned", make=_ahrs(0.276), **OWN)
SEARCHED = {"Ahrs tuned": (_ahrs, (0.5,))}
