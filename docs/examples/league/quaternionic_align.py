"""quaternionic's `align`: Davenport's q-method, with weights."""

from adapting import needed

from simval.plugins import Estimator

with needed():
    import quaternionic


def _align(body, references, weights):
    return quaternionic.align(body, references, weights).ndarray


align = Estimator(
    name="quaternionic",
    estimate=_align,
    components="sxyz",
    matrix="active",
    kind="weighted wahba",
    takes="vectors",
    batch=False,
    reads=("weights",),
)
