"""Pictures and films as files: PNG, GIF, MP4."""

import tempfile
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

from simval.scene.frames import Pixels

FRAME_RATE = 15.0  # Hz
COLOURS = 255  # of a GIF, one palette for all of its frames: no flicker


def require_encoder(ending: str) -> None:
    """Raise an error if what an ending needs is not installed, before any drawing.

    Raises
    ------
    InputError
        Naming the packages to install.
    """
    pillow()
    if ending == ".mp4":
        _imageio()


def pillow() -> ModuleType:
    """Pillow's module of images.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        from PIL import Image
    except ImportError:
        from simval.extras import refuse_without

        refuse_without("render", "writing pictures")
    return Image


def encoded(frames: Iterator[Pixels], ending: str) -> bytes:
    """Encode the first frame as ``.png``, or all as ``.gif`` or ``.mp4``."""
    encoders: dict[str, Callable[[Iterator[Pixels]], bytes]] = {
        ".png": _png,
        ".gif": _gif,
        ".mp4": _mp4,
    }
    return encoders[ending](frames)


def _png(frames: Iterator[Pixels]) -> bytes:
    buffer = BytesIO()
    pillow().fromarray(next(frames)).save(buffer, "PNG", optimize=True)
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
