"""An ellipsoid fit of one's own as a calibrator."""

import numpy as np

from simval.plugins import Calibrator


def _fit(poses, g):
    D = np.column_stack([poses**2, 2 * poses * poses[:, [1, 2, 0]], poses])
    a, b, c, d, e, f, *v = np.linalg.lstsq(D, np.ones(len(D)), rcond=None)[0]
    A = np.array([[a, d, f], [d, b, e], [f, e, c]])
    bias = -np.linalg.solve(A, v) / 2
    return np.linalg.cholesky(A / (1 + bias @ A @ bias)).T * g, bias


ellipsoid = Calibrator(name="ellipsoid", calibrate=_fit)
