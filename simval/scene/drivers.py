r"""Drivers of scenes: they move the body, and say when it should rest.

A motor or a hand moves it (gimbal, shaker, handheld), contacts decide where it comes to
rest (die, cube), or nothing holds it: it spins, and never rests (pivot, freefall).

A minimum-jerk move from 0 to 1 in the time 0 to 1 is

.. math:: s(t) = 10 t^3 - 15 t^4 + 6 t^5,  \tag{M1}

with zero velocity and acceleration at both ends (Flash and Hogan 1985).
"""

import numpy as np
import scipy

from simval.arguments import whole_number
from simval.arrays import (
    Array,
    Places,
    finite_array,
    nonnegative_number,
    positive_number,
)
from simval.errors import InputError
from simval.geometry import normalize, random_quaternions
from simval.poses import fibonacci_sphere
from simval.scene.physics import SITE, mujoco
from simval.scene.script import Script
from simval.shapes import Float
from simval.streams import cell_key, stream

MOST_ROWS = 10_000_000  # 1.1 GB of sensor data


def minimum_jerk(t: Float[Array, "..."]) -> Float[Array, "..."]:
    """Position along a minimum-jerk motion, eq. (M1)."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * t * (10.0 + t * (6.0 * t - 15.0))


def steps(seconds: float, timestep: float, name: str) -> int:
    """Number of steps in a duration of a day at most."""
    if not 0.0 <= seconds <= 86_400.0:
        msg = f"`{name}` is {seconds} s; it must be from 0 s to a day"
        raise InputError(msg)
    return round(seconds / timestep)


def require_rows(count: int) -> None:
    """Refuse a run with more rows than fit into memory."""
    if not count <= MOST_ROWS:
        msg = (
            f"the run would have {count} rows, and at most {MOST_ROWS} fit into "
            "memory; ask for fewer or shorter rests, or for a larger timestep"
        )
        raise InputError(msg)


def visit(
    poses: Float[Array, "k m"], first: int, move: int, settle: int, hold: int
) -> tuple[Float[Array, "n m"], Places]:
    """Targets that visit poses one after another, and the planned rests."""
    poses = np.asarray(poses)
    require_rows(first + (len(poses) - 1) * (move + settle + hold))
    after = minimum_jerk(np.arange(1, move + settle + hold + 1) / max(move, 1))
    ways = poses[:-1, None] + after[:, None] * np.diff(poses, axis=0)[:, None]
    ways = ways.reshape(-1, poses.shape[1])
    targets = np.concatenate([np.repeat(poses[:1], first, 0), ways])
    block = np.full((len(poses) - 1, move + settle + hold), -1)
    block[:, move + settle :] = np.arange(1, len(poses))[:, None]
    return targets, np.concatenate([np.zeros(first, int), block.reshape(-1)])


MOST_POSES = 100_000  # of a hundred rows each, which is `motion.MOST_ROWS`
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def pose_directions(poses: object) -> Float[Array, "k 3"]:
    """Unit directions of the specific force, given or spread evenly."""
    if isinstance(poses, int | float | np.number):
        return fibonacci_sphere(whole_number("poses", poses, 1, MOST_POSES))
    given = normalize(finite_array("poses", poses, (None, 3)))
    if given.ndim != 2 or len(given) == 0:
        msg = f"`poses` has shape {given.shape}; give (k, 3), with k of 1 or more"
        raise InputError(msg)
    return given


def gimbal_angles(directions: Float[Array, "k 3"]) -> Float[Array, "k 3"]:
    r"""Yaw, pitch and roll that turn a direction to the world's vertical.

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
) -> tuple[Array, Places]:
    """Gimbal angles of a tour through poses, and its planned rests."""
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


# the spin starts near the axis of intermediate inertia (y), where it is unstable: the
# body turns over again and again, and gravity is seen from all sides
AXIS = np.array([0.1, 1.0, 0.1]) / np.sqrt(1.02)


def drive_pivot(
    model: "mujoco.MjModel",
    *,
    spin_rate: float = 0.1,
    turns: float = 4.0,
    poses: int = 40,
    hold_time: float = 0.02,
) -> Script:
    r"""Spin a body slowly about a pivot and sample it as if it were at rest.

    The specific force differs from gravity by
    :math:`\alpha\times r+\omega\times(\omega\times r)`, which is of order
    :math:`\omega^2 r`: a model violation with two knobs.
    """
    spin_rate = positive_number("spin_rate", spin_rate, "rad/s")
    h = model.opt.timestep
    count = steps(turns * 2.0 * np.pi / spin_rate, h, "turns")
    require_rows(count)
    window = steps(hold_time, h, "hold_time")
    if not 1 <= poses * window <= count:
        msg = f"`poses` is {poses} of {window} rows; they must fit into {count} rows"
        raise InputError(msg)
    hold = np.full(count, -1)
    for k, start in enumerate(np.linspace(0, count - window, poses).astype(int)):
        hold[start : start + window] = k
    inertia = model.body_inertia[model.body("body").id]
    greatest = spin_rate * np.sqrt(np.sum(inertia * AXIS**2) / inertia.min())
    turning = (inertia.max() / inertia.min() - 1.0) / np.sqrt(3.0)
    arm = float(np.linalg.norm(model.site(SITE).pos))
    rounding = 1e-12  # m/s^2, as the gimbal's
    return Script(
        hold=hold,
        qvel=spin_rate * AXIS,
        rest_force=arm * greatest**2 * (1.0 + turning) + rounding,
        rest_rate=greatest * (1.0 + 1e-9),
    )


def drive_freefall(
    model: "mujoco.MjModel", *, spin_rate: float = 4.0, seconds: float = 20.0
) -> Script:
    """Let a spinning body fall: at its centre of mass it reads zero."""
    spin_rate = nonnegative_number("spin_rate", spin_rate, "rad/s")
    count = steps(seconds, model.opt.timestep, "seconds")
    require_rows(count)
    return Script(
        hold=np.full(count, -1),
        qvel=np.concatenate([np.zeros(3), spin_rate * AXIS]),
        rest_force=0.0,
        rest_rate=0.0,
    )


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
    angles, rests = tour(poses, h, first_hold, move_time, settle_time, hold_time)
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
    """Band-limited random tremor of three axes."""
    frequency = rng.uniform(*TREMOR_BAND, (SINES, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (SINES, 3))
    time = timestep * np.arange(count)[:, None, None]
    waves = np.sin(2.0 * np.pi * frequency * time + phase)
    return amplitude * waves.mean(axis=1)


def _continuous(quaternion: Float[Array, "n 4"]) -> Float[Array, "n 4"]:
    # the sign that follows the row before: q and -q are one attitude, a jump is not
    dots = np.sum(quaternion[1:] * quaternion[:-1], axis=1)
    sign = np.concatenate([[1.0], np.cumprod(np.where(dots < 0.0, -1.0, 1.0))])
    return quaternion * sign[:, None]


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
