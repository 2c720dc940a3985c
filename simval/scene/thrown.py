"""Drivers of scenes in which contacts decide where the body comes to rest."""

import numpy as np

from simval.arguments import whole_number
from simval.arrays import Array
from simval.geometry import normalize, random_quaternions
from simval.scene.library import mujoco
from simval.scene.motion import require_rows, steps
from simval.scene.script import Script
from simval.shapes import Float
from simval.streams import cell_key, stream

KICK_TIME = 0.02  # s
STANDARD_G = 9.80665  # m/s^2


def drive_thrown(
    model: "mujoco.MjModel",
    *,
    poses: int = 40,
    settle_time: float = 2.5,
    hold_time: float = 1.0,
    kick_speed: float = 1.8,
    kick_rate: float = 20.0,
    seed: int = 0,
) -> Script:
    """Kick a body up from the floor, let it tumble and come to rest, and again."""
    h = model.opt.timestep
    rng = stream(seed, cell_key("thrown"), 0)
    settle = steps(settle_time, h, "settle_time")
    block = settle + steps(hold_time, h, "hold_time")
    poses = whole_number("poses", poses, 1)
    require_rows(poses * block)
    kick = max(steps(KICK_TIME, h, "kick"), 1)
    axes = normalize(rng.standard_normal((poses, 3)))
    axes[0] = 0.0  # the first throw is the drop
    body = model.body("body").id
    wrench = np.zeros((poses, block, model.nbody, 6))
    lift = model.body_mass[body] * (kick_speed / (kick * h) + STANDARD_G)
    wrench[1:, :kick, body, 2] = lift
    twist = model.body_inertia[body].mean() * kick_rate / (kick * h)
    wrench[:, :kick, body, 3:] = twist * axes[:, None]
    rests = np.full((poses, block), -1)
    rests[:, settle:] = np.arange(poses)[:, None]
    return Script(
        hold=rests.reshape(-1),
        inputs={"xfrc_applied": wrench.reshape(poses * block, -1)},
        qpos=_dropped(model, rng),
        rest_force=1e-6,
        rest_rate=1e-6,
        strict=False,
    )


def _dropped(model: "mujoco.MjModel", rng: np.random.Generator) -> Float[Array, " nq"]:
    # the model's own position with a random attitude (scalar first for MuJoCo)
    qpos = np.array(model.qpos0)
    start = model.jnt_qposadr[model.body_jntadr[model.body("body").id]] + 3
    qpos[start : start + 4] = np.roll(random_quaternions(1, rng)[0], 1)
    return qpos
