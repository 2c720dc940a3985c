"""Driver of the hand-held scene: a trembling hand carries a body through poses."""

import numpy as np
import scipy

from simval.arrays import Array, nonnegative_number
from simval.scene.driven import tour
from simval.scene.library import mujoco
from simval.scene.models import SITE
from simval.scene.motion import steps
from simval.scene.script import Script
from simval.shapes import Float
from simval.streams import cell_key, stream

TREMOR_BAND = (6.0, 12.0)  # Hz, physiological tremor of a hand
SINES = 5  # in each axis' tremor


def drive_handheld(
    model: "mujoco.MjModel",
    *,
    poses: object = 40,
    first_hold: float = 1.0,
    move_time: float = 1.0,
    settle_time: float = 0.6,
    hold_time: float = 1.0,
    tremor_angle: float = 3e-4,
    tremor_path: float = 3e-5,
    seed: int = 0,
) -> Script:
    r"""Carry a body through poses in a hand that trembles."""
    angle = nonnegative_number("tremor_angle", tremor_angle, "rad")
    path = nonnegative_number("tremor_path", tremor_path, "m")
    h = model.opt.timestep
    times = (first_hold, move_time, settle_time, hold_time)
    angles, rests = tour(poses, h, *times)
    # the grip starts without tremor and settles before the first rest counts
    rests[: min(steps(0.5, h, "grip"), len(rests))] = -1
    rng = stream(seed, cell_key("handheld"), 0)
    shake = tremor(len(rests), h, angle, rng)
    shift = tremor(len(rests), h, path, rng)
    rotation = scipy.spatial.transform.Rotation
    turn = rotation.from_euler("ZYX", angles) * rotation.from_rotvec(shake)
    quaternion = _continuous(turn.as_quat(scalar_first=True))
    position = model.body_pos[model.body("hand").id] + shift
    start = np.concatenate([position[0], quaternion[0]])
    fastest = 2.0 * np.pi * TREMOR_BAND[1]
    arm = float(np.linalg.norm(model.site(SITE).pos))
    swing = np.sqrt(3.0) * fastest * angle
    jolt = np.sqrt(3.0) * fastest**2 * (path + arm * angle) + arm * swing**2
    return Script(
        hold=rests,
        inputs={"mocap_pos": position, "mocap_quat": quaternion},
        qpos=start,
        rest_force=jolt + 1e-4,
        rest_rate=swing + 1e-4,
    )


def tremor(
    count: int, timestep: float, amplitude: float, rng: np.random.Generator
) -> Float[Array, "count 3"]:
    """Band-limited tremor of three axes."""
    frequency = rng.uniform(*TREMOR_BAND, (SINES, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (SINES, 3))
    time = timestep * np.arange(count)[:, None, None]
    waves = np.sin(2.0 * np.pi * frequency * time + phase)
    mean: Array = amplitude * waves.mean(axis=1)
    return mean


def _continuous(quaternion: Float[Array, "n 4"]) -> Float[Array, "n 4"]:
    # the sign that follows the row before: q and -q are one attitude, a jump is not
    dots = np.sum(quaternion[1:] * quaternion[:-1], axis=1)
    sign = np.concatenate([[1.0], np.cumprod(np.where(dots < 0.0, -1.0, 1.0))])
    return quaternion * sign[:, None]
