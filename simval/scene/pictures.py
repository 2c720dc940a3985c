"""Pictures and animations of a scene, drawn off screen as PNG, GIF or MP4.

In each are the axes of the sensor, the specific force that it feels, the time, and the
directions of the specific force in the rests, visited and to come, on a sphere in
sensor axes.

The graphics library must be chosen before MuJoCo is imported and can end a process, so
`simval.scene.draw` runs in one of its own. EGL is tried first, then OSMesa, unless the
environment variable ``MUJOCO_GL`` says otherwise. No more than one frame is held here:
a film of ten minutes needs no more memory than a picture.
"""

import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from simval.arrays import Array, Places
from simval.errors import InputError
from simval.scene.captions import Caption, Directions, captioned, pillow
from simval.scene.draw import PLACES, Frame, Pixels
from simval.scene.physics import RENDERER, Rollout, mujoco, roll_out
from simval.scene.run import Plan, moving_rows, plan_run
from simval.scene.script import Scene, Script
from simval.shapes import Float

BACKENDS = ("egl", "osmesa")
CHILD = "import mujoco; from simval.scene.draw import main; main()"
"""MuJoCo first: with the renderer that is asked for, or with its own words."""
TIMEOUT = 300.0  # s, for one frame; the first includes the start of the process
INSTALL = (
    "install EGL (on Debian and Ubuntu: apt-get install libegl1 libgl1-mesa-dri) or "
    "OSMesa (apt-get install libosmesa6)"
)


class _NoFrameError(Exception):
    """No frame came from the child process; the message says why."""


def drawn_frames(model: "mujoco.MjModel", job: Mapping[str, Any]) -> Generator[Frame]:
    """Draw the frames of a job with the first graphics library that works."""
    wanted = os.environ.get(RENDERER, "").strip()
    reasons = {}
    with tempfile.TemporaryDirectory(prefix="simval-draw-") as name:
        folder = Path(name)
        mujoco.mj_saveModel(model, str(folder / "model.mjb"))
        np.savez(folder / "job.npz", **dict(job))
        width, height = (int(value) for value in job["size"])
        for backend in (wanted,) if wanted else BACKENDS:
            with _drawing_child(folder, backend) as child:
                try:
                    for _ in range(len(job["qpos"])):
                        yield child.frame(width, height)
                    return
                except _NoFrameError as error:
                    reasons[backend] = str(error)
                    if child.drawn:
                        break  # half of a film cannot be taken back
    said = "; ".join(f"{backend}: {why}" for backend, why in reasons.items())
    wished = f"with `{RENDERER}` {wanted!r:.60} " * bool(wanted)
    unset = "unset it, or " * bool(wanted)
    msg = f"{wished}this machine cannot draw off-screen ({said}); {unset}{INSTALL}"
    raise InputError(msg)


@dataclass(slots=True)
class _Child:
    process: subprocess.Popen[bytes]
    words: BinaryIO  # what it says on its error output
    drawn: int = 0

    def frame(self, width: int, height: int) -> Frame:
        """Read the next frame."""
        places = np.frombuffer(self._bytes(8 * PLACES[0] * PLACES[1]))
        pixels = np.frombuffer(self._bytes(3 * width * height), np.uint8)
        self.drawn += 1
        return Frame(
            pixels=pixels.reshape(height, width, 3), places=places.reshape(PLACES)
        )

    def _bytes(self, count: int) -> bytes:
        output = self.process.stdout
        assert output is not None
        end, parts = time.monotonic() + TIMEOUT, b""
        while len(parts) < count:
            left = end - time.monotonic()
            if left <= 0.0 or not select.select([output], [], [], left)[0]:
                msg = f"it did not answer within {TIMEOUT:g} s"
                raise _NoFrameError(msg)
            part = os.read(output.fileno(), count - len(parts))
            if not part:
                raise _NoFrameError(self._last_words())
            parts += part
        return parts

    def _last_words(self) -> str:
        code = self.process.wait(TIMEOUT)
        self.words.seek(0)
        lines = self.words.read().decode(errors="replace").strip().splitlines()
        return lines[-1][:200] if lines else f"exit {code}"


@contextmanager
def _drawing_child(folder: Path, backend: str) -> Iterator[_Child]:
    with tempfile.TemporaryFile() as words:
        process = subprocess.Popen(
            [sys.executable, "-c", CHILD, str(folder)],
            env={**os.environ, RENDERER: backend},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=words,
        )
        with process:
            try:
                yield _Child(process, words)
            finally:
                process.kill()


FRAME_RATE = 15.0  # Hz
COLOURS = 255  # of a GIF, one palette for all of its frames: no flicker


def require_encoder(ending: str) -> None:
    """Refuse a file type whose packages are missing, before anything is drawn."""
    pillow()
    if ending == ".mp4":
        _imageio()


