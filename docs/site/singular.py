"""The source's figures 1 to 4: vectors of length 1, drawn to one scale.

Each is an orthographic projection, so lengths in the plane of the paper and the
direction of parallels are true. A reference vector r is turned to b; of each pair
:math:`d = (b - r)/2` and :math:`s = (b + r)/2` are drawn, at right angles.
"""

from math import cos, radians, sin
from typing import NamedTuple

import numpy as np

from docs.site.drawing import Drawing, Point
from simval.arrays import Array
from simval.geometry import attitude_matrix, cross, from_rotation_vector, normalize
from simval.shapes import Float

ALPHA = radians(70.0)
"""Angle of the turns."""
SIZE = 110.0
"""Of a vector in the plane of the paper."""
ROWS = (245.0, 490.0)
"""Lower edges of the two rows."""
CORNER = 0.09
"""Side of the mark of a right angle."""
X, Y, Z = np.eye(3)


class Scene(NamedTuple):
    """Two references, the axis about which they turn, and from where they are seen."""

    title: str
    says: str
    axis: Float[Array, "3"]
    references: Float[Array, "2 3"]
    eye: Float[Array, "3"]  # from the origin
    up: Float[Array, "3"]  # on paper

    def turned(self, r: Float[Array, "3"], angle: float = ALPHA) -> Float[Array, "3"]:
        """A vector turned about the axis."""
        turn = from_rotation_vector(angle * normalize(self.axis))
        return r @ attitude_matrix(turn)

    @property
    def paper(self) -> Float[Array, "2 3"]:
        """Unit vectors to the right and up on paper."""
        eye = normalize(self.eye)
        up = normalize(self.up - (self.up @ eye) * eye)
        return np.stack([cross(up, eye), up])


_WIDE = np.array([[cos(0.78), -sin(0.78), 0.0], [cos(0.78), sin(0.78), 0.0]])
_TILTED = np.array([Z, [sin(1.0), 0.0, cos(1.0)]])
_ASIDE = np.array([0.5, -0.75, 1.0])
SCENES = (
    Scene("Fig. 1: about r_1", "d_1 = 0, d_2 ⊥ r_1", Z, _TILTED,
          np.array([1.0, 0.45, 0.42]), Z),
    Scene("Fig. 2: seen along r_1", "r_2 ⊥ r_1", Z, np.array([Z, X]), Z, Y),
    Scene("Fig. 3: about b_1 + b_2", "d_1 = −d_2", X, _WIDE,
          np.array([0.45, 0.17, 0.98]), X),
    Scene("Fig. 3: about b_1 − b_2", "d_1 = d_2", Y, _WIDE, _ASIDE, X),
    Scene("Fig. 4: seen along b_1 × b_2", "d_1 and d_2 not parallel", Z, _WIDE, Z, X),
)  # fmt: skip


def half_difference(r: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, "3"]:
    """Source's d."""
    return (b - r) / 2.0


def half_sum(r: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, "3"]:
    """Source's s."""
    return (b + r) / 2.0


def singular() -> Drawing:
    """All figures on one sheet."""
    d = Drawing(750, 495, "The source's figures 1 to 4: turns, and their differences")
    places = ((130.0, 150.0), (310.0, 150.0),
              (130.0, 390.0), (350.0, 390.0), (610.0, 375.0))  # fmt: skip
    for k, (scene, origin) in enumerate(zip(SCENES, places, strict=True)):
        _draw(d, scene, origin, ROWS[k > 1])
    _triangle(d, (500.0, 150.0))
    return d


