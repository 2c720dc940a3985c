"""qc-procrustes' `rotational`: A R closest to B, weighted row by row.

Its weights multiply the rows of both, so residuals are weighted by them and squares by
their squares: they are inverse standard deviations.
"""

import numpy as np
from adapting import needed

from simval.plugins import Estimator

with needed():
    import procrustes


def _rotational(body, references, weights):
    rows = {"pad": False, "weight": np.sqrt(weights)}
    return procrustes.rotational(references, body, **rows).t


rotational = Estimator(
    name="qc-procrustes",
    estimate=_rotational,
    components="matrix",
    matrix="passive",
    kind="weighted wahba",
    takes="vectors",
    batch=False,
    reads=("weights",),
)
