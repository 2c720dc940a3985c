"""MuJoCo Warp: the sensors as its `step` leaves them, in single precision."""

import mujoco
import mujoco_warp
import numpy as np
import warp
from body import RATE, mjcf, recording, row, wrench


def simulate(request):
    """Read after each step."""
    warp.config.quiet = True
    model = mujoco.MjModel.from_xml_string(mjcf(1.0 / request.rate))
    data = mujoco.MjData(model)
    data.qvel[3:] = RATE
    mujoco.mj_forward(model, data)
    on_device = mujoco_warp.put_model(model)
    now = mujoco_warp.put_data(model, data)
    rows = []
    for k in range(int(request.seconds * request.rate)):
        load = np.zeros(now.xfrc_applied.numpy().shape, np.float32)
        load.reshape(-1, 6)[1] = np.concatenate(wrench(k / request.rate))
        now.xfrc_applied.assign(load)
        mujoco_warp.step(on_device, now)
        time = (k + 1) / request.rate
        rows.append(row(time, now.qpos.numpy()[0], now.sensordata.numpy()[0]))
    return recording(rows)
