"""qc-procrustes' `rotational`: A R closest to B, rows of A weighted."""

from adapting import needed

from simval.plugins import Estimator

with needed():
    import procrustes


def _rotational(body, references, weights):
    result = procrustes.rotational(references, body, pad=False, weight=weights)
    return result.t


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
