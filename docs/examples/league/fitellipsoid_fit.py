"""fitellipsoid's fit: algebraic, kept an ellipsoid, by Douglas and Rachford's steps."""

import numpy as np
from adapting import needed

from simval.plugins import Calibrator

with needed():
    from fitellipsoid import math_func


def _fit(poses, g):
    _, _, A, b, c = math_func.ellipsoid3d_fitting_dr_svd(poses.T)
    centre = -np.linalg.solve(A, b) / 2.0
    square = centre @ A @ centre - c
    return g * np.linalg.cholesky(A / square).T, centre


douglas_rachford = Calibrator(name="fitellipsoid", calibrate=_fit)
