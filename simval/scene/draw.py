"""Program that draws frames in a child process, where a graphics crash does no harm.

It reads ``job.npz`` in a folder (positions and specific force of each frame) and
``model.mjb``, and writes each frame to its output as soon as it is drawn: where the
sensor and the tips of its arrows are on the picture, then the pixels.

The arrows are the sensor's axes, and the specific force that it feels. All sizes are
shares of the body's reach, so that a die and a gimbal look alike.
"""

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.scene.physics import SITE, mujoco
from simval.shapes import Float

AXES = ("#0072b2", "#d55e00", "#009e73")
"""Colours of x, y and z, those of the report."""
FORCE = "#a3197b"
AXIS_LENGTH = 1.1  # of the body's reach
FORCE_LENGTH = 1.3  # of the body's reach, for a specific force of g
LONGEST = 2.5  # g: a longer arrow would leave the picture, so an impact ends there
SHAFT = 0.035  # radius, of the body's reach
GLASS = 0.5  # share of its own colour that the body keeps
CLEAR = np.array([1.0, 1.0, 1.0, 0.3])  # so that the arrows are seen inside it

CAMERA = "view"
PLACES = (5, 2)
"""Of the sensor and the tips of x, y, z and the specific force: pixels right, down."""
Pixels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One picture, as the graphics library drew it."""

    pixels: Pixels  # (height, width, 3)
    places: Float[Array, "5 2"]  # of sensor, x, y, z and specific force: right, down


def body_reach(model: "mujoco.MjModel") -> float:
    """Upper bound on the distance of the body's farthest point from the sensor, m."""
    site = model.site(SITE)
    own = np.flatnonzero(model.geom_bodyid == site.bodyid[0])
    ends = np.linalg.norm(model.geom_pos[own] - site.pos, axis=1)
    reach = ends + model.geom_rbound[own]
    return float(reach.max()) if len(own) else 0.1 * float(model.stat.extent)


def make_glass(model: "mujoco.MjModel") -> None:
    """Make the sensor's body translucent."""
    own = model.geom_bodyid == model.site(SITE).bodyid[0]
    for k in np.flatnonzero(own).tolist():
        model.geom_rgba[k] = GLASS * _own_colour(model, k) + (1.0 - GLASS) * CLEAR
        model.geom_matid[k] = -1


def _own_colour(model: "mujoco.MjModel", geom: int) -> Float[Array, "4"]:
    material = model.geom_matid[geom]
    return model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]


def arrow_tips(
    data: "mujoco.MjData", force: Float[Array, "3"], g: float, reach: float
) -> Float[Array, "4 3"]:
    """Tips of the sensor's axes and of the specific force, world, m."""
    site = data.site(SITE)
    R_ws = site.xmat.reshape(3, 3)
    size = float(np.linalg.norm(force)) / g
    shown = force / g * min(1.0, LONGEST / max(size, LONGEST))
    ends = [*(AXIS_LENGTH * R_ws.T), FORCE_LENGTH * (R_ws @ shown)]
    return site.xpos + reach * np.array(ends)


def add_arrows(
    scene: "mujoco.MjvScene",
    start: Float[Array, "3"],
    tips: Float[Array, "4 3"],
    reach: float,
) -> None:
    """Add arrows from the sensor to their tips to a scene about to be drawn."""
    for tip, colour in zip(tips, (*AXES, FORCE), strict=True):
        if not np.linalg.norm(tip - start) > SHAFT * reach:
            continue  # nothing is felt in free fall
        geom = scene.geoms[scene.ngeom]
        rgba = np.array([*bytes.fromhex(colour[1:]), 255]) / np.float32(255)
        kind = mujoco.mjtGeom.mjGEOM_ARROW
        mujoco.mjv_initGeom(
            geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba
        )
        width = SHAFT * reach * (1.0 if colour != FORCE else 1.5)
        # the renderer draws an arrow half as long as its size says
        mujoco.mjv_connector(geom, kind, width, start, start + 2.0 * (tip - start))
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR  # no shadow
        geom.emission = 0.4
        scene.ngeom += 1


def projected(
    scene: "mujoco.MjvScene", points: Float[Array, "m 3"], width: int, height: int
) -> Float[Array, "m 2"]:
    """Pixels (right, down) of points in the world; NaN behind the camera."""
    eyes = scene.camera
    position = (eyes[0].pos + eyes[1].pos) / 2.0
    forward = np.asarray(eyes[0].forward, float)
    up = np.asarray(eyes[0].up, float)
    away = points - position
    depth = away @ forward
    depth = np.where(depth > 0.0, depth, np.nan)
    top, bottom = eyes[0].frustum_top, eyes[0].frustum_bottom
    scale = height / (top - bottom) * eyes[0].frustum_near / depth  # pixels per metre
    middle = (top + bottom) / 2.0 * height / (top - bottom)
    right = width / 2.0 + scale * (away @ np.cross(forward, up))
    down = height / 2.0 + middle - scale * (away @ up)
    return np.stack([right, down], axis=1)


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


def main() -> None:
    """Draw the job in the folder that the command line names."""
    # a library that prints must not write into the pictures
    own = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    draw(Path(sys.argv[1]), own)