def encoded(frames: Iterator[Pixels], ending: str) -> bytes:
    """Encode the first frame as PNG, or all frames as GIF or MP4."""
    encoders = {
        ".png": _png,
        ".gif": _gif,
        ".mp4": _mp4,
    }
    return encoders[ending](frames)


def _png(frames: Iterator[Pixels]) -> bytes:
    buffer = BytesIO()
    pillow().fromarray(next(frames)).save(buffer, "PNG")
    return buffer.getvalue()


def _gif(frames: Iterator[Pixels]) -> bytes:
    Image = pillow()
    first = Image.fromarray(next(frames)).quantize(COLOURS, dither=Image.Dither.NONE)
    more = (
        Image.fromarray(each).quantize(palette=first, dither=Image.Dither.NONE)
        for each in frames
    )
    buffer = BytesIO()
    first.save(
        buffer,
        "GIF",
        save_all=True,
        append_images=more,
        duration=round(1000.0 / FRAME_RATE),
        loop=0,
    )
    return buffer.getvalue()


def _mp4(frames: Iterator[Pixels]) -> bytes:
    with tempfile.TemporaryDirectory(prefix="simval-draw-") as name:
        path = Path(name) / "film.mp4"
        with _imageio().imopen(path, "w", plugin="FFMPEG") as film:
            film.write(frames, is_batch=True, fps=FRAME_RATE, macro_block_size=8)
        return path.read_bytes()


def _imageio() -> Any:
    try:
        import imageio.v3 as imageio
        import imageio_ffmpeg  # noqa: F401  # the plugin's encoder, checked for
    except ImportError:
        from simval.extras import refuse_without

        refuse_without("render", "writing .mp4", "; or write .gif")
    return imageio


ENDINGS = (".png", ".gif", ".mp4")


def render(
    scene: str | Scene = "gimbal",
    *,
    time: float | None = None,
    width: int = 960,
    height: int = 720,
    **parameters: Any,
) -> bytes:
    """Draw a scene at one time, with its axes, specific force and poses.

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
    return drawn(plan_run(scene, **parameters), times, ".png", width, height)


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
        content = drawn(plan_run(scene, **parameters), times, ending, width, height)
    try:
        path.write_bytes(content)
    except OSError as error:
        msg = f"cannot write {path}: {error.strerror}"
        raise InputError(msg) from None


def drawn(
    plan: Plan,
    times: list[float] | None,
    ending: str,
    width: int = 960,
    height: int = 720,
    rollout: Rollout | None = None,
) -> bytes:
    """Draw a run at some times, and encode the frames."""
    require_encoder(ending)
    with closing(_frames(plan, times, (width, height), rollout)) as frames:
        return encoded(frames, ending)


def _frames(
    plan: Plan,
    times: list[float] | None,
    size: tuple[int, int],
    rollout: Rollout | None,
) -> Generator[Pixels]:
    """Draw a run at some times, frame by frame."""
    model, script = plan.physics.model, plan.script
    limit = (int(model.vis.global_.offwidth), int(model.vis.global_.offheight))
    if not (0 < size[0] <= limit[0] and 0 < size[1] <= limit[1]):
        msg = f"a picture of {size[0]} x {size[1]} pixels; this scene allows {limit}"
        raise InputError(msg)
    count = len(script.hold)
    asked = [count / 3 * model.opt.timestep] if times is None else times
    drawn = np.array([round(t / model.opt.timestep) for t in asked])
    drawn = drawn[(drawn >= 0) & (drawn < count)]
    if len(drawn) == 0:
        end = count * model.opt.timestep
        msg = (
            f"the time {asked[0]:g} s is outside the run, which lasts from 0 s "
            f"to {end:g} s"
        )
        raise InputError(msg)
    if rollout is None:
        rollout = roll_out(model, [script], positions=True)
    assert rollout.qpos is not None
    rows = rollout.rows[0]
    job = {"qpos": rollout.qpos[0, drawn], "force": rows[drawn, :3]}
    job["size"] = np.array(size)
    for name in ("mocap_pos", "mocap_quat"):
        if name in script.inputs:
            job[name] = script.inputs[name][drawn]
    g = float(np.linalg.norm(model.opt.gravity))
    captions = _captions(plan.scene.name, rows, script, g, drawn)
    with closing(drawn_frames(model, job)) as frames:
        yield from map(captioned, frames, captions)


def _captions(
    title: str,
    rows: Float[Array, "n 14"],
    script: Script,
    g: float,
    drawn: Places,
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
) -> tuple[Places, Float[Array, "m 3"]]:
    """First row of each settled rest, and its direction in sensor axes."""
    moving, _, _ = moving_rows(rows, script, g)
    left = set(script.hold[moving].tolist())
    begin, means = [], []
    for k in np.unique(script.hold[script.hold >= 0]).tolist():
        if k not in left:
            at = np.flatnonzero(script.hold == k)
            begin.append(at[0])
            means.append(rows[at, :3].mean(axis=0) / g)
    return np.array(begin, np.intp), np.array(means).reshape(-1, 3)
