"""magcc's two calibrations: linear least squares, and Levenberg and Marquardt.

The linear one takes half a step to the centre in each of `n_iter` rounds, 5 by default.
"""

from functools import partial

from adapting import needed

from simval.plugins import Calibrator

with needed():
    from magcc import magcc


def _fitted(function):
    def calibrate(poses, g):
        hard_iron, soft_iron, *_ = function(poses, g)
        return soft_iron, hard_iron

    return calibrate


linear = Calibrator(name="LSE", calibrate=_fitted(magcc.calibrate_lse))
linear_60 = Calibrator(
    name="LSE of 60 rounds", calibrate=_fitted(partial(magcc.calibrate_lse, n_iter=60))
)
levenberg = Calibrator(name="LM", calibrate=_fitted(magcc.calibrate_lm))
