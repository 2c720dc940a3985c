"""VQF: inclination, heading and bias apart, each with a time constant.

It takes no start: the first readings set inclination and heading. Its vectors may be of
any unit, but its detection of rest and of a disturbed field has thresholds in m/s^2,
degrees per second and degrees. Told the truth it knows the bias's first size, and has
the time constants that were found best.
"""

import numpy as np
from adapting import needed

from simval.plugins import Filter

with needed():
    from vqf import VQF


def _stepped(own):
    def update(dt, gyroscope, accelerometer, magnetometer):
        own.update(gyroscope, accelerometer, magnetometer)
        return {"attitude": own.getQuat9D(), "bias": own.getBiasEstimate()[0]}

    return update


def _vqf(rate):
    return _stepped(VQF(1.0 / rate))


def _vqf_tuned(tauAcc, tauMag):
    def make(rate, bias_std):
        sigma = max(float(np.degrees(bias_std)), 1e-6)
        own = VQF(1.0 / rate, tauAcc=tauAcc, tauMag=tauMag, biasSigmaInit=sigma)
        return _stepped(own)

    return make


OWN = {"components": "sxyz", "matrix": "passive", "world": "ENU"}
vqf = Filter(name="VQF", make=_vqf, reads=("rate",), **OWN)
vqf_tuned = Filter(
    name="VQF tuned", make=_vqf_tuned(0.152, 0.584), reads=("rate", "bias_std"), **OWN
)
SEARCHED = {"VQF tuned": (_vqf_tuned, (3.0, 9.0))}
