"""magyc's fits of a magnetometer alone: two ellipsoids, and two-step.

They return hard and soft iron, and correct by the inverse of the soft iron. Ellipsoids
have no size of their own: they get that at which the corrected readings are g on the
mean. Two-step is given g as the length of its field.
"""

import numpy as np
from adapting import needed, sized

from simval.plugins import Calibrator

with needed():
    import magyc


def _ellipsoid(fit):
    def calibrate(poses, g):
        hard_iron, soft_iron, _ = fit(poses)
        return sized(np.linalg.inv(soft_iron), hard_iron, poses, g)

    return calibrate


def _two_step(poses, g, noise_std):
    field = np.array([0.0, 0.0, g])
    noise = {"measurement_noise_std": noise_std} if noise_std > 0.0 else {}
    hard_iron, soft_iron, _ = magyc.twostep_hsi(poses, field, **noise)
    return np.linalg.inv(soft_iron), hard_iron


ellipsoid_fit = Calibrator(
    name="ellipsoid_fit", calibrate=_ellipsoid(magyc.ellipsoid_fit)
)
ellipsoid_fit_fang = Calibrator(
    name="ellipsoid_fit_fang", calibrate=_ellipsoid(magyc.ellipsoid_fit_fang)
)
twostep_hsi = Calibrator(name="twostep_hsi", calibrate=_two_step, noise_std=True)
