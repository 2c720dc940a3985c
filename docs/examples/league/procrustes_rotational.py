"""qc-procrustes' `rotational`: A R closest to B, rows of A weighted."""

from packages import package

from simval.plugins import Estimator

procrustes = package("procrustes")


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
