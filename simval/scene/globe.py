"""The sphere of visited directions: an inset in sensor axes, seen from a fixed side.

The body turns and the sphere stays, so that a gap in the directions is seen. The far
side shows through, paler.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.geometry import normalize
from simval.scene.arrows import AXES, FORCE
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
    """Directions of the specific force in sensor axes."""

    rests: Float[Array, "m 3"]  # unit, of each rest, in order
    visited: NDArray[np.bool_]  # rests that have begun
    now: Float[Array, "3"]  # of this instant, in g; of any length


def draw_globe(draw: Any, directions: Directions, scale: float) -> None:
    """Draw the sphere on a square of `EDGE`, `scale` pixels for one."""
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
    """Points as they are seen: to the right, up, and towards the eye."""
    near = np.array([np.cos(AZIMUTH), np.sin(AZIMUTH), 0.0])
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    up = np.array([0.0, 0.0, np.cos(ELEVATION)]) - np.sin(ELEVATION) * near
    eye = np.cross(right, up)
    return points @ np.stack([right, up, eye], axis=1)


def placed(points: Float[Array, "m 3"], scale: float) -> Float[Array, "m 2"]:
    """Pixels (right, down) of points of the unit sphere in its square."""
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
    which: NDArray[np.bool_],
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
