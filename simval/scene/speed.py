"""The simulation of scenes beside MuJoCo's own bare loop over the same model.

Both do the same work: the loop cannot change its inputs, so both hold the scene's
last ones.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from simval.scene.engine import roll_out
from simval.scene.library import mujoco
from simval.scene.messages import captured_messages
from simval.scene.run import plan_run

TOGETHER = 8  # as `many` takes
MOST_STEPS = 10_000  # for the time of a race


def scene_and_bare_loop(name: str) -> tuple[Callable[[], int], Callable[[], int]]:
    """Make the two ways to advance a scene, for a race."""
    plan = plan_run(name)
    model, steps = plan.physics.model, min(len(plan.script.hold), MOST_STEPS)
    held = {
        field: np.repeat(value[-1:], steps, axis=0)
        for field, value in plan.script.inputs.items()
    }
    script = replace(plan.script, inputs=held, hold=plan.script.hold[:steps])
    data = mujoco.MjData(model)

    def simulated() -> int:
        roll_out(model, [script] * TOGETHER)
        return TOGETHER * steps

    def bare() -> int:
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
        return TOGETHER * steps

    return simulated, bare
