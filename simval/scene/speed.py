"""How fast scenes are recorded, beside MuJoCo's own bare loop over the same model.

``python -m simval.scene.speed`` prints one line per scene.
"""

import time
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from simval.scene.catalogue import scenes
from simval.scene.engine import simulate
from simval.scene.messages import captured_messages
from simval.scene.run import plan_run

REPEATS = 7
TOGETHER = 8
MOST_STEPS = 10_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Speed:
    """Rates of one scene, measured in turn, one thread.

    Attributes
    ----------
    scene : str
        Its name.
    recorded : float
        Steps per second of processor time, recorded and returned as rows: best of 7.
    bare : float
        Steps per second of processor time of ``mj_step(model, data, nstep)``: best
        of 7.
    ratio : float
        Recorded to bare.
    """

    scene: str
    recorded: float
    bare: float
    ratio: float


def measure(name: str) -> Speed:
    """Measure one scene.

    Parameters
    ----------
    name : str
        A scene of the package.

    Returns
    -------
    Speed
        Eight runs of the scene side by side, and as many bare steps from the same
        start. Both hold the scene's last inputs, because the bare loop cannot change
        them: the same work.
    """
    plan = plan_run(name)
    model, steps = plan.physics.model, min(len(plan.script.hold), MOST_STEPS)
    held = {
        field: np.repeat(value[-1:], steps, axis=0)
        for field, value in plan.script.inputs.items()
    }
    script = replace(plan.script, inputs=held, hold=plan.script.hold[:steps])
    data = mujoco.MjData(model)
    pairs = []
    simulate(model, [script] * TOGETHER)  # the first one pays for the memory
    for _ in range(REPEATS):
        start = time.process_time()
        simulate(model, [script] * TOGETHER)
        middle = time.process_time()
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
        end = time.process_time()
        pairs.append((middle - start, end - middle))
    recorded, bare = np.array(pairs).T
    count = TOGETHER * steps
    return Speed(
        scene=name,
        recorded=count / float(recorded.min()),
        bare=count / float(bare.min()),
        ratio=float(bare.min() / recorded.min()),
    )


def main() -> None:
    """Print the speed of every scene."""
    for name in scenes():
        speed = measure(name)
        line = (
            f"{name:10s} {speed.recorded:9.0f} steps/s recorded, {speed.bare:9.0f} "
            f"bare, {100.0 * speed.ratio:5.1f} %"
        )
        print(line)  # noqa: T201  # a command of its own


if __name__ == "__main__":
    main()
