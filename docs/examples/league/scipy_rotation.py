"""SciPy's `Rotation.align_vectors`: Kabsch's SVD, with weights and a sensitivity.

Its page says that the covariance is the sensitivity matrix times the harmonic mean of
the variances, of a rotation vector in the frame of the first argument.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from simval.plugins import Estimator


def _align(body, references, weights):
    return Rotation.align_vectors(body, references, weights)[0].as_quat()


def _covariance(body, references, noise_std, weights):
    *_, sensitivity = Rotation.align_vectors(
        body, references, weights, return_sensitivity=True
    )
    return sensitivity / np.mean(weights)


align_vectors = Estimator(
    name="align_vectors",
    estimate=_align,
    covariance=_covariance,
    components="xyzs",
    matrix="active",
    side="body",
    kind="weighted wahba",
    takes="vectors",
    batch=False,
    reads=("weights",),
)
