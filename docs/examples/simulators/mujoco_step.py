"""MuJoCo: the sensors as `mj_step` leaves them, beside the pose that it leaves."""

import mujoco
import numpy as np
from body import RATE, mjcf, recording, row, wrench


def simulate(request):
    """Read after each step."""
    model = mujoco.MjModel.from_xml_string(mjcf(1.0 / request.rate))
    data = mujoco.MjData(model)
    data.qvel[3:] = RATE
    rows = []
    for _ in range(int(request.seconds * request.rate)):
        data.xfrc_applied[1] = np.concatenate(wrench(data.time))
        mujoco.mj_step(model, data)
        rows.append(row(data.time, data.qpos, data.sensordata))
    return recording(rows)
