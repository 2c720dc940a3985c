"""Captions of a picture: names of arrows, the time, and a sphere of directions.

Sizes are for a picture 720 pixels high and follow its height. The directions are on a
sphere, an inset in sensor axes, seen from a fixed side: the body turns and the sphere
stays, so that a gap in them is seen. The far side shows through, paler.
"""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from simval.arrays import Array, Mask
from simval.geometry import normalize
from simval.scene.draw import AXES, FORCE, Frame, Pixels
from simval.shapes import Float

EDGE = 200.0  # pixels, of the square that it is drawn in, of a picture 720 high
RADIUS = 66.0
AXIS = 1.22  # radii, length of an axis
FELT = 0.05  # of g; below it the specific force has no direction worth a dot
AZIMUTH, ELEVATION = np.radians(35.0), np.radians(25.0)  # from which it is seen
TURN = np.linspace(0.0, 2.0 * np.pi, 73)
CIRCLES = [
    np.stack([np.cos(TURN), np.sin(TURN), 0.0 * TURN], axis=1),
    np.stack([np.cos(TURN), 0.0 * TURN, np.sin(TURN)], axis=1),
    np.stack([0.0 * TURN, np.cos(TURN), np.sin(TURN)], axis=1),
]
INK, PALE, LINE, DISC = "#1c1c1e", "#a3a7ae", "#c9ccd1", "#f2f3f5"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Directions:
    """Directions of the specific force, sensor axes."""

    rests: Float[Array, "m 3"]  # unit, of each rest, in order
    visited: Mask  # rests that have begun
    now: Float[Array, "3"]  # of this instant, in g; of any length


def draw_globe(draw: Any, directions: Directions, scale: float) -> None:
    """Draw the sphere of directions on a square."""
    middle, radius = EDGE * scale / 2.0, RADIUS * scale
    disc = [middle - radius, middle - radius, middle + radius, middle + radius]
    draw.ellipse(disc, fill=DISC, outline=LINE, width=round(scale))
    for circle in CIRCLES:
        _line(draw, circle, LINE, scale)
    behind = seen(directions.rests)[:, 2] < 0.0
    _dots(draw, directions, behind, PALE, scale)
    for axis, colour in zip(np.eye(3), AXES, strict=True):
        _line(draw, np.stack([0.0 * axis, AXIS * axis]), colour, 2.5 * scale, scale)
    _dots(draw, directions, ~behind, INK, scale)
    if np.linalg.norm(directions.now) > FELT:
        x, y = placed(normalize(directions.now)[None], scale)[0]
        _dot(draw, x, y, 6.5 * scale, FORCE, DISC, scale)


