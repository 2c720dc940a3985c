"""The child process that draws frames, so that no graphics failure ends the caller.

Run as ``python -m simval.scene.draw FOLDER``: it reads ``job.npz`` there (positions and
specific force of each frame) and ``model.mjb``, and writes each frame to its output as
soon as it is drawn: where the sensor and the tips of its arrows are on the picture,
then the pixels.
"""

import os
import sys
from pathlib import Path
from typing import BinaryIO

import mujoco
import numpy as np

from simval.scene.arrows import (
    add_arrows,
    arrow_tips,
    body_reach,
    make_glass,
    projected,
)
from simval.scene.models import SITE

CAMERA = "view"
PLACES = (5, 2)
"""Of the sensor and the tips of x, y, z and the specific force: pixels right, down."""


def draw(folder: Path, output: BinaryIO) -> None:
    """Draw every frame of a job."""
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    job = np.load(folder / "job.npz")
    width, height = (int(value) for value in job["size"])
    g = float(np.linalg.norm(model.opt.gravity))
    reach = body_reach(model)
    make_glass(model)
    data = mujoco.MjData(model)
    named = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA) >= 0
    with mujoco.Renderer(model, height, width) as renderer:
        for k, (qpos, force) in enumerate(zip(job["qpos"], job["force"], strict=True)):
            data.qpos[:] = qpos
            for name in ("mocap_pos", "mocap_quat"):
                if name in job:
                    getattr(data, name).flat = job[name][k]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera=CAMERA if named else -1)
            start = data.site(SITE).xpos
            tips = arrow_tips(data, force, g, reach)
            add_arrows(renderer.scene, start, tips, reach)
            places = projected(renderer.scene, np.vstack([start, tips]), width, height)
            output.write(places.tobytes())
            output.write(renderer.render().tobytes())
            output.flush()


if __name__ == "__main__":
    # a library that prints must not write into the pictures
    own = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    draw(Path(sys.argv[1]), own)
