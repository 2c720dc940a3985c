"""MuJoCo: the sensors of the state after each step, by `mj_forward`."""

import mujoco
import numpy as np
from body import RATE, mjcf, recording, row, wrench


def simulate(request):
    """Read after each step and `mj_forward`."""
    model = mujoco.MjModel.from_xml_string(mjcf(1.0 / request.rate))
    data = mujoco.MjData(model)
    data.qvel[3:] = RATE
    rows = []
    for _ in range(int(request.seconds * request.rate)):
        data.xfrc_applied[1] = np.concatenate(wrench(data.time))
        mujoco.mj_step(model, data)
        data.xfrc_applied[1] = np.concatenate(wrench(data.time))
        mujoco.mj_forward(model, data)
        rows.append(row(data.time, data.qpos, data.sensordata))
    return recording(rows)
