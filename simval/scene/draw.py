"""The child process that draws frames, so that no graphics failure ends the caller.

Run as ``python -m simval.scene.draw FOLDER``: it reads ``job.npz`` there (positions per
frame) and ``model.mjb``, and writes ``frames.npy``.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

CAMERA = "view"


def draw(folder: Path) -> None:
    """Draw every frame of a job."""
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    job = np.load(folder / "job.npz")
    width, height = (int(value) for value in job["size"])
    data = mujoco.MjData(model)
    named = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA) >= 0
    frames = np.empty((len(job["qpos"]), height, width, 3), np.uint8)
    with mujoco.Renderer(model, height, width) as renderer:
        for k, qpos in enumerate(job["qpos"]):
            data.qpos[:] = qpos
            for name in ("mocap_pos", "mocap_quat"):
                if name in job:
                    getattr(data, name).flat = job[name][k]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera=CAMERA if named else -1)
            frames[k] = renderer.render()
    np.save(folder / "frames.npy", frames)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
