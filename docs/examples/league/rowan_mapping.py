"""rowan's mappings of points: Kabsch's SVD, Horn's and Davenport's quaternions."""

from adapting import mirrored, needed

from simval.plugins import Estimator

with needed():
    from rowan import mapping


def _mapped(function):
    def estimate(body, references):
        return function(mirrored(references), mirrored(body))[0]  # first onto second

    return estimate


WAHBA = {"matrix": "active", "kind": "wahba", "takes": "vectors", "batch": False}

kabsch = Estimator(
    name="kabsch",
    estimate=_mapped(mapping.kabsch),
    components="matrix",
    **WAHBA,
)
horn = Estimator(
    name="horn", estimate=_mapped(mapping.horn), components="sxyz", **WAHBA
)
davenport = Estimator(
    name="davenport",
    estimate=_mapped(mapping.davenport),
    components="sxyz",
    **WAHBA,
)
