"""Pose sets of an accelerometer and a magnetometer, for their tests."""

from dataclasses import dataclass

import numpy as np

from simval.geometry import attitude_matrix, compose, random_quaternions
from simval.imu.calibrate import Recording, fit
from simval.imu.sensor import AccelerometerModel, MagnetometerModel

G = 9.80665
FIELD = 48.0  # microtesla
BODY = AccelerometerModel.from_parameters(
    np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
)
# x and y changed, z turned: the AK8963's order, with soft iron; raw units are counts
IRON = MagnetometerModel(
    M=np.array([[0.02, 1.1, 0.05], [0.97, -0.03, 0.02], [0.04, 0.01, -1.05]])
    * (FIELD / 500.0),
    b=np.array([100.0, -50.0, 80.0]),
)
BODY_STD, IRON_STD = 1e-3, 2.5  # 1e-4 g and half a percent of the field


@dataclass(frozen=True)
class Set:
    """Readings without noise, and what they were made from."""

    q: np.ndarray
    body: np.ndarray
    iron: np.ndarray
    truth: np.ndarray

    def noisy(self, trials, rng, body_std=BODY_STD, iron_std=IRON_STD):
        """Readings of some trials, each with noise of its own."""
        shape = (trials, *self.body.shape)
        return (
            self.body + body_std * rng.standard_normal(shape),
            self.iron + iron_std * rng.standard_normal(shape),
        )


def made(q, dip_deg=60.0, body=BODY, iron=IRON, field=FIELD):
    """Readings of both sensors in some attitudes."""
    dip, turn = np.radians(dip_deg), attitude_matrix(q)
    along = field * turn @ np.array([np.cos(dip), 0.0, -np.sin(dip)])
    quiet = np.random.default_rng(0)  # draws nothing
    return Set(
        q=q,
        body=body.distort(G * turn[:, :, 2], quiet),
        iron=iron.distort(along, quiet),
        truth=np.concatenate([body.parameters, iron.M.ravel(), iron.b, [dip]]),
    )


def random_set(count, seed, **options):
    """Readings in random attitudes."""
    return made(random_quaternions(count, np.random.default_rng(seed)), **options)


def random_sensors(rng):
    """Sensors within a tenth of square and equal, the magnetometer turned anyhow."""
    turn = attitude_matrix(random_quaternions(1, rng))[0]
    matrix = turn @ (np.eye(3) + 0.1 * rng.standard_normal((3, 3)))
    matrix *= np.sign(np.linalg.det(matrix)) * FIELD / 500.0
    off, scale = 0.05 * rng.standard_normal(3), 1.0 + 0.05 * rng.standard_normal(3)
    values = np.concatenate([off, scale, 0.5 * rng.standard_normal(3)])
    return (
        AccelerometerModel.from_parameters(values),
        MagnetometerModel(M=matrix, b=rng.uniform(-300.0, 300.0, 3)),
    )


def tilted(count, most_deg, seed):
    """Attitudes of any heading, tilted by no more than an angle."""
    rng = np.random.default_rng(seed)
    heading, toward = rng.uniform(0.0, 2.0 * np.pi, (2, count))
    tilt = np.radians(most_deg) * np.sqrt(rng.uniform(0.0, 1.0, count))
    s, c = np.sin(tilt / 2.0), np.cos(tilt / 2.0)
    level = np.stack([0 * s, 0 * s, np.sin(heading / 2), np.cos(heading / 2)], axis=1)
    tip = np.stack([s * np.cos(toward), s * np.sin(toward), 0 * s, c], axis=1)
    return compose(level, tip)


def squares(error, covariance):
    """Squared errors, normalised by the covariance that is stated for each."""
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    scaled = covariance / (sd[..., :, None] * sd[..., None, :])
    off = np.linalg.solve(scaled, (error / sd)[..., None])[..., 0]
    return np.vecdot(error / sd, off)


def compass_of(body, iron, **given):
    """Calibrate from the means of both sensors, by the noise of these sets."""
    how = {k: given.pop(k) for k in ("known",) if k in given}
    stated = {"pose_std": BODY_STD, "field_std": IRON_STD, "g": G, "field": FIELD}
    recording = Recording(poses=body, fields=iron, **stated | given)
    return fit(recording, **how).magnetometer
