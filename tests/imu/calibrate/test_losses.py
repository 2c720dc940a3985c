"""Robust losses: efficiency, scale, and the factors of their stated covariance.

The oracle knows the loss by its own formula, takes derivatives numerically and works
in raw units with the parameters that the fit returns.
"""

import numpy as np
import pytest
from scipy import integrate, stats

from simval.imu.calibrate import calibrate
from simval.imu.calibrate.residuals import LOSSES
from simval.imu.sensor import AccelerometerModel
from simval.poses import fibonacci_sphere

G = 9.80665
SIGMA = 0.02
SENSOR = AccelerometerModel.from_parameters(
    [0.03, -0.02, 0.05, 2.0, 1.6, 2.4, 0.3, -0.2, 0.1]
)
# influence function, its derivative, and the scale over the standard deviation
LAWS = {
    "huber": (lambda r: np.clip(r, -1, 1), lambda r: (abs(r) < 1) * 1.0, 1.345),
    "soft_l1": (
        lambda r: r / np.sqrt(1 + r * r),
        lambda r: (1 + r * r) ** -1.5,
        1.345,
    ),
    "cauchy": (
        lambda r: r / (1 + r * r),
        lambda r: 1 / (1 + r * r) - 2 * r * r / (1 + r * r) ** 2,
        2.385,
    ),
}
EFFICIENCY = {"huber": 0.950, "soft_l1": 0.954, "cauchy": 0.950}


@pytest.mark.parametrize("loss", LAWS)
def test_the_tuning_gives_the_stated_efficiency(loss):
    """(E psi')^2 / E psi^2 of a standard normal, by quadrature of the code's weight."""
    tuning, law = LOSSES[loss].tuning, LOSSES[loss]

    def mean(function):
        pieces = [(0.0, tuning), (tuning, 12.0)]  # Huber's corner between them
        parts = [
            integrate.quad(lambda x: function(x) * stats.norm.pdf(x), *ends)[0]
            for ends in pieces
        ]
        return 2.0 * sum(parts)

    slope = mean(lambda x: float(law.slope(np.array(x / tuning))))
    square = mean(lambda x: (x * float(law.weight(np.array(x / tuning)))) ** 2)
    # three digits are stated; one per cent of the tuning moves the efficiency by 0.001
    assert slope**2 / square == pytest.approx(EFFICIENCY[loss], abs=5e-4)


def distances(parameters, y):
    """First-order distance of each reading to the ellipsoid, raw units."""
    sensor = AccelerometerModel.from_parameters(parameters)
    force = (y - sensor.B) @ sensor.matrix.T
    gradient = 2.0 * force @ sensor.matrix
    return (np.sum(force**2, axis=1) - G**2) / np.linalg.norm(gradient, axis=1)


def derivatives(function, parameters):
    """Jacobian by central differences."""
    off = [function(parameters + step) - function(parameters - step)
           for step in 1e-6 * np.eye(9)]  # fmt: skip
    return np.array(off).T / 2e-6


def norms(parameters, y):
    sensor = AccelerometerModel.from_parameters(parameters)
    return np.sum(((y - sensor.B) @ sensor.matrix.T) ** 2, axis=1)


def noisy(count, seed, sigma):
    clean = SENSOR.distort(G * fibonacci_sphere(count), np.random.default_rng(0))
    noise = np.random.default_rng(seed).standard_normal((count, 3))
    y = clean + np.asarray(sigma).reshape(-1, 1) * noise
    y[4] += 0.3 * SENSOR.B  # one reading off by some standard deviations
    return y


def scale_of(distance):
    """Median absolute one over that of a normal law, nine distances fitted."""
    n = len(distance)
    median = np.median(abs(distance)) / stats.norm.ppf(0.75)
    return median * np.sqrt(n / (n - 9))


def huber_variance(loss, standard):
    """Huber's variance of a standardised residual, kappa and all."""
    psi, slope, tuning = LAWS[loss]
    n, each = len(standard), slope(standard / tuning)
    kappa = 1 + 9 / n * each.var() / each.mean() ** 2
    pull = tuning * psi(standard / tuning)
    return kappa**2 * np.sum(pull**2) / (n - 9) / each.mean() ** 2


UNEVEN = np.where(np.arange(24) % 3, 0.01, 0.04)
TOLD = {  # noise of the readings, and of each residual by what is told
    "found": (SIGMA, None, lambda d: scale_of(d)),
    "known": (SIGMA, SIGMA, lambda d: SIGMA),
    "of each pose": (UNEVEN, UNEVEN, lambda d: UNEVEN),
    "the greatest": (UNEVEN, UNEVEN, lambda d: 0.04),
}
FITS = [
    *((loss, residual, told) for loss in LAWS for residual in ("squared", "weighted")
      for told in ("found", "known")),
    ("huber", "weighted", "of each pose"), ("soft_l1", "squared", "the greatest"),
]  # fmt: skip


@pytest.mark.parametrize(("loss", "residual", "told"), FITS)
def test_the_fit_and_its_covariance_are_those_of_the_formula(loss, residual, told):
    sigma, given, scale_by = TOLD[told]
    y = noisy(24, 7, sigma)
    fit = calibrate(y, G, loss=loss, residual=residual, noise_std=given)
    assert fit.status == "converged"
    distance = distances(fit.parameters, y)
    scale = scale_by(distance) * np.ones(24)
    psi, _, tuning = LAWS[loss]
    slopes = derivatives(lambda p: norms(p, y), fit.parameters)
    steep = (norms(fit.parameters, y) - G**2) / distance  # of |f|^2 along the reading
    share = 1.0 / (steep * scale) ** 2 if residual == "weighted" else np.ones(24)
    # the estimate solves sum w(r) a c dc = 0: its value is a step of at most 1e-4 of a
    # standard deviation. A scale held after ten rounds is that of the end within 1e-4.
    pull = share * steep * psi(distance / (tuning * scale)) * tuning * scale
    inverse = np.linalg.inv(slopes.T @ (share[:, None] * slopes))
    assert np.all(abs(inverse @ slopes.T @ pull) < 1e-3 * fit.sd)
    # stated covariance (U1) with (U3)
    middle = slopes.T @ ((share * steep * scale)[:, None] ** 2 * slopes)
    expected = huber_variance(loss, distance / scale) * inverse @ middle @ inverse
    np.testing.assert_allclose(fit.sd, np.sqrt(np.diagonal(expected)), rtol=1e-3)
