"""Recordings of three sensors on one tumble, for the tests of their one fit."""

from dataclasses import dataclass

import numpy as np
from magnetometer_sets import FIELD, IRON, IRON_STD
from tumbles import ACCELEROMETER, GYROSCOPE, WALK, M, fitted, readings

from simval.geometry import attitude_matrix
from simval.imu.calibrate import Recording, fit
from simval.imu.calibrate.joint import together

DIP = np.radians(60.0)
TRUTH = np.concatenate(
    [ACCELEROMETER.parameters, M.ravel(), GYROSCOPE.B, IRON.M.ravel(), IRON.b, [DIP]]
)
ACC, GYRO, MAG = slice(0, 9), slice(9, 21), slice(21, 34)


def attitudes(truth):
    """True attitude of each rest."""
    return np.array([truth.attitude[(a + b) // 2] for a, b in truth.intervals])


def fields_of(truth):
    """Means of the magnetometer without noise."""
    along = np.array([np.cos(DIP), 0.0, -np.sin(DIP)])
    turned = FIELD * attitude_matrix(attitudes(truth)) @ along
    return IRON.distort(turned, np.random.default_rng(0))  # draws nothing


@dataclass(frozen=True)
class Three:
    """The fits of two sensors each, and that of all, of the same trials."""

    parts: dict
    fit: object
    recording: object

    @property
    def sensors(self):
        """Each sensor's part in the fit of two."""
        return {name: getattr(part, name) for name, part in self.parts.items()}

    gyroscope = property(lambda self: self.sensors["gyroscope"])
    magnetometer = property(lambda self: self.sensors["magnetometer"])


def drawn(truth, trials, rng):
    """Pose means of both sensors and rows of the gyroscope."""
    poses, rows = readings(truth, trials, rng)
    noise = rng.standard_normal((trials, len(truth.intervals), 3))
    return poses, rows, fields_of(truth) + IRON_STD * noise


def calibrated(truth, poses, rows, fields):
    """All fits of some trials."""
    acc, inter_rest = fitted(truth, poses, rows)
    recording = Recording(
        poses=poses, pose_std=truth.pose_std, fields=fields, field_std=IRON_STD,
        rotations=inter_rest, angle_random_walk=WALK, accelerometer=acc, g=truth.g,
        field=FIELD, hemisphere="north",
    )  # fmt: skip
    parts = {
        name: fit(recording, [name], start=np.eye(3)) for name in recording.sensors
    }
    return Three(parts, together(recording, parts), recording)
