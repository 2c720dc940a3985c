"""The simulation of scenes beside MuJoCo's own bare loop over the same model.

Both do the same work: the loop cannot change its inputs, so both hold the scene's
last ones.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from simval.arrays import Array
from simval.scene.engine import last_row, roll_out
from simval.scene.library import mujoco
from simval.scene.messages import captured_messages
from simval.scene.run import plan_run
from simval.shapes import Float

TOGETHER = 8  # as `many` takes
MOST_STEPS = 10_000  # for the time of a race


@dataclass(frozen=True, slots=True, kw_only=True)
class Both:
    """The two ways to advance a scene; each gives the last row of each run."""

    simulated: Callable[[], Float[Array, "runs 14"]]
    bare: Callable[[], Float[Array, "runs 14"]]
    steps: int  # of all runs


def scene_and_bare_loop(name: str) -> Both:
    """Make the two ways to advance a scene, for a race."""
    plan = plan_run(name)
    model, steps = plan.physics.model, min(len(plan.script.hold), MOST_STEPS)
    held = {
        field: np.repeat(value[-1:], steps, axis=0)
        for field, value in plan.script.inputs.items()
    }
    script = replace(plan.script, inputs=held, hold=plan.script.hold[:steps])
    data = mujoco.MjData(model)

    def simulated() -> Float[Array, "runs 14"]:
        return roll_out(model, [script] * TOGETHER).rows[:, -1]

    def bare() -> Float[Array, "runs 14"]:
        last = []
        with captured_messages():
            for _ in range(TOGETHER):
                mujoco.mj_resetData(model, data)
                if script.qpos is not None:
                    data.qpos[:] = script.qpos
                if script.qvel is not None:
                    data.qvel[:] = script.qvel
                for field, value in held.items():
                    getattr(data, field).flat = value[-1]
                mujoco.mj_step(model, data, steps)
                last.append(last_row(model, data))
        return np.array(last)

    return Both(simulated=simulated, bare=bare, steps=TOGETHER * steps)
