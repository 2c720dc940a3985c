"""transformations' `superimposition_matrix`."""

from adapting import mirrored, needed

from simval.plugins import Estimator

with needed():
    import transformations


def _superimposed(body, references):
    points = mirrored(references).T, mirrored(body).T  # first onto second
    return transformations.superimposition_matrix(*points)[:3, :3]


superimposition_matrix = Estimator(
    name="transformations",
    estimate=_superimposed,
    components="matrix",
    matrix="active",
    kind="wahba",
    takes="vectors",
    batch=False,
)
