"""Drivers of scenes in which nothing holds the body: it spins, and never rests."""

import numpy as np

from simval.arrays import nonnegative_number, positive_number
from simval.errors import InputError
from simval.scene.library import mujoco
from simval.scene.models import SITE
from simval.scene.motion import require_rows, steps
from simval.scene.script import Script

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
