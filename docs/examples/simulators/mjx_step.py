"""MJX, MuJoCo in JAX: the sensors as `mjx.step` leaves them, in double precision."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from body import RATE, mjcf, recording, row, wrench
from mujoco import mjx

jax.config.update("jax_enable_x64", True)


def simulate(request):
    """Read after each step."""
    model = mujoco.MjModel.from_xml_string(mjcf(1.0 / request.rate))
    data = mujoco.MjData(model)
    data.qvel[3:] = RATE
    on_device, now = mjx.put_model(model), mjx.put_data(model, data)

    @jax.jit
    def step(now, load):
        applied = now.xfrc_applied.at[1].set(load)
        return mjx.step(on_device, now.replace(xfrc_applied=applied))

    rows = []
    for _ in range(int(request.seconds * request.rate)):
        now = step(now, jnp.array(np.concatenate(wrench(float(now.time)))))
        rows.append(row(float(now.time), np.array(now.qpos), np.array(now.sensordata)))
    return recording(rows)
