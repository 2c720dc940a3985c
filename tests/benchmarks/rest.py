"""Races of the simulation of a scene, and of the Allan variance."""

from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import numpy as np

from benchmarks.race import Contender, race
from simval.imu.noise import allan_variance
from simval.scene.physics import captured_messages, mujoco, roll_out
from simval.scene.run import plan_run

TOGETHER = 8  # as `many` takes
MOST_STEPS = 10_000  # for the time of a race
ROWS = 1_000_000
LENGTHS = 40  # averaging times, evenly on a log scale to a tenth of the rows
AGREEMENT = 1e-9
"""Relative. Chosen: the running sum of a million normals, some 1e3, has lost 1e-13 a
step at most, and the sums of squares average that."""


@race("scene", "Steps of the gimbal, eight runs together, one thread", "steps")
def simulation() -> list[Contender]:
    """List both ways to advance the gimbal; the reference is the bare loop in C.

    The loop cannot change its inputs, so both hold the scene's last ones.
    """
    plan = plan_run("gimbal")
    model, steps = plan.physics.model, min(len(plan.script.hold), MOST_STEPS)
    held = {
        field: np.repeat(value[-1:], steps, axis=0)
        for field, value in plan.script.inputs.items()
    }
    script = replace(plan.script, inputs=held, hold=plan.script.hold[:steps])
    data = mujoco.MjData(model)

    def bare():
        last = []
        with captured_messages():
            for _ in range(TOGETHER):
                mujoco.mj_resetData(model, data)
                for name in ("qpos", "qvel"):
                    if (start := getattr(script, name)) is not None:
                        getattr(data, name)[:] = start
                for field, value in held.items():
                    getattr(data, field).flat = value[-1]
                mujoco.mj_step(model, data, steps)
                last.append(np.array(data.sensordata))  # the scene's order is ours
        return np.array(last)

    def kept():
        return roll_out(model, [script] * TOGETHER).rows[:, -1]

    def seen(rows):  # the engine is the same, so the bits are
        return {"last rows of the sensors": (rows, 0.0)}

    count = TOGETHER * steps
    return [
        Contender("mj_step, nstep at once", count, bare, seen, other="keeps no row"),
        Contender("simulation, every row kept", count, kept, seen),
    ]


@race("allan", "Overlapping Allan variances of a million rows", "row averages")
def allan() -> list[Contender]:
    """List the ways to the Allan variance; the reference is its definition in NumPy."""
    signal = np.random.default_rng(0).standard_normal(ROWS)
    counts = np.unique(np.round(np.geomspace(1, ROWS // 10, LENGTHS)).astype(int))

    def seen(found):
        return {"Allan variances": (found, 0.5 * AGREEMENT * np.abs(found))}

    ways = {"second differences in NumPy, data unchecked": _second_differences}
    if find_spec("allantools") is not None:
        ways["allantools, data unchecked"] = _allantools
    ways["simval"] = allan_variance
    return [  # each averaging time takes all rows
        Contender(name, ROWS * len(counts), partial(run, signal, counts), seen)
        for name, run in ways.items()
    ]


def _second_differences(rate, counts):
    angle = np.concatenate([[0.0], np.cumsum(rate)])
    found = np.empty(len(counts))
    for i, m in enumerate(counts):
        second = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        found[i] = np.mean(second * second) / (2.0 * m * m)
    return found


def _allantools(rate, counts):
    import allantools

    found = allantools.oadev(rate, rate=1.0, data_type="freq", taus=counts)
    return np.asarray(found[1]) ** 2
