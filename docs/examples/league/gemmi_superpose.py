"""gemmi's `superpose_positions`: the quaternion characteristic polynomial, weighted."""

import numpy as np
from adapting import mirrored, needed

from simval.plugins import Estimator

with needed():
    import gemmi


def _positions(vectors):
    return [gemmi.Position(*point) for point in mirrored(vectors)]


def _superpose(body, references, weights):
    points = _positions(body), _positions(references)  # the second onto the first
    found = gemmi.superpose_positions(*points, list(np.tile(weights, 2)))
    return np.array(found.transform.mat.tolist())


superpose_positions = Estimator(
    name="gemmi",
    estimate=_superpose,
    components="matrix",
    matrix="active",
    kind="weighted wahba",
    takes="vectors",
    batch=False,
    reads=("weights",),
)
