"""The estimators of ahrs that take one accelerometer and one magnetometer sample.

Each is called as its page describes, in the frame that it was written for: the first
vector is the vertical, the second the Earth's field. TRIAD alone takes any references.
Weights have the sum that they have by default.
"""

import numpy as np
from adapting import needed

from simval.plugins import Estimator

with needed():
    from ahrs import filters


def _davenport(body, references, weights):
    dip = float(np.degrees(np.arctan2(references[1, 2], references[1, 0])))
    relative = weights / weights.mean()
    q_method = filters.Davenport(magnetic_dip=dip, gravity=1.0, weights=relative)
    return q_method.estimate(acc=body[0], mag=body[1])


def _quest(body, references, weights):
    share = weights / weights.sum()
    quest = filters.QUEST(magnetic_dip=references[1], weights=share)
    return quest.estimate(acc=body[0], mag=body[1])


def _flae(method):
    def estimate(body, references, weights):
        dip = float(np.degrees(np.arctan2(-references[1, 2], references[1, 0])))
        share = weights / weights.sum()
        flae = filters.FLAE(magnetic_dip=dip, weights=share)
        return flae.estimate(acc=body[0], mag=body[1], method=method)

    return estimate


def _oleq(body, references, weights):
    relative = weights / weights.mean()
    oleq = filters.OLEQ(magnetic_ref=references[1], weights=relative, frame="NED")
    return oleq.estimate(acc=body[0], mag=body[1])


def _triad(representation):
    def estimate(body, references):
        return filters.TRIAD(*body, *references, representation=representation).A

    return estimate


def _saam(body, references):
    return filters.SAAM().estimate(acc=body[0], mag=body[1])


def _famc(body, references):
    return filters.FAMC().estimate(acc=body[0], mag=body[1])


def _fqa(body, references):
    # by the constructor, which copies what `estimate` would change
    return filters.FQA(acc=body[0], mag=body[1], mag_ref=references[1]).Q


def _tilt(body, references):
    return filters.Tilt().estimate(acc=body[0], mag=body[1])


ROWS = {"takes": "vectors", "batch": False}
GRAVITY = {**ROWS, "reference": "NED", "vertical": "down"}
FORCE = {**ROWS, "reference": "NED", "vertical": "up"}
LEAST_SQUARES = {"kind": "weighted wahba", "reads": ("weights",)}
PASSIVE = {"components": "sxyz", "matrix": "passive"}

davenport = Estimator(
    name="Davenport", estimate=_davenport, **PASSIVE, **GRAVITY, **LEAST_SQUARES
)
quest = Estimator(name="QUEST", estimate=_quest, **PASSIVE, **GRAVITY, **LEAST_SQUARES)
flae_symbolic = Estimator(
    name="FLAE symbolic",
    estimate=_flae("symbolic"),
    reference="NWU",
    **PASSIVE,
    **ROWS,
    **LEAST_SQUARES,
)
flae_newton = Estimator(
    name="FLAE newton",
    estimate=_flae("newton"),
    reference="NWU",
    **PASSIVE,
    **ROWS,
    **LEAST_SQUARES,
)
flae_eig = Estimator(
    name="FLAE eig",
    estimate=_flae("eig"),
    reference="NWU",
    **PASSIVE,
    **ROWS,
    **LEAST_SQUARES,
)
oleq = Estimator(name="OLEQ", estimate=_oleq, **PASSIVE, **FORCE, **LEAST_SQUARES)
triad_matrix = Estimator(
    name="TRIAD matrix",
    estimate=_triad("rotmat"),
    components="matrix",
    matrix="active",
    kind="triad",
    **ROWS,
)
triad_quaternion = Estimator(
    name="TRIAD quaternion",
    estimate=_triad("quaternion"),
    components="sxyz",
    matrix="active",
    kind="triad",
    **ROWS,
)
saam = Estimator(
    name="SAAM", estimate=_saam, components="sxyz", matrix="active", **GRAVITY
)
famc = Estimator(name="FAMC", estimate=_famc, **PASSIVE, **GRAVITY)
fqa = Estimator(name="FQA", estimate=_fqa, **PASSIVE, **FORCE)
tilt = Estimator(name="Tilt", estimate=_tilt, **PASSIVE, **GRAVITY)
