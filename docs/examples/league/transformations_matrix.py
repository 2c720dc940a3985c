"""transformations' `superimposition_matrix`."""

from packages import mirrored, package

from simval.plugins import Estimator

transformations = package("transformations")


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
