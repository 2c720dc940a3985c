"""superpose3d's `Superpose3D`: Diamond's quaternions, with weights."""

import numpy as np
from adapting import mirrored, needed

from simval.plugins import Estimator

with needed():
    import superpose3d


def _superpose(body, references, weights):
    points = mirrored(body), mirrored(references)  # frozen, mobile
    return superpose3d.Superpose3D(*points, np.tile(weights, 2))[1]


diamond = Estimator(
    name="superpose3d",
    estimate=_superpose,
    components="matrix",
    matrix="active",
    kind="weighted wahba",
    takes="vectors",
    batch=False,
    reads=("weights",),
)
