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


def sway(time, rng, size=1.0, terms=8):
    """Smooth rotation vectors with rests in between, exact at any time."""
    frequency = rng.uniform(0.1, 0.9, (terms, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (terms, 3))
    scale = size * rng.standard_normal((terms, 3)) / np.sqrt(terms)

    def vector(t):
        # still in [0, 6) and [26, 34) of each 40 s
        part = np.mod(t, 40.0)
        moving = np.clip(part - 6.0, 0.0, 20.0) + np.clip(part - 34.0, 0.0, 6.0)
        done = np.floor(t / 40.0) * 26.0 + moving
        eased = done - 20.0 * np.where(
            part < 34.0, _ripple(np.clip((part - 6.0) / 20.0, 0, 1)), 0.0
        )
        eased = eased - 6.0 * np.where(
            part >= 34.0, _ripple(np.clip((part - 34.0) / 6.0, 0, 1)), 0.0
        )
        angle = 2.0 * np.pi * eased[:, None, None] * frequency + phase
        return np.sum(scale * np.sin(angle), axis=1)

    return vector


def _ripple(u):
    # so that a motion begins and ends at rate zero: u - sin(2 pi u) / (2 pi) eased
    return np.sin(2.0 * np.pi * u) / (2.0 * np.pi)


def made(
    seed,
    *,
    seconds=80.0,
    rate=100.0,
    truth_rate=None,
    offset=0.013,
    drift=0.0,
    gyro_noise=2e-3,
    truth_noise=2e-4,
    bias=0.01,
    scale=0.0,
    field_noise=3e-7,
    force_noise=0.02,
    size=1.0,
    path="simulated",
    world=None,
    deviation=0.0,
):
    """A log whose truth has its own clock, body axes and world.

    The field is turned westwards by `deviation`, rad, and half of that to and fro.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / rate)
    truth_time = np.arange(0.0, seconds, 1.0 / (truth_rate or rate))
    vector = sway(time, rng, size)
    first = normalize(rng.standard_normal(4))

    def attitude(t):
        return compose(
            np.broadcast_to(first, (len(t), 4)), from_rotation_vector(vector(t))
        )

    fine = 4
    inner = (time[:-1, None] + np.arange(fine + 1) / fine / rate).ravel()
    A = attitude_matrix(attitude(inner)).reshape(len(time) - 1, fine + 1, 3, 3)

    q = attitude(inner).reshape(len(time) - 1, fine + 1, 4)
    d = turned(q[:, :-1], q[:, 1:])
    coning = 2.0 * np.cross(d[:, :-1], d[:, 1:]).sum(axis=1) / 24.0
    rates = np.concatenate([np.zeros((1, 3)), (d.sum(axis=1) - coning) * rate])
    true = attitude(time)
    A = attitude_matrix(true)
    bent = bias * rng.standard_normal(3)
    noise = scale * rng.standard_normal((3, 3))
    own = np.eye(3) + 0.5 * (noise + noise.T)  # no turn: that is the axes'
    gyro = rates @ own.T + bent + gyro_noise * rng.standard_normal(rates.shape)
    force = A @ np.array([0.0, 0.0, G]) + force_noise * rng.standard_normal(rates.shape)
    west = deviation * (1.0 + 0.7 * np.sin(time))
    turned_field = Rotation.from_rotvec(west[:, None] * [0, 0, 1]).apply(FIELD)
    field = np.matvec(A, turned_field) + field_noise * rng.standard_normal(rates.shape)
    axes = 0.3 * rng.standard_normal(3)
    drawn = from_rotation_vector(rng.standard_normal(3))
    world = (
        drawn if world is None else from_rotation_vector(np.array(world, dtype=float))
    )
    middle = time.mean()
    seen = (truth_time - offset + drift * middle) / (1.0 + drift)  # log's clock
    # A_sensor = A(axes) A_marker, and the truth's world is A(world) of NWU
    marker = compose(
        compose(
            np.broadcast_to(conjugate(world), (len(truth_time), 4)),
            attitude(seen),
        ),
        np.broadcast_to(conjugate(from_rotation_vector(axes)), (len(truth_time), 4)),
    )
    noisy = compose(
        marker,
        from_rotation_vector(truth_noise * rng.standard_normal((len(truth_time), 3))),
    )
    rests = [
        [int((start + 0.5) * rate), int(min(stop - 0.5, seconds - 0.1) * rate)]
        for begin in np.arange(0.0, seconds, 40.0)
        for start, stop in ((begin, begin + 6.0), (begin + 26.0, begin + 34.0))
        if stop < seconds
    ]
    return Made(
        time=time,
        gyro=gyro,
        force=force,
        field=field,
        rests=rests,
        truth=Truth(
            path=path,
            time=truth_time,
            components=noisy,
            scalar="unstated",
            columns=("q0", "q1", "q2", "q3"),
            own_clock=truth_rate is not None,
        ),
        offset=offset,
        axes=axes,
        world=attitude_matrix(world),
        attitude=true,
    )


def write_log(path, log, *, truth=True):
    """Write a log as text, with its truth beside the readings on the same clock."""
    header = "t [s],ax [m/s^2],ay [m/s^2],az [m/s^2],wx [rad/s],wy [rad/s],wz [rad/s]"
    header += ",mx [T],my [T],mz [T]"
    columns = [log.time, log.force, log.gyro, log.field]
    if truth:
        header += ",opt_q_0,opt_q_1,opt_q_2,opt_q_3"
        columns.append(log.truth.components)
    return str(written(Path(path), header, *columns))
