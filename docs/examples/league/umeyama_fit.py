"""umeyama's `umeyama`, without scale."""

from packages import mirrored, package

from simval.plugins import Estimator

umeyama = package("umeyama")


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
