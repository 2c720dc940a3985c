"""SciPy's align_vectors as an estimator of one's own."""

import numpy as np
from scipy.spatial.transform import Rotation

from simval.plugins import Estimator


def _align(*vectors):
    rows = [Rotation.align_vectors(v[:2], v[2:])[0] for v in zip(*vectors, strict=True)]
    return np.array([rotation.as_quat() for rotation in rows])


align = Estimator(name="align", estimate=_align, components="xyzs", matrix="active")
