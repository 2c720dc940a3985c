"""Two rotations of rmsd: Kabsch's SVD, with and without weights, and by quaternions.

`kabsch` and `quaternion_rotate` take points that are centred already, so vectors go in
as they are; `kabsch_weighted` centres them itself.
"""

import numpy as np
from adapting import mirrored, needed

from simval.plugins import Estimator

with needed():
    import rmsd


def _kabsch(body, references):
    return rmsd.kabsch(references, body)


def _weighted(body, references, weights):
    points = mirrored(references), mirrored(body)
    return rmsd.kabsch_weighted(*points, np.tile(weights, 2))[0]


def _quaternion(body, references):
    return rmsd.quaternion_rotate(references, body)


ROWS = {"components": "matrix", "takes": "vectors", "batch": False}

kabsch = Estimator(
    name="kabsch", estimate=_kabsch, matrix="passive", kind="wahba", **ROWS
)
kabsch_weighted = Estimator(
    name="kabsch_weighted",
    estimate=_weighted,
    matrix="passive",
    kind="weighted wahba",
    reads=("weights",),
    **ROWS,
)
quaternion_rotate = Estimator(
    name="quaternion_rotate",
    estimate=_quaternion,
    matrix="passive",
    kind="wahba",
    **ROWS,
)
