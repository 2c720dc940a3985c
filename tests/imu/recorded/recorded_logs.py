"""Simulated logs with a recorded truth of which everything is known."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from written import written

from simval.geometry import (
    attitude_matrix,
    compose,
    conjugate,
    from_rotation_vector,
    normalize,
)
from simval.imu.logs import Truth
from simval.imu.recorded.attitudes import turned

G = 9.81
FIELD = 48e-6 * np.array([np.cos(1.1), 0.0, -np.sin(1.1)])


@dataclass(frozen=True, kw_only=True)
class Made:
    """A log, its truth, and what lies between them."""

    time: np.ndarray
    gyro: np.ndarray
    force: np.ndarray
    field: np.ndarray
    rests: list
    truth: Truth
    offset: float
    axes: np.ndarray  # rotation vector from the truth's body to the sensor
    world: np.ndarray  # A: from NWU to the truth's world
    attitude: np.ndarray  # true, NWU to sensor


def sway(rng, size=1.0, terms=8):
    """Smooth rotation vectors with rests in between, exact at any time.

    Still in [0, 6) and [26, 34) of each 40 s; a motion begins and ends at rate zero.
    """
    frequency = rng.uniform(0.1, 0.9, (terms, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (terms, 3))
    scale = size * rng.standard_normal((terms, 3)) / np.sqrt(terms)

    def vector(t):
        part, done = np.mod(t, 40.0), np.floor(t / 40.0) * 26.0
        for start, long in ((6.0, 20.0), (34.0, 6.0)):
            u = np.clip((part - start) / long, 0.0, 1.0)
            done = done + long * (u - np.sin(2.0 * np.pi * u) / (2.0 * np.pi))
        angle = 2.0 * np.pi * done[:, None, None] * frequency + phase
        return np.sum(scale * np.sin(angle), axis=1)

    return vector


def made(
    seed, *, seconds=80.0, rate=100.0, truth_rate=None, offset=0.013, drift=0.0,
    gyro_noise=2e-3, truth_noise=2e-4, bias=0.01, scale=0.0, field_noise=3e-7,
    force_noise=0.02, world=None, deviation=0.0,
):  # fmt: skip
    """A log whose truth has its own clock, body axes and world.

    The field is turned westwards by `deviation`, rad, and half of that to and fro.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / rate)
    truth_time = np.arange(0.0, seconds, 1.0 / (truth_rate or rate))
    vector, first = sway(rng), normalize(rng.standard_normal(4))

    def noise(size, like=time):
        return size * rng.standard_normal((len(like), 3))

    def attitude(t):
        return compose(first, from_rotation_vector(vector(t)))

    fine = 4
    inner = (time[:-1, None] + np.arange(fine + 1) / fine / rate).ravel()
    q = attitude(inner).reshape(len(time) - 1, fine + 1, 4)
    d = turned(q[:, :-1], q[:, 1:])
    coning = 2.0 * np.cross(d[:, :-1], d[:, 1:]).sum(axis=1) / 24.0
    rates = np.concatenate([np.zeros((1, 3)), (d.sum(axis=1) - coning) * rate])
    true = attitude(time)
    A = attitude_matrix(true)
    bent = bias * rng.standard_normal(3)
    own = scale * rng.standard_normal((3, 3))
    own = np.eye(3) + 0.5 * (own + own.T)  # no turn: that is the axes'
    gyro = rates @ own.T + bent + noise(gyro_noise)
    force = A @ np.array([0.0, 0.0, G]) + noise(force_noise)
    west = deviation * (1.0 + 0.7 * np.sin(time))
    deviated = Rotation.from_rotvec(west[:, None] * [0, 0, 1]).apply(FIELD)
    field = np.matvec(A, deviated) + noise(field_noise)
    axes, drawn = 0.3 * rng.standard_normal(3), rng.standard_normal(3)
    world = from_rotation_vector(np.array(drawn if world is None else world, float))
    seen = (truth_time - offset + drift * time.mean()) / (1.0 + drift)  # log's clock
    # A_sensor = A(axes) A_marker, and the truth's world is A(world) of NWU
    body = conjugate(from_rotation_vector(axes))
    marker = compose(compose(conjugate(world), attitude(seen)), body)
    noisy = compose(marker, from_rotation_vector(noise(truth_noise, truth_time)))
    rests = [
        [int((start + 0.5) * rate), int(min(stop - 0.5, seconds - 0.1) * rate)]
        for begin in np.arange(0.0, seconds, 40.0)
        for start, stop in ((begin, begin + 6.0), (begin + 26.0, begin + 34.0))
        if stop < seconds
    ]
    truth = Truth(
        path="simulated", time=truth_time, components=noisy, scalar="unstated",
        columns=("q0", "q1", "q2", "q3"), own_clock=truth_rate is not None,
    )  # fmt: skip
    return Made(
        time=time, gyro=gyro, force=force, field=field, rests=rests, truth=truth,
        offset=offset, axes=axes, world=attitude_matrix(world), attitude=true,
    )  # fmt: skip


def write_log(path, log, *, truth=True, field=True):
    """Write a log as text, with its truth beside the readings on the same clock."""
    header = "t [s],ax [m/s^2],ay [m/s^2],az [m/s^2],wx [rad/s],wy [rad/s],wz [rad/s]"
    columns = [log.time, log.force, log.gyro]
    if field:
        header += ",mx [T],my [T],mz [T]"
        columns.append(log.field)
    if truth:
        header += ",opt_q_0,opt_q_1,opt_q_2,opt_q_3"
        columns.append(log.truth.components)
    return str(written(Path(path), header, *columns))
