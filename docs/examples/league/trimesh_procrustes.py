"""trimesh's `procrustes`, of rotations alone.

Its page says that weights which are not equal "won't yield the optimal rotation", so it
is given none.
"""

from packages import package

from simval.plugins import Estimator

registration = package("trimesh.registration")

ONLY_ROTATION = {"reflection": False, "translation": False, "scale": False}


def _procrustes(body, references):
    matrix = registration.procrustes(
        references, body, return_cost=False, **ONLY_ROTATION
    )
    return matrix[:3, :3]


procrustes = Estimator(
    name="trimesh procrustes",
    estimate=_procrustes,
    components="matrix",
    matrix="active",
    kind="wahba",
    takes="vectors",
    batch=False,
)
