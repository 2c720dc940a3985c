"""umeyama's `umeyama`, without scale."""

from adapting import mirrored, needed

from simval.plugins import Estimator

with needed():
    import umeyama


def _rotation(body, references):
    points = mirrored(references), mirrored(body)  # source, destination
    return umeyama.umeyama(*points, estimate_scale=False).rotation


umeyama_fit = Estimator(
    name="umeyama",
    estimate=_rotation,
    components="matrix",
    matrix="active",
    kind="wahba",
    takes="vectors",
    batch=False,
)