def seen(points: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
    """Points as seen by the viewer: right, up, and towards the eye."""
    near = np.array([np.cos(AZIMUTH), np.sin(AZIMUTH), 0.0])
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    up = np.array([0.0, 0.0, np.cos(ELEVATION)]) - np.sin(ELEVATION) * near
    eye = np.cross(right, up)
    return points @ np.stack([right, up, eye], axis=1)


def placed(points: Float[Array, "m 3"], scale: float) -> Float[Array, "m 2"]:
    """Pixels (right, down) of points on the unit sphere."""
    at = seen(points)[:, :2] * [1.0, -1.0]
    return scale * (EDGE / 2.0 + RADIUS * at)


def _line(
    draw: Any, points: Float[Array, "m 3"], colour: str, width: float, scale: float = 0
) -> None:
    ends = placed(points, scale or width)
    draw.line([tuple(at) for at in ends], fill=colour, width=round(width))


def _dots(
    draw: Any,
    directions: Directions,
    which: Mask,
    colour: str,
    scale: float,
) -> None:
    places = placed(directions.rests, scale)
    # a direction that is visited again stays visited
    for part, fill in ((~directions.visited, DISC), (directions.visited, colour)):
        for x, y in places[which & part]:
            _dot(draw, x, y, 3.5 * scale, fill, colour, scale)


def _dot(
    draw: Any, x: float, y: float, size: float, fill: str, edge: str, width: float
) -> None:
    box = [x - size, y - size, x + size, y + size]
    draw.ellipse(box, fill=fill, outline=edge, width=round(width))


HEIGHT = 720.0  # pixels, to which sizes refer
MARGIN, PADDING = 18.0, 14.0
LARGE, SMALL, LETTER = 26.0, 19.0, 26.0  # heights of text
LEADING, GAP = 1.4, 0.45  # of the height: from line to line, from word to word
OPACITY = 225  # of 255, of the cards that text stands on
FINE = 3  # lines are drawn so much larger and made smaller: smooth
BEYOND = 17.0  # pixels from the tip of an arrow to the middle of its letter
TRACE = 110  # of 255, opacity of the line along an arrow that something may hide

Words = list[tuple[str, str]]  # and their colours


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Caption:
    """Text of one frame."""

    title: str  # of the scene
    time: float  # s
    force: Float[Array, "3"]  # specific force in sensor axes, m/s^2
    directions: Directions


def pillow() -> ModuleType:
    """Import Pillow, or say how to install it."""
    try:
        from PIL import Image
    except ImportError:
        from simval.extras import refuse_without

        refuse_without("render", "writing pictures")
    return Image


def captioned(frame: Frame, caption: Caption) -> Pixels:
    """A frame with its captions."""
    board = _Board(pillow().fromarray(frame.pixels), frame.pixels.shape[0] / HEIGHT)
    start, *tips = frame.places
    for letter, tip, colour in zip("xyzf", tips, (*AXES, FORCE), strict=True):
        if np.isfinite([*start, *tip]).all() and np.linalg.norm(tip - start) > 1.0:
            board.name_arrow(start, tip, letter, colour)
    board.title(caption)
    if len(caption.directions.rests):
        board.globe(caption.directions)
    return np.asarray(board.picture)


class _Board:
    """A picture that is being captioned, at some scale."""

    def __init__(self, picture: Any, scale: float) -> None:
        from PIL import ImageDraw

        self.picture, self.scale = picture, scale
        self.draw = ImageDraw.Draw(picture)

    def name_arrow(
        self, start: Float[Array, "2"], tip: Float[Array, "2"], letter: str, colour: str
    ) -> None:
        """Draw an arrow, even where something hides it, with a letter at its tip."""
        self._line(start, tip, colour)
        along = (tip - start) / np.linalg.norm(tip - start)
        room = 0.7 * LETTER * self.scale
        at = np.clip(
            tip + BEYOND * self.scale * along,
            room,
            np.maximum(np.subtract(self.picture.size, room), room),
        )
        self._letter(at, letter, colour)

    def title(self, caption: Caption) -> None:
        """Write the scene's name, the time and the arrows' names on a card."""
        felt = f"specific force {np.linalg.norm(caption.force):.2f} m/s"
        axes = [*zip("xyz", AXES, strict=True), ("axes of the sensor", INK)]
        lines = [
            (LARGE, [(f"{caption.title}, t = {caption.time:.2f} s", INK)]),
            (SMALL, axes),
            (SMALL, [("f", FORCE), (felt, INK)]),
        ]
        s = self.scale
        left = top = (MARGIN + PADDING) * s
        right = left + max(self._width(words, size) for size, words in lines)
        bottom = top + sum(LEADING * size for size, _ in lines) * s
        right += (0.6 * SMALL + PADDING) * s  # and the raised two
        self._card([MARGIN * s, MARGIN * s, right, bottom + PADDING * s])
        for size, words in lines:
            end = self._write(words, left, top, size)
            top += LEADING * size * s
        # the font has no raised two
        font, top = _font(0.65 * SMALL * s), top - LEADING * SMALL * s
        self.draw.text((end, top), "2", INK, font=font, anchor="la")

    def globe(self, directions: Directions) -> None:
        """Draw the sphere of directions on a card, bottom right."""
        from PIL import Image, ImageChops, ImageDraw

        s, (width, height) = self.scale, self.picture.size
        text = 1.5 * SMALL
        left = width - (MARGIN + PADDING + EDGE) * s
        top = height - (MARGIN + PADDING + text + EDGE) * s
        pad = PADDING * s
        self._card(
            [left - pad, top - pad, width - MARGIN * s, height - MARGIN * s],
        )
        edge = max(round(EDGE * s), 1)
        layer = Image.new("RGB", (FINE * edge, FINE * edge), "white")
        draw_globe(ImageDraw.Draw(layer), directions, FINE * edge / EDGE)
        small = layer.resize((edge, edge), Image.Resampling.BOX)
        corner = (round(left), round(top))
        under = self.picture.crop((*corner, corner[0] + edge, corner[1] + edge))
        self.picture.paste(ImageChops.multiply(under, small), corner)
        ends = np.add(placed((AXIS + 0.17) * np.eye(3), s), (left, top))
        for letter, colour, at in zip("xyz", AXES, ends, strict=True):
            self._letter(at, letter, colour, 0.8)
        done, count = int(directions.visited.sum()), len(directions.visited)
        words = f"f in {done} of {count} rests"
        at = (left + EDGE * s / 2.0, top + (EDGE + 0.5 * text) * s)
        self.draw.text(at, words, INK, font=_font(SMALL * s), anchor="mm")

    def _width(self, words: Words, size: float) -> float:
        font, gap = _font(size * self.scale), GAP * size * self.scale
        return sum(font.getlength(word) + gap for word, _ in words) - gap

    def _write(self, words: Words, left: float, top: float, size: float) -> float:
        font, gap = _font(size * self.scale), GAP * size * self.scale
        for word, colour in words:
            self.draw.text((left, top), word, colour, font=font, anchor="la")
            left += font.getlength(word) + gap
        return left - gap

    def _letter(
        self, at: Float[Array, "2"], letter: str, colour: str, size: float = 1.0
    ) -> None:
        font = _font(size * LETTER * self.scale)
        edge = max(round(3.0 * size * self.scale), 1)
        self.draw.text(
            (float(at[0]), float(at[1])),
            letter,
            colour,
            font=font,
            anchor="mm",
            stroke_width=edge,
            stroke_fill="white",
        )

    def _line(
        self, start: Float[Array, "2"], end: Float[Array, "2"], colour: str
    ) -> None:
        corner = np.floor(np.minimum(start, end)) - 2.0
        size = np.ceil(np.abs(end - start)) + 5.0
        size = np.minimum(size, self.picture.size)
        ends = [tuple(FINE * (each - corner)) for each in (start, end)]

        def line(draw: Any) -> None:
            draw.line(ends, fill=TRACE, width=round(2.0 * FINE * self.scale))

        self._paste(colour, corner, size, line)

    def _card(self, box: list[float]) -> None:
        corner = np.floor(box[:2])
        size = np.ceil(np.subtract(box[2:], box[:2]))
        shape = [0, 0, *(FINE * size - 1)]

        def card(draw: Any) -> None:
            draw.rounded_rectangle(shape, 8.0 * FINE * self.scale, fill=OPACITY)

        self._paste("white", corner, size, card)

    def _paste(
        self,
        colour: str,
        corner: Array,
        size: Array,
        draw_mask: Callable[[Any], None],
    ) -> None:
        from PIL import Image, ImageDraw

        wide, high = (max(int(each), 1) for each in size)
        mask = Image.new("L", (FINE * wide, FINE * high))
        draw_mask(ImageDraw.Draw(mask))
        mask = mask.resize((wide, high), Image.Resampling.BOX)
        self.picture.paste(colour, (int(corner[0]), int(corner[1])), mask)


def _font(size: float) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(max(size, 4.0))