def _draw(d: Drawing, scene: Scene, origin: Point, floor: float) -> None:
    def at(point: Float[Array, "3"]) -> Point:
        x, y = SIZE * (scene.paper @ point)
        return (origin[0] + x, origin[1] - y)

    axis, angles = normalize(scene.axis), np.linspace(0.0, ALPHA, 25)
    along = float(np.linalg.norm(scene.paper @ axis)) < 1e-9
    if not along:
        d.line(at(-0.35 * axis), at(1.3 * axis), "faint", "thin")
    for k, r in enumerate(scene.references, 1):
        b = scene.turned(r)
        half, middle = half_difference(r, b), half_sum(r, b)
        if np.linalg.norm(half) < 1e-9:  # on the axis
            if not along:
                d.arrow(origin, at(r), "world")
                x, y = at(0.95 * r)
                d.words((x + 9.0, y), f"r_{k} = b_{k}", "world", "start")
            continue
        d.curve([at(scene.turned(r, a)) for a in angles], "faint")
        d.line(origin, at(middle), "gravity")
        d.arrow(origin, at(r), "world")
        d.arrow(origin, at(b), "body")
        d.line(at(r), at(middle), "sensor", "thin")
        d.arrow(at(middle), at(b), "sensor")
        _square(d, [at(middle + v) for v in _corner(half, -middle)])
        _label(d, at(r), origin, f"r_{k}", "world")
        _label(d, at(b), origin, f"b_{k}", "body")
        _label(d, at(middle + 0.3 * half), origin, f"d_{k}", "sensor")
        (x, y), (u, v) = at(0.5 * middle), at(middle)
        away = 13.0 / float(np.hypot(u - origin[0], v - origin[1]))
        place = (x - away * (v - origin[1]), y + away * (u - origin[0]) + 5.0)
        d.words(place, f"s_{k}", "gravity")
    d.words((origin[0], floor - 25.0), scene.title)
    d.words((origin[0], floor - 5.0), scene.says, "faint")


def _triangle(d: Drawing, origin: Point) -> None:
    # the right half of the figure from above: O, s2 and b2, upright
    long, short, size = cos(ALPHA / 2.0), sin(ALPHA / 2.0), 1.4 * SIZE
    foot = (origin[0] + size * long, origin[1])
    top = (foot[0], foot[1] - size * short)
    d.line(origin, foot, "gravity")
    d.arrow(foot, top, "sensor")
    d.arrow(origin, top, "body")
    c = CORNER * size
    _square(d, [(foot[0] - c, foot[1]), (foot[0] - c, foot[1] - c),
                (foot[0], foot[1] - c)])  # fmt: skip
    angles = np.linspace(0.0, ALPHA / 2.0, 12)
    d.curve(
        [(origin[0] + 40.0 * cos(a), origin[1] - 40.0 * sin(a)) for a in angles],
        "faint",
    )
    d.words((origin[0] + 58.0, origin[1] - 10.0), "α/2", "faint")
    d.words((origin[0] - 10.0, origin[1] + 5.0), "O", "faint")
    d.words((origin[0] + 50.0, origin[1] - 58.0), "|b_2| = 1", "body")
    d.words((foot[0] + 8.0, foot[1] - 40.0), "|d_2| = sin α/2", "sensor", "start")
    d.words((foot[0] - 60.0, foot[1] + 20.0), "|s_2| = cos α/2", "gravity")
    d.words((origin[0] + 80.0, ROWS[0] - 25.0), "Fig. 2: its triangle")
    d.words((origin[0] + 80.0, ROWS[0] - 5.0), "eqs. (18), (19)", "faint")


def _corner(
    one: Float[Array, "3"], other: Float[Array, "3"]
) -> list[Float[Array, "3"]]:
    one, other = CORNER * normalize(one), CORNER * normalize(other)
    return [one, one + other, other]


def _square(d: Drawing, corners: list[Point]) -> None:
    d.curve(corners, "faint")


def _label(d: Drawing, tip: Point, origin: Point, text: str, colour: str) -> None:
    # beyond a tip, seen from the origin
    x, y = tip[0] - origin[0], tip[1] - origin[1]
    away = 16.0 / max(float(np.hypot(x, y)), 1.0)
    d.words((tip[0] + away * x, tip[1] + away * y + 5.0), text, colour)
