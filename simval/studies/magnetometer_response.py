r"""The formulas and error bars of a magnetometer beside how its estimate answers.

At the truth of a cell, and with at most `MOST` poses, (R2) of `simval.studies.response`
gives the covariance and the bias of the estimate without a derivative of anybody's.
Theory's bound (M2) and bias (M7) must meet them, and the covariance that the fit states
must meet theory's.
"""

from math import radians

import numpy as np

from simval.arrays import Array
from simval.calibrate import MagnetometerFit, calibrate_magnetometer
from simval.results import Row, exact
from simval.shapes import Float
from simval.statistics import (
    BIAS_OFF,
    COVARIANCE_OFF,
    CRAMER_RAO,
    RESPONSE,
)
from simval.studies.magnetometer_scenario import (
    G,
    Scenario,
    scenario,
    true_accelerometer,
    true_magnetometer,
)
from simval.studies.response import MET, STEP, apart, response
from simval.theory.magnetometer import MagnetometerMoments, magnetometer_moments

MOST = 20
"""Poses: more tell nothing new of a formula."""
UNLIKE = 100.0
"""Ratio of the sensors' noise up to which differences are taken: beyond, a step of the
noisy one is thousands of deviations of the other."""
MET_COVARIANCE = 100.0 * MET
"""Up to a dip of 85 degrees 6e-7 was the worst seen."""
LOUD = 3e-4
"""Relative noise that the fit is told of the noisier sensor: only the ratio of both
weighs a reading, and of a smaller one a step would be hundreds of deviations."""
MET_BIAS = MET
"""In deviations of `LOUD`: 5e-9 was the worst seen."""


def fitted(case: Scenario, body: Array, iron: Array) -> MagnetometerFit:
    """The calibration of a cell, with the noise that it is told."""
    return calibrate_magnetometer(
        body,
        iron,
        G,
        accelerometer_std=case.accelerometer_std,
        magnetometer_std=case.magnetometer_std,
    )


def predicted_moments(case: Scenario, dip_deg: float) -> MagnetometerMoments:
    """What theory says of a cell."""
    return magnetometer_moments(
        true_accelerometer(),
        true_magnetometer(),
        case.attitudes,
        radians(dip_deg),
        accelerometer_std=case.accelerometer_std,
        magnetometer_std=case.magnetometer_std,
        g=G,
    )


def stated_row(case: Scenario, predicted: MagnetometerMoments) -> tuple[Row, ...]:
    """The covariance that the fit states at the truth, beside the bound."""
    fit = fitted(case, case.accelerometer, case.magnetometer)
    off = apart(fit.covariance, predicted.covariance)
    return exact(COVARIANCE_OFF("stated"), off, 0.0, CRAMER_RAO, MET)


def response_rows(
    poses: int, dip_deg: float, accelerometer_noise: float, field_noise: float
) -> tuple[Row, ...]:
    """Rows of theory beside the estimate; none for noises too unlike."""
    noise = np.array([accelerometer_noise, field_noise]) / LOUD
    if noise.max() > UNLIKE * noise.min():
        return ()
    case = scenario(min(poses, MOST), dip_deg, *(noise / noise.max() * LOUD))

    def estimate(x: Float[Array, "t d"]) -> Float[Array, "t 22"]:
        return fitted(case, *case.readings(x)).parameters

    # a step is `STEP` of the size of the noisier sensor's reading
    found = response(estimate, np.zeros(2 * case.accelerometer.size), STEP / LOUD)
    unit = np.ones(2 * case.accelerometer.size)
    predicted = predicted_moments(case, dip_deg)
    off = np.abs(predicted.bias - found.bias(unit)) / predicted.sd
    return (
        *exact(
            COVARIANCE_OFF("predicted"),
            apart(predicted.covariance, found.covariance(unit)),
            0.0, RESPONSE, MET_COVARIANCE,
        ),
        *exact(BIAS_OFF("predicted"), off.max(), 0.0, RESPONSE, MET_BIAS),
    )  # fmt: skip
