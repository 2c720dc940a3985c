r"""The formulas and error bars of a calibration beside how its estimate answers.

At a cell's sensor and some of its poses, (R2) of `simval.studies.response` gives the
covariance and the bias of the estimate without a derivative of anybody's; theory's
(K1) must meet them, and the covariance that the calibration states must meet theory's.

A combination of parameters that the poses see k times worse bends k times sooner: what
the differences leave grows as :math:`k^4`, as was measured up to k = 6 with poses of
every kind.
"""

from typing import Any

import numpy as np

from simval.arrays import Array
from simval.calibrate import calibrate
from simval.poses import PARAMETERS, observability
from simval.results import Row, exact
from simval.sensor import AccelerometerModel
from simval.shapes import Float
from simval.statistics import BIAS_OFF, COVARIANCE_OFF, FIRST_ORDER, RESPONSE
from simval.studies.response import MET, STEP, apart, response
from simval.theory.calibration import EVEN, calibration_moments

MOST = 40
"""Poses: more tell nothing new of a formula."""
MET_BIAS = 10.0 * MET
"""A second difference keeps fewer digits: 2e-8 was the worst seen of even poses."""
UNEVEN, UNLIKE = 10.0, 4.0
"""Condition of the poses, and ratio of the scales, up to which differences are taken:
the fourth powers of what they make of a step are 3500 and 250."""
SMALL = 1e-6
"""Noise over gravity, of a residual that must be told one: its square is rounding."""


def response_rows(
    sensor: AccelerometerModel,
    forces: Float[Array, "n 3"],
    g: float,
    residual: Any = "squared",
) -> tuple[Row, ...]:
    """Rows of theory beside the estimate, and of stated error bars beside theory.

    None for poses or scales so uneven that differences are no match for them.
    """
    count = len(forces)
    few = forces[np.linspace(0, count - 1, min(count, MOST)).round().astype(int)]
    seen, K = observability(few), np.linalg.norm(sensor.matrix, axis=1)
    if seen.rank < PARAMETERS or seen.condition > UNEVEN or K.max() > UNLIKE * K.min():
        return ()
    still = AccelerometerModel(T=sensor.T, K=sensor.K, B=sensor.B)
    clean = still.distort(few, np.random.default_rng(0))  # draws nothing
    told = {"g": g, "residual": residual, "noise_std": SMALL * g}

    def estimate(y: Float[Array, "t d"]) -> Float[Array, "t 9"]:
        poses = y.reshape(-1, *clean.shape)
        fit = calibrate(poses, **told, covariance=False)
        return fit.require_converged().parameters

    found = response(estimate, clean.ravel(), STEP * g / K.max())
    noise = np.ones(clean.size)
    predicted = calibration_moments(sensor, few, g=g, noise_std=1.0, residual=residual)
    worse = max(1.0, seen.condition / EVEN)
    stated = calibrate(clean, **told).covariance / told["noise_std"] ** 2
    rows = exact(
        COVARIANCE_OFF("predicted"),
        apart(predicted.covariance, found.covariance(noise)),
        0.0, RESPONSE, MET * worse**4,
    ) + exact(
        COVARIANCE_OFF("stated"), apart(stated, predicted.covariance),
        0.0, FIRST_ORDER, MET * worse**4,
    )  # fmt: skip
    if residual == "adjusted":  # takes its bias out by the noise that it is told
        return rows
    off = np.abs(predicted.bias - found.bias(noise)) / predicted.sd
    return rows + exact(
        BIAS_OFF("predicted"), off.max(), 0.0, RESPONSE, MET_BIAS * worse**4
    )
