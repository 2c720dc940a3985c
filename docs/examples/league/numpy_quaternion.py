"""numpy-quaternion's `optimal_alignment_in_Euclidean_metric`: the q-method."""

from adapting import needed

from simval.plugins import Estimator

with needed():
    import quaternion


def _align(body, references):
    rotor = quaternion.optimal_alignment_in_Euclidean_metric(body, references)
    return quaternion.as_float_array(rotor)


optimal_alignment = Estimator(
    name="numpy-quaternion",
    estimate=_align,
    components="sxyz",
    matrix="active",
    kind="wahba",
    takes="vectors",
    batch=False,
)
