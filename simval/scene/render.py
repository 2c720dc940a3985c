"""Pictures and animations of a scene, drawn off-screen.

In each are the axes of the sensor, the specific force that it feels, the time, and the
directions of the specific force in the rests, visited and to come, on a sphere in
sensor axes.
"""

import os
from collections.abc import Generator, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import InputError
from simval.scene.captions import Caption, captioned
from simval.scene.catalogue import find_scene
from simval.scene.checks import moving_rows
from simval.scene.encode import FRAME_RATE, encoded, require_encoder
from simval.scene.engine import instants
from simval.scene.frames import Pixels, drawn_frames
from simval.scene.globe import Directions
from simval.scene.models import load_model
from simval.scene.run import write_script
from simval.scene.script import Scene, Script
from simval.shapes import Float

ENDINGS = (".png", ".gif", ".mp4")


def render(
    scene: str | Scene = "gimbal",
    *,
    time: float | None = None,
    width: int = 960,
    height: int = 720,
    **parameters: Any,
) -> bytes:
    """Draw a scene at one time, with its axes, its specific force and its poses.

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
    return _drawn(scene, times, width, height, parameters, ".png")


def render_file(
    path: str | os.PathLike[str],
    scene: str | Scene = "gimbal",
    *,
    seconds: float = 8.0,
    width: int = 960,
    height: int = 720,
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
        ending = path.suffix.lower()
        content = _drawn(scene, times, width, height, parameters, ending)
    try:
        path.write_bytes(content)
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}"
        raise InputError(msg) from None


def _drawn(
    scene: str | Scene,
    times: list[float] | None,
    width: int,
    height: int,
    parameters: dict[str, Any],
    ending: str,
) -> bytes:
    require_encoder(ending)
    with closing(draw_frames(scene, times, width, height, parameters)) as frames:
        return encoded(frames, ending)


def draw_frames(
    scene: str | Scene,
    times: list[float] | None,
    width: int,
    height: int,
    parameters: dict[str, Any],
) -> Generator[Pixels]:
    """Draw a scene at some times, one after the other.

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
    drawn = np.array([round(t / model.opt.timestep) for t in asked])
    drawn = drawn[(drawn >= 0) & (drawn < count)]
    if len(drawn) == 0:
        end = count * model.opt.timestep
        msg = f"the time {asked[0]:g} s lies outside the run, 0 s to {end:g} s"
        raise InputError(msg)
    qpos, rows = instants(model, script)
    job = {"qpos": qpos[drawn], "force": rows[drawn, :3]}
    job["size"] = np.array([width, height])
    for name in ("mocap_pos", "mocap_quat"):
        if name in script.inputs:
            job[name] = script.inputs[name][drawn]
    g = float(np.linalg.norm(model.opt.gravity))
    captions = _captions(chosen.name, rows, script, g, drawn)
    with closing(drawn_frames(model, job)) as frames:
        yield from map(captioned, frames, captions)


def _captions(
    title: str,
    rows: Float[Array, "n 14"],
    script: Script,
    g: float,
    drawn: NDArray[np.intp],
) -> Iterator[Caption]:
    begin, rests = _rests(rows, script, g)
    for k in drawn.tolist():
        force = rows[k, :3]
        yield Caption(
            title=title,
            time=float(rows[k, 13]),
            force=force,
            directions=Directions(rests=rests, visited=begin <= k, now=force / g),
        )


def _rests(
    rows: Float[Array, "n 14"], script: Script, g: float
) -> tuple[NDArray[np.intp], Float[Array, "m 3"]]:
    """First row of each rest that has settled, and its direction in sensor axes."""
    moving, _, _ = moving_rows(rows, script, g)
    left = set(script.hold[moving].tolist())
    begin, means = [], []
    for k in np.unique(script.hold[script.hold >= 0]).tolist():
        if k not in left:
            at = np.flatnonzero(script.hold == k)
            begin.append(at[0])
            means.append(rows[at, :3].mean(axis=0) / g)
    return np.array(begin, np.intp), np.array(means).reshape(-1, 3)
