"""Drivers of scenes in which a motor or a hand moves the body and lets it rest."""

import numpy as np
from numpy.typing import NDArray

from simval.arguments import whole_number
from simval.arrays import Array, finite_array
from simval.errors import InputError
from simval.geometry import normalize
from simval.poses import fibonacci_sphere
from simval.scene.library import mujoco
from simval.scene.motion import steps, visit
from simval.scene.script import Script
from simval.shapes import Float
from simval.streams import cell_key, stream

MOST_POSES = 100_000  # of a hundred rows each, which is `motion.MOST_ROWS`
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def pose_directions(poses: object) -> Float[Array, "k 3"]:
    """Unit directions of the specific force: given ones, or a number of them.

    Raises
    ------
    InputError
        If there is none, or a vector is zero.
    """
    if isinstance(poses, int | float | np.number):
        return fibonacci_sphere(whole_number("poses", poses, 1, MOST_POSES))
    given = normalize(finite_array("poses", poses, (None, 3)))
    if given.ndim != 2 or len(given) == 0:
        msg = f"`poses` has shape {given.shape}; (k, 3) with k of 1 or more"
        raise InputError(msg)
    return given


def gimbal_angles(directions: Float[Array, "k 3"]) -> Float[Array, "k 3"]:
    r"""Yaw, pitch and roll that put a direction along the world's vertical.

    With :math:`R_{wb} = R_z(\psi) R_y(\theta) R_x(\phi)` the vertical has the body
    coordinates :math:`[-\sin\theta, \sin\phi\cos\theta, \cos\phi\cos\theta]`. Yaw is
    free; it advances by the golden angle, so that the field is seen from all sides.
    """
    x, y, z = directions.T
    pitch = np.arctan2(-x, np.hypot(y, z))
    roll = np.arctan2(y, z)
    yaw = (GOLDEN_ANGLE * np.arange(len(x)) + np.pi) % (2.0 * np.pi) - np.pi
    return np.stack([yaw, pitch, roll], axis=1)


def tour(
    poses: object,
    timestep: float,
    first_hold: float,
    move_time: float,
    settle_time: float,
    hold_time: float,
) -> tuple[Array, NDArray[np.intp]]:
    """Gimbal angles of a tour of poses, and its planned rests."""
    return visit(
        gimbal_angles(pose_directions(poses)),
        steps(first_hold, timestep, "first_hold"),
        steps(move_time, timestep, "move_time"),
        steps(settle_time, timestep, "settle_time"),
        steps(hold_time, timestep, "hold_time"),
    )


def drive_gimbal(
    model: "mujoco.MjModel",
    *,
    poses: object = 40,
    first_hold: float = 1.0,
    move_time: float = 1.0,
    settle_time: float = 0.6,
    hold_time: float = 1.0,
) -> Script:
    """Tumble the gimbal through poses, with a rest in each."""
    times = (first_hold, move_time, settle_time, hold_time)
    angles, rests = tour(poses, model.opt.timestep, *times)
    return Script(
        hold=rests,
        inputs={"ctrl": angles},
        qpos=gimbal_angles(pose_directions(poses))[0],
        rest_force=1e-12,
        rest_rate=1e-10,
    )


def drive_shaker(
    model: "mujoco.MjModel",
    *,
    poses: int = 40,
    move_time: float = 1.5,
    settle_time: float = 2.0,
    hold_time: float = 1.0,
    seed: int = 0,
) -> Script:
    """Tip a closed box about two axes, again and again, with a die loose inside."""
    h = model.opt.timestep
    poses = whole_number("poses", poses, 1)
    rng = stream(seed, cell_key("shaker"), 0)
    angles = rng.uniform(-np.pi, np.pi, (poses, model.nu))
    angles[0] = 0.0
    settle = steps(settle_time, h, "settle_time")
    hold = steps(hold_time, h, "hold_time")
    targets, rests = visit(
        angles, settle + hold, steps(move_time, h, "move_time"), settle, hold
    )
    rests[:settle] = -1  # the die drops first
    return Script(
        hold=rests,
        inputs={"ctrl": targets},
        rest_force=1e-3,
        rest_rate=1e-3,
        strict=False,
    )
