"""Every bad value of every argument of sensors, noise and scenes ends in words."""

import numpy as np
import pytest
import test_public_faces as faces

from simval import scene
from simval.imu import noise, sensor

pytestmark = [pytest.mark.usefixtures("unchecked"), pytest.mark.ci]

RNG = np.random.default_rng(1)
SIGNALS = RNG.standard_normal((600, 3))
M = np.array([[1.0, 0.02, 0.0], [-0.01, 1.1, 0.03], [0.0, 0.01, 0.9]])
GYROSCOPE = sensor.GyroscopeModel(M=M, B=np.zeros(3), G=0.1 * np.eye(3))
NOISE = sensor.NoiseModel(white_raw_per_sqrt_hz=1.0)
MOTION = {"time": np.arange(14.0), "specific_force": SIGNALS[:14],
          "rate": SIGNALS[:14], "field": 1e-5 * SIGNALS[:14]}  # fmt: skip
ACCELEROMETER = sensor.AccelerometerModel(T=np.eye(3), K=np.ones(3), B=np.zeros(3))
IMU = sensor.ImuModel(accelerometer=ACCELEROMETER, gyroscope=GYROSCOPE)
RUN = scene.simulate("gimbal", poses=2, move_time=0.2, hold_time=0.1, first_hold=0.1)

FACES = {
    "GyroscopeModel": (
        sensor.GyroscopeModel,
        {"M": M, "B": np.zeros(3), "G": M, "angle_random_walk": 0.1},
        {"M": "array", "B": "array", "G": "array", "angle_random_walk": "number"},
    ),
    "distort gyroscope": (
        GYROSCOPE.distort,
        {"rate": SIGNALS[:9], "rng": RNG, "specific_force": SIGNALS[:9]},
        {"rate": "batch", "rng": "object", "specific_force": "batch"},
    ),
    "correct gyroscope": (
        GYROSCOPE.correct,
        {"raw": SIGNALS[:9], "specific_force": SIGNALS[:9]},
        {"raw": "batch", "specific_force": "batch"},
    ),
    "gyroscope_factors": (
        sensor.gyroscope_factors,
        {"M": M, "covariance": np.eye(9), "form": "polar"},
        {"M": "array", "covariance": "array", "form": "choice"},
    ),
    "NoiseModel": (
        sensor.NoiseModel,
        {name: 0.1 for name in sensor.NoiseModel.__dataclass_fields__},
        dict.fromkeys(sensor.NoiseModel.__dataclass_fields__, "noise"),
    ),
    "draw": (
        NOISE.draw,
        {"n": 5, "rate_hz": 50.0, "rng": RNG},
        {"n": "count", "rate_hz": "positive", "rng": "object"},
    ),
    "Motion": (sensor.Motion, MOTION, dict.fromkeys(MOTION, "array")),
    "ImuModel": (
        sensor.ImuModel,
        {"accelerometer": ACCELEROMETER, "gyroscope": GYROSCOPE,
         "clock_jitter_s": 0.0},
        {"accelerometer": "object", "gyroscope": "object", "clock_jitter_s": "number"},
    ),
    "read_imu": (
        sensor.read_imu,
        {"imu": IMU, "motion": sensor.Motion(**MOTION), "rng": RNG},
        {"imu": "object", "motion": "object", "rng": "object"},
    ),
    "load_imu": (sensor.load_imu, {"path": "/none/x"}, {"path": "path"}),
    "load_noise": (noise.load_noise, {"path": "/none/x"}, {"path": "path"}),
    "averaging_counts": (
        noise.averaging_counts,
        {"n": 600, "per_octave": 3},
        {"n": "count", "per_octave": "count"},
    ),
    "allan_variance": (
        noise.allan_variance,
        {"rows": SIGNALS, "counts": np.array([1.0, 2.0, 9.0])},
        {"rows": "any length", "counts": "array"},
    ),
    "covariance_forms": (
        noise.covariance_forms,
        {"counts": np.array([1.0, 2.0, 9.0]), "n": 600},
        {"counts": "array", "n": "count"},
    ),
    "noise_of": (
        noise.noise_of,
        {"rows": SIGNALS, "rate_hz": 100.0, "increments": False},
        {"rows": "array", "rate_hz": "positive", "increments": "switch"},
    ),
    "average_rates": (
        scene.average_rates,
        {"trajectory": RUN, "every": 2},
        {"trajectory": "object", "every": "count"},
    ),
}  # fmt: skip
ALLOWED = {
    ("GyroscopeModel", "G", "None"),
    ("gyroscope_factors", "covariance", "None"),
    ("gyroscope_factors", "covariance", "transposed"),  # the same
    ("NoiseModel", "ramp_raw_per_s", "negative"),  # it falls
    ("ImuModel", "gyroscope", "None"),
    ("allan_variance", "rows", "zero"),
}


@pytest.mark.parametrize("face", FACES)
def test_bad_values_are_refused_in_words(face):
    found, tried = faces.accepted(face, FACES, ALLOWED)
    assert found == []
    assert tried > 20
