"""The package's own estimators and calibrators as plug-ins declare themselves.

A user's algorithm is measured beside them by the same studies (`simval.plugins.builtin`
has their names). The estimators declare their class, so theory judges them too.
"""

from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.attitude import two_vector_quaternion
from simval.attitude.comparators import davenport
from simval.attitude.comparators import triad as triad_quaternion
from simval.calibrate import calibrate
from simval.plugins import Calibrator, Estimator

LEAST = 1e-12
"""Relative noise of readings that have none: some residuals ask for its size, and this
moves a parameter by less than rounding."""

_own = partial(Estimator, components="xyzs", matrix="passive")

wahba = _own(name="wahba", estimate=davenport, kind="wahba")
triad = _own(name="triad", estimate=triad_quaternion, kind="triad")
closed_form = _own(
    name="closed-form", estimate=two_vector_quaternion, kind="closed form"
)
combined = _own(
    name="combined",
    estimate=partial(two_vector_quaternion, frame="combined"),
    kind="combined",
)


def _fit(
    poses: Float[Array, "n 3"], g: float, noise_std: float, *, residual: str
) -> tuple[Any, Any, Any]:
    """Calibrate one set of poses of known noise."""
    known = max(noise_std, LEAST * float(np.abs(poses).max()))
    fit = calibrate(poses, g, residual=residual, noise_std=known).require_converged()
    return fit.matrix, fit.B, fit.covariance


def _calibrator(residual: str) -> Calibrator:
    return Calibrator(
        name=residual, calibrate=partial(_fit, residual=residual), noise_std=True
    )


squared = _calibrator("squared")
norm = _calibrator("norm")
weighted = _calibrator("weighted")
sampson = _calibrator("sampson")
adjusted = _calibrator("adjusted")
