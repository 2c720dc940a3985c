"""quaternionic's `align`: Davenport's q-method, with weights."""

from packages import package

from simval.plugins import Estimator

quaternionic = package("quaternionic")


def _align(body, references, weights):
    return quaternionic.align(body, references, weights).ndarray


align = Estimator(
    name="quaternionic align",
    estimate=_align,
    components="sxyz",
    matrix="active",
    kind="weighted wahba",
    takes="vectors",
    batch=False,
    reads=("weights",),
)
