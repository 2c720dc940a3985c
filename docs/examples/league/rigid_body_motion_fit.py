"""rigid-body-motion's `best_fit_rotation`."""

from adapting import needed

from simval.plugins import Estimator

with needed():
    import rigid_body_motion


def _rotation(body, references):
    return rigid_body_motion.best_fit_rotation(references, body)


best_fit_rotation = Estimator(
    name="rigid-body-motion",
    estimate=_rotation,
    components="sxyz",
    matrix="active",
    kind="wahba",
    takes="vectors",
    batch=False,
)
