"""rowan's mappings of points: Kabsch's SVD, Horn's and Davenport's quaternions."""

from packages import mirrored, package

from simval.plugins import Estimator

mapping = package("rowan.mapping")


def _mapped(function):
    def estimate(body, references):
        return function(mirrored(references), mirrored(body))[0]  # first onto second

    return estimate


WAHBA = {"matrix": "active", "kind": "wahba", "takes": "vectors", "batch": False}

kabsch = Estimator(
    name="rowan kabsch",
    estimate=_mapped(mapping.kabsch),
    components="matrix",
    **WAHBA,
)
horn = Estimator(
    name="rowan horn", estimate=_mapped(mapping.horn), components="sxyz", **WAHBA
)
davenport = Estimator(
    name="rowan davenport",
    estimate=_mapped(mapping.davenport),
    components="sxyz",
    **WAHBA,
)
