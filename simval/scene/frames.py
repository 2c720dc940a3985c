"""Frames of a scene as a child process draws them, one after the other.

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
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import InputError
from simval.scene.draw import PLACES
from simval.scene.library import mujoco
from simval.shapes import Float
from simval.startup import RENDERER

BACKENDS = ("egl", "osmesa")
TIMEOUT = 300.0  # s, for one frame; the first includes the start of the process
INSTALL = (
    "install EGL (on Debian and Ubuntu: apt-get install libegl1 libgl1-mesa-dri) or "
    "OSMesa (apt-get install libosmesa6)"
)
Pixels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One picture as the graphics library drew it."""

    pixels: Pixels  # (height, width, 3)
    places: Float[Array, "5 2"]  # of sensor, x, y, z and specific force: right, down


class _NoFrameError(Exception):
    """The child process gave no frame; its words say why."""


def drawn_frames(model: "mujoco.MjModel", job: Mapping[str, Any]) -> Generator[Frame]:
    """Draw the frames of a job by the first graphics library that works.

    Raises
    ------
    InputError
        If none does: the message says what each said, and what to set or install.
    """
    wanted = os.environ.get(RENDERER, "").strip()
    reasons = {}
    with tempfile.TemporaryDirectory(prefix="simval-draw-") as name:
        folder = Path(name)
        mujoco.mj_saveModel(model, str(folder / "model.mjb"))
        np.savez(folder / "job.npz", **dict(job))
        width, height = (int(value) for value in job["size"])
        for backend in (wanted,) if wanted else BACKENDS:
            with _child(folder, backend) as child:
                try:
                    for _ in range(len(job["qpos"])):
                        yield child.frame(width, height)
                    return
                except _NoFrameError as error:
                    reasons[backend] = str(error)
                    if child.drawn:
                        break  # half of a film cannot be taken back
        others = [each for each in BACKENDS if wanted and each != wanted.lower()]
        able = [each for each in others if _can_draw(folder, each, width, height)]
    said = "; ".join(f"{backend}: {why}" for backend, why in reasons.items())
    raise InputError(_refusal(wanted, said, others, able))


def _refusal(wanted: str, said: str, others: list[str], able: list[str]) -> str:
    if not wanted:
        return f"this machine cannot draw off-screen ({said}); {INSTALL}"
    head = (
        f"`{RENDERER}` is {wanted!r:.60}, and with it this machine cannot draw "
        f"off-screen ({said})"
    )
    if able:
        which = " or ".join(able)
        return f"{head}; with {which} it can, so set it to {which}, or unset it"
    return f"{head}, nor with {' or '.join(others)}; {INSTALL}, and unset it"


def _can_draw(folder: Path, backend: str, width: int, height: int) -> bool:
    with _child(folder, backend) as child:
        try:
            child.frame(width, height)
        except _NoFrameError:
            return False
    return True


@dataclass(slots=True)
class _Child:
    process: subprocess.Popen[bytes]
    words: BinaryIO  # what it says on its error output
    drawn: int = 0

    def frame(self, width: int, height: int) -> Frame:
        """Next frame."""
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
                msg = f"no answer within {TIMEOUT:g} s"
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
def _child(folder: Path, backend: str) -> Iterator[_Child]:
    with tempfile.TemporaryFile() as words:
        process = subprocess.Popen(
            [sys.executable, "-m", "simval.scene.draw", str(folder)],
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
