"""scikit-surgerycore's `orthogonal_procrustes`: Arun's SVD without reflections."""

from adapting import mirrored, needed

from simval.plugins import Estimator

with needed():
    from sksurgerycore.algorithms import procrustes


def _rotation(body, references):
    points = {"fixed": mirrored(body), "moving": mirrored(references)}
    return procrustes.orthogonal_procrustes(**points)[0]


orthogonal_procrustes = Estimator(
    name="scikit-surgerycore",
    estimate=_rotation,
    components="matrix",
    matrix="active",
    kind="wahba",
    takes="vectors",
    batch=False,
)
