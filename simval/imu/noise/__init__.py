r"""Noise model of a sensor at rest: white noise, bias instability, random walk.

Each axis has white noise N, flicker B and a random walk K, and, if the data ask for it,
Markov noise, a ramp or a sine (`simval.imu.noise.evidence`). They are fitted to the
overlapping Allan variance, with its covariance in closed form
(`simval.imu.noise.allan`), by generalised least squares
(`simval.imu.noise.least_squares`). Each coefficient has an interval, or an upper bound
where the recording does not show it. Everything is in the readings' own unit; frames
and gravity play no role.
"""

from simval.imu.noise.allan import (
    allan_covariance,
    allan_law,
    allan_variance,
    averaging_counts,
    covariance_forms,
)
from simval.imu.noise.fit import noise_of
from simval.imu.noise.model import AxisNoise, Coefficient, NoiseFile, load_noise

__all__ = [
    "AxisNoise",
    "Coefficient",
    "NoiseFile",
    "allan_covariance",
    "allan_law",
    "allan_variance",
    "averaging_counts",
    "covariance_forms",
    "load_noise",
    "noise_of",
]
