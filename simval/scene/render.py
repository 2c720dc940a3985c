"""Pictures and animations of a scene, drawn off-screen.

The drawing is done by a child process (`simval.scene.draw`), because the graphics
library must be chosen before MuJoCo is imported and can end a process. EGL is tried
first, then OSMesa, unless the environment variable ``MUJOCO_GL`` says otherwise.
"""

import io
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from simval.errors import InputError
from simval.scene.catalogue import find_scene
from simval.scene.engine import positions
from simval.scene.models import load_model
from simval.scene.run import write_script
from simval.scene.script import Scene

BACKENDS = ("egl", "osmesa")
TIMEOUT = 300.0  # s
ENDINGS = (".png", ".gif", ".mp4")
FRAME_RATE = 15.0  # Hz
Frames = NDArray[np.uint8]


def render(
    scene: str | Scene = "gimbal",
    *,
    time: float | None = None,
    width: int = 640,
    height: int = 480,
    **parameters: Any,
) -> bytes:
    """Draw a scene at one time.

    Parameters
    ----------
    scene : str or Scene
        A name, the path of a user's scene file, or a scene.
    time : float or None
        Time in the run, s; None takes a third of the run.
    width, height : int
        Size of the picture, pixels; at most the model's own off-screen size.
    **parameters : Any
        Of the scene.

    Returns
    -------
    bytes
        A PNG file.

    Raises
    ------
    InputError
        If the scene cannot be used, or this machine cannot draw: the message says
        what to install.
    """
    times = None if time is None else [time]
    frames = draw_frames(scene, times, width, height, parameters)
    return _encoded(frames[:1], ".png")


def render_file(
    path: str | os.PathLike[str],
    scene: str | Scene = "gimbal",
    *,
    seconds: float = 8.0,
    width: int = 480,
    height: int = 360,
    **parameters: Any,
) -> None:
    """Write a picture (.png) or an animation (.gif, .mp4) of a scene.

    Parameters
    ----------
    path : path-like
        File to write; its ending says which.
    scene : str or Scene
        A name, the path of a user's scene file, or a scene.
    seconds : float
        Length of an animation from the start of the run, s.
    width, height : int
        Size, pixels.
    **parameters : Any
        Of the scene.

    Raises
    ------
    InputError
        If the ending is none of these, or this machine cannot draw or encode.
    """
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        msg = f"cannot draw {path.name}: its ending must be {', '.join(ENDINGS)}"
        raise InputError(msg)
    if not 0.0 < seconds <= 600.0:
        msg = f"`seconds` is {seconds}; an animation lasts from 0 s to 600 s"
        raise InputError(msg)
    if path.suffix.lower() == ".png":
        content = render(scene, width=width, height=height, **parameters)
    else:
        times = [float(t) for t in np.arange(0.0, seconds, 1.0 / FRAME_RATE)]
        frames = draw_frames(scene, times, width, height, parameters)
        content = _encoded(frames, path.suffix.lower())
    try:
        path.write_bytes(content)
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}"
        raise InputError(msg) from None


def draw_frames(
    scene: str | Scene,
    times: list[float] | None,
    width: int,
    height: int,
    parameters: dict[str, Any],
) -> Frames:
    """Draw a scene at some times.

    Raises
    ------
    InputError
        If a time lies outside the run, the size does not fit, or nothing can draw.
    """
    chosen = find_scene(scene)
    own = {"site_offset", "timestep", "integrator"} & parameters.keys()
    physics = load_model(chosen.model, **{name: parameters.pop(name) for name in own})
    model = physics.model
    limit = (int(model.vis.global_.offwidth), int(model.vis.global_.offheight))
    if not (0 < width <= limit[0] and 0 < height <= limit[1]):
        msg = f"a picture of {width} x {height} pixels; this scene allows {limit}"
        raise InputError(msg)
    script = write_script(chosen, physics, parameters)
    count = len(script.hold)
    asked = [count / 3 * model.opt.timestep] if times is None else times
    rows = np.array([round(t / model.opt.timestep) for t in asked])
    rows = rows[(rows >= 0) & (rows < count)]
    if len(rows) == 0:
        end = count * model.opt.timestep
        msg = f"the time {asked[0]:g} s lies outside the run, 0 s to {end:g} s"
        raise InputError(msg)
    job = {"qpos": positions(model, script, rows), "size": np.array([width, height])}
    for name in ("mocap_pos", "mocap_quat"):
        if name in script.inputs:
            job[name] = script.inputs[name][rows]
    return _drawn(model, job)


def _drawn(model: mujoco.MjModel, job: dict[str, Any]) -> Frames:
    # by the first graphics library that works, in a child process
    wanted = os.environ.get("MUJOCO_GL")
    reasons = []
    with tempfile.TemporaryDirectory(prefix="simval-draw-") as name:
        folder = Path(name)
        mujoco.mj_saveModel(model, str(folder / "model.mjb"))
        np.savez(folder / "job.npz", **job)
        for backend in (wanted,) if wanted else BACKENDS:
            try:
                child = subprocess.run(
                    [sys.executable, "-m", "simval.scene.draw", name],
                    env={**os.environ, "MUJOCO_GL": backend},
                    capture_output=True,
                    text=True,
                    timeout=TIMEOUT,
                    check=False,
                )
            except subprocess.TimeoutExpired:
                reasons.append(f"{backend}: no answer within {TIMEOUT:g} s")
                continue
            if child.returncode == 0 and (folder / "frames.npy").is_file():
                frames: Frames = np.load(folder / "frames.npy")
                return frames
            lines = child.stderr.strip().splitlines() or [f"exit {child.returncode}"]
            reasons.append(f"{backend}: {lines[-1][:200]}")
    msg = (
        f"this machine cannot draw off-screen ({'; '.join(reasons)}); install EGL (on "
        "Debian and Ubuntu: apt-get install libegl1 libgl1-mesa-dri) or OSMesa "
        "(apt-get install libosmesa6)"
    )
    raise InputError(msg)


def _encoded(frames: Frames, ending: str) -> bytes:
    if ending == ".mp4":
        return _mp4(frames)
    try:
        from PIL import Image
    except ImportError:
        msg = "writing pictures needs Pillow; install it (pip install pillow)"
        raise InputError(msg) from None
    images = [Image.fromarray(frame) for frame in frames]
    buffer = io.BytesIO()
    if ending == ".png":
        images[0].save(buffer, "PNG", optimize=True)
    else:
        duration = round(1000.0 / FRAME_RATE)
        more = images[1:]
        images[0].save(
            buffer, "GIF", save_all=True, append_images=more, duration=duration, loop=0
        )
    return buffer.getvalue()


def _mp4(frames: Frames) -> bytes:
    try:
        import imageio.v3 as imageio
        import imageio_ffmpeg  # noqa: F401  # the plugin's encoder, checked for
    except ImportError:
        msg = (
            "writing .mp4 needs imageio and imageio-ffmpeg; install them (pip install "
            "imageio imageio-ffmpeg), or write .gif"
        )
        raise InputError(msg) from None
    with tempfile.TemporaryDirectory(prefix="simval-draw-") as name:
        path = Path(name) / "film.mp4"
        imageio.imwrite(path, frames, fps=FRAME_RATE, macro_block_size=8)
        return path.read_bytes()
