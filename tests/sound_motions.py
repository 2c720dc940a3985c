"""Sound logs of three sensors in SI units, moved in ways that tell much or little.

Accelerometers are off by up to 20 % and 0.3 g on an axis, gyroscopes by 5 %,
magnetometers by 30 % and hard iron of up to twenty fields, in fields of 20 to 100 uT.
"""

import numpy as np
from made_logs import Motion
from scipy.spatial.transform import Rotation

from simval.imu.logs import Column, Log
from simval.imu.logs.columns import ROLES
from simval.poses import cube_faces

G = 9.80665
HEADER = {"force": "{} [m/s^2]", "gyro": "{} [rad/s]", "mag": "{} [uT]"}
SECONDS = 60.0


def _waves(rng, t, size, low, high):
    f, phase = rng.uniform(low, high, (6, 1)), rng.uniform(0.0, 6.3, (6, 1, 3))
    return (
        size
        / np.sqrt(3.0)
        * np.sin(2.0 * np.pi * f[..., None] * t[:, None] + phase).sum(0)
    )


def _yaw(angle):
    return Rotation.from_rotvec(np.c_[0 * angle, 0 * angle, angle])


def table(rng, t):
    """Twenty rests all over the sphere."""
    return Motion(rng, 20, (2.0, 3.0), (0.6, 1.5), 8.0).attitude(t)[0], 0.0


def faces(rng, t):
    """Rests on six faces and six tilts of them."""
    up = rng.permutation(np.r_[cube_faces(), cube_faces() + rng.normal(0, 0.2, (6, 3))])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    return Motion(rng, up, (3.0, 4.0), (0.6, 1.5), 5.0).attitude(t)[0], 0.0


def still(rng, t):
    """One pose."""
    return Rotation.random(rng=rng) * _yaw(0.0 * t), 0.0


def turntable(rng, t):
    """Turns about the vertical, which gravity does not show."""
    return _yaw(np.clip(t - 4.0, 0.0, None) * rng.uniform(0.5, 3.0)), 0.0


def circle(rng, t):
    """A vehicle on a flat circle."""
    w, v = rng.uniform(0.1, 0.5), rng.uniform(2.0, 12.0)
    on = np.clip((t - 4.0) / 10.0, 0.0, 1.0)
    return _yaw(w * np.cumsum(on) * (t[1] - t[0])), _yaw(w * t).apply(
        [0, v * w, 0]
    ) * on[:, None]


def banking(rng, t):
    """A rotor's craft, whose force stays along its own axis."""
    turn = Rotation.from_rotvec(
        _waves(rng, t, 0.2, 0.1, 0.5) * np.clip(t - 4, 0, 1)[:, None]
    )
    push = turn.apply([0.0, 0.0, G]) - [0.0, 0.0, G]
    return turn, push * [1.0, 1.0, 0.1] + _waves(rng, t, 1.0, 5.0, 9.0)


def pendulum(rng, t):
    """A swing, whose acceleration hides a part of the tilt, or doubles it."""
    swing = rng.uniform(0.2, 1.0) * np.sin(2 * np.pi * rng.uniform(0.3, 1.0) * t)
    turn = Rotation.from_rotvec(
        np.c_[swing, 0 * t, 0 * t] * np.clip(t - 4, 0, 1)[:, None]
    )
    across = turn.apply([0.0, 1.0, 0.0])
    return turn, -rng.uniform(-0.5, 1.2) * G * across[:, 2:] * across


def boat(rng, t):
    """Slow and small rolls without a rest."""
    return Rotation.from_rotvec(_waves(rng, t, 0.15, 0.1, 0.2)), _waves(
        rng, t, 0.8, 0.1, 0.2
    )


def tumble(rng, t):
    """Turns by hand after a rest, the hand going to and fro."""
    on = np.clip((t - 4.0) / 2.0, 0.0, 1.0)[:, None]
    turn = Rotation.from_rotvec(on * _waves(rng, t, 1.0, 0.05, 0.3))
    return turn, on * _waves(rng, t, 1.0, 0.3, 1.0)


MOTIONS = (table, faces, still, turntable, circle, banking, pendulum, boat, tumble)


def sound(motion, seed, size=1.0, header=HEADER):
    """A log, its sensors off by `size` times what the head of this file says."""
    rng = np.random.default_rng([seed, MOTIONS.index(motion)])
    rate = float(rng.choice([20.0, 50.0, 100.0]))
    t = np.arange(0.0, SECONDS, 1.0 / rate)
    body, acceleration = motion(rng, t)
    turns = np.zeros((len(t), 3))
    turns[1:] = (body[:-1].inv() * body[1:]).as_rotvec() * rate
    dip, strength = np.radians(rng.uniform(-80.0, 80.0)), rng.uniform(20.0, 100.0)
    field = strength * np.array([np.cos(dip), 0.0, -np.sin(dip)])
    up = acceleration + np.array([0.0, 0.0, G])
    iron = strength * size * 10 ** rng.uniform(-1.5, 1.3) * rng.normal(0.0, 0.6, 3)

    def read(true, scale, off, noise):
        gain = np.diag(1.0 + size * rng.uniform(-scale, scale, 3))
        gain += 0.02 * size * rng.normal(0.0, 1.0, (3, 3))
        return true @ gain.T + off + noise * rng.standard_normal(true.shape)

    upright, even = 0.0 * turns + up, 0.0 * turns + field
    return log_of(
        t,
        read(body.inv().apply(upright), 0.2, size * rng.uniform(-3.0, 3.0, 3), 0.03),
        read(turns, 0.05, size * rng.normal(0.0, 0.03, 3), 3e-3),
        read(body.inv().apply(even), 0.3, iron, 0.3),
        header,
    )


def log_of(time, force, gyro, field, header=HEADER):
    """A log of these rows under this header."""
    columns = [
        Column(role=role, place=place, name=header[kind].format(role))
        for place, (kind, role) in enumerate(
            (kind, role) for kind, roles in ROLES.items() for role in roles
        )
    ]
    return Log(
        path="log", time=time, accelerometer=force, gyro=gyro, magnetometer=field,
        rate=(len(time) - 1) / (time[-1] - time[0]), columns=tuple(columns),
    )  # fmt: skip
