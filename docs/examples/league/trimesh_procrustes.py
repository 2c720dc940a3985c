"""trimesh's `procrustes`, of rotations alone.

Its page says that weights which are not equal "won't yield the optimal rotation", so it
is given none.
"""

from adapting import needed

from simval.plugins import Estimator

with needed():
    from trimesh import registration

ONLY_ROTATION = {"reflection": False, "translation": False, "scale": False}


def _procrustes(body, references):
    matrix = registration.procrustes(
        references, body, return_cost=False, **ONLY_ROTATION
    )
    return matrix[:3, :3]


procrustes = Estimator(
    name="trimesh",
    estimate=_procrustes,
    components="matrix",
    matrix="active",
    kind="wahba",
    takes="vectors",
    batch=False,
)
