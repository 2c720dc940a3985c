"""The filters of ahrs that have gains and no covariance.

None but Mahony estimates a bias. The quaternion is kept here between rows, since their
`update` is handed the one before; Complementary has no step, and is called with two
rows, the angles before as `w0`. Tuned gains are those that `tuning.py` finds.
"""

import numpy as np
from adapting import needed

from simval.plugins import Filter

with needed():
    from ahrs import filters
    from ahrs.common.orientation import q2rpy


def _kept(step, q):
    """Keep the quaternion between rows."""

    def update(dt, gyroscope, accelerometer, magnetometer):
        nonlocal q
        q = np.asarray(step(q, gyroscope, accelerometer, magnetometer, dt))
        return q

    return update


def _madgwick(gain=0.041):
    def make(start, rate):
        own = filters.Madgwick(frequency=rate, gain_marg=gain, gain=gain)
        return _kept(own.updateMARG, start)

    return make


def _mahony(k_P=1.0, k_I=0.3):
    def make(start, rate):
        own = filters.Mahony(frequency=rate, k_P=k_P, k_I=k_I)
        step = _kept(own.updateMARG, start)

        def update(*row):
            return {"attitude": step(*row), "bias": own.b}

        return update

    return make


def _complementary(gain=0.9):
    def make(start, rate):
        angles = np.array(q2rpy(start))

        def update(dt, gyroscope, accelerometer, magnetometer):
            nonlocal angles
            own = filters.Complementary(
                gyr=np.array([gyroscope, gyroscope]),
                acc=np.array([accelerometer, accelerometer]),
                mag=np.array([magnetometer, magnetometer]),
                frequency=rate,
                gain=gain,
                w0=angles,
            )
            angles = own.W[1]
            return np.asarray(own.Q[1])

        return update

    return make


def _aqua(alpha=0.01, beta=0.01):
    def make(start, rate):
        own = filters.AQUA(frequency=rate, alpha=alpha, beta=beta)
        return _kept(own.updateMARG, start)

    return make


def _roleq(start, rate, field):
    own = filters.ROLEQ(frequency=rate, magnetic_ref=field)
    return _kept(own.update, start)


def _roleq_told(start, rate, field, gravity, **noise):
    inverse = np.array(
        [
            (gravity / noise["accelerometer_noise"]) ** 2,
            (np.linalg.norm(field) / noise["magnetometer_noise"]) ** 2,
        ]
    )
    own = filters.ROLEQ(
        frequency=rate, magnetic_ref=field, weights=inverse / inverse.sum()
    )
    return _kept(own.update, start)


def _fourati(gain=0.1):
    def make(start, rate, field):
        own = filters.Fourati(
            frequency=rate, gain=gain, magnetic_dip=[0.0, *field.tolist()]
        )
        return _kept(own.update, start)

    return make


Q = {"components": "sxyz", "matrix": "passive"}
NWU = {**Q, "world": "NWU"}
ENU = {**Q, "world": "ENU"}
AQUA = {**NWU, "matrix": "active"}  # the dip is not told: NED and gravity fit as well
ROLEQ = {**Q, "world": "NED"}
FOURATI = {**Q, "world": "NED", "accelerometer": "gravity"}
OWN, PLACE = ("start", "rate"), ("start", "rate", "field")
NOISE = ("gravity", "accelerometer_noise", "magnetometer_noise")

madgwick = Filter(name="Madgwick", make=_madgwick(), reads=OWN, **NWU)
mahony = Filter(name="Mahony", make=_mahony(), reads=OWN, **ENU)
complementary = Filter(name="Complementary", make=_complementary(), reads=OWN, **NWU)
aqua = Filter(name="AQUA", make=_aqua(), reads=OWN, **AQUA)
roleq = Filter(name="ROLEQ", make=_roleq, reads=PLACE, **ROLEQ)
roleq_told = Filter(name="ROLEQ told", make=_roleq_told, reads=PLACE + NOISE, **ROLEQ)
fourati = Filter(name="Fourati", make=_fourati(), reads=PLACE, **FOURATI)
madgwick_tuned = Filter(name="Madgwick tuned", make=_madgwick(0.005), reads=OWN, **NWU)
mahony_tuned = Filter(
    name="Mahony tuned", make=_mahony(0.742, 0.0339), reads=OWN, **ENU
)
complementary_tuned = Filter(
    name="Complementary tuned", make=_complementary(0.262), reads=OWN, **NWU
)
aqua_tuned = Filter(name="AQUA tuned", make=_aqua(0.0692, 0.012), reads=OWN, **AQUA)
fourati_tuned = Filter(
    name="Fourati tuned", make=_fourati(1.26), reads=PLACE, **FOURATI
)
SEARCHED = {
    "Madgwick tuned": (_madgwick, (0.041,)),
    "Mahony tuned": (_mahony, (1.0, 0.3)),
    "Complementary tuned": (_complementary, (0.9,)),
    "AQUA tuned": (_aqua, (0.01, 0.01)),
    "Fourati tuned": (_fourati, (0.1,)),
}
