"""Recordings of three sensors on one tumble, for the tests of their one fit."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from magnetometer_sets import FIELD, IRON, IRON_STD
from test_gyroscope_monte_carlo import path_of
from tumbles import ACCELEROMETER, GYROSCOPE, WALK, M, fitted, readings, tumble

from simval.calibrate import (
    calibrate,
    calibrate_gyroscope,
    calibrate_magnetometer,
    calibrate_nine_axis,
)
from simval.geometry import attitude_matrix
from simval.theory import nine_axis_moments

DIP = np.radians(60.0)
TRUTH = np.concatenate(
    [ACCELEROMETER.parameters, M.ravel(), GYROSCOPE.B, IRON.M.ravel(), IRON.b, [DIP]]
)
EVERY, ACC, GYRO, MAG = slice(None), slice(0, 9), slice(9, 21), slice(21, 34)


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

    gyroscope: object
    magnetometer: object
    fit: object
    moves: object

    @property
    def error(self):
        return self.fit.parameters - TRUTH


def drawn(truth, trials, rng, *, times=1.0):
    """Pose means of both sensors and rows of the gyroscope."""
    poses, rows = readings(truth, trials, rng, times=times)
    noise = rng.standard_normal((trials, len(truth.intervals), 3))
    return poses, rows, fields_of(truth) + times * IRON_STD * noise


def calibrated(
    truth,
    poses,
    rows,
    fields,
    *,
    chunk=2,
    form="triangular",
    times=1.0,
    weights="stated",
):
    """All fits of some trials, told noise of so many times the nominal one."""
    _, moves = fitted(truth, poses, rows, chunk=chunk)
    pose_std, walk, std = times * truth.pose_std, times * WALK, times * IRON_STD
    acc = calibrate(poses, truth.g, form, residual="weighted", noise_std=pose_std)
    noise = {"pose_std": pose_std, "angle_random_walk": walk}
    gyroscope = calibrate_gyroscope(moves, poses, acc, start=np.eye(3), **noise)
    magnetometer = calibrate_magnetometer(
        poses, fields, truth.g, FIELD, hemisphere="north",
        accelerometer_std=pose_std, magnetometer_std=std, model=form,
    )  # fmt: skip
    fit = calibrate_nine_axis(
        moves, poses, fields, gyroscope, magnetometer, field_std=std, **noise
    )
    return Three(gyroscope, magnetometer, fit, moves)


@cache
def bound(walk=WALK, field_std=IRON_STD, pieces=40):
    """Cramer-Rao bound of all 34 at a tumble of 40 poses."""
    truth = tumble()
    rows = np.diff(truth.intervals)[:, 0]
    margins = np.full(len(rows), 20)  # ten rows on either side are the moves'
    margins[[0, -1]] = 10
    seconds = (rows - margins).sum() * (truth.time[1] - truth.time[0])
    return nine_axis_moments(
        GYROSCOPE, ACCELEROMETER, IRON, attitudes(truth), DIP, path_of(truth, pieces),
        pose_std=truth.pose_std, field_std=field_std,
        bias_std=WALK / np.sqrt(seconds), g=truth.g, field=FIELD,
        angle_random_walk=walk,
    ).cramer_rao  # fmt: skip
