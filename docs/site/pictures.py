"""The pictures of the documents: ``python -m docs.site.pictures`` draws them anew.

What they show is computed by the package, so that a picture cannot say another thing
than the code.
"""

from math import cos, pi, radians, sin
from pathlib import Path

import numpy as np

from docs.site.drawing import Drawing, Point
from docs.site.house import house
from docs.site.singular import singular
from simval.arrays import Array
from simval.geometry import attitude_matrix, from_rotation_vector
from simval.shapes import Float

FOLDER = Path(__file__).parents[1] / "pictures"
TURN = radians(30.0)
AXES = np.eye(3)


def _seen(point: Float[Array, "3"], origin: Point, size: float) -> Point:
    """Place of a world point on paper: x to the lower left, y right, z up."""
    x, y, z = point
    return (
        origin[0] + size * (0.87 * y - 0.5 * x),
        origin[1] + size * (0.3 * x + 0.2 * y - z),
    )


def _frame(
    d: Drawing, q: Float[Array, "4"], origin: Point, size: float, name: str, colour: str
) -> None:
    """Draw the axes of a frame that has the attitude q, seen in the world."""
    axes_in_world = attitude_matrix(q)  # its rows: body axes in the world
    for axis, letter in zip(axes_in_world, "xyz", strict=True):
        end = _seen(axis, origin, size)
        d.arrow(origin, end, colour)
        away = _seen(1.17 * axis, origin, size)
        d.words((away[0], away[1] + 5), f"{letter}_{name}", colour)


def frames() -> Drawing:
    """World, body and sensor."""
    d = Drawing(640, 270, "World, body and sensor frame, and gravity")
    still = from_rotation_vector(np.zeros(3))
    body = from_rotation_vector(np.array([0.35, 0.0, 0.5]))
    sensor = from_rotation_vector(np.array([0.35, 0.25, 0.9]))
    _frame(d, still, (110.0, 160.0), 90.0, "w", "world")
    _frame(d, body, (320.0, 160.0), 90.0, "b", "body")
    _frame(d, sensor, (535.0, 160.0), 90.0, "s", "sensor")
    d.arrow((50.0, 60.0), (50.0, 120.0), "gravity")
    d.words((50.0, 140.0), "gravity", "gravity")
    for x, text, colour in (
        (110.0, "world w: z up", "world"),
        (320.0, "body b", "body"),
        (535.0, "sensor s", "sensor"),
    ):
        d.words((x, 255.0), text, colour)
    d.words((215.0, 225.0), "R_wb")
    d.words((430.0, 225.0), "R_bs")
    d.arrow((250.0, 236.0), (180.0, 236.0), "faint")
    d.arrow((465.0, 236.0), (395.0, 236.0), "faint")
    return d


def attitude() -> Drawing:
    """A body turned by 30 degrees, and a fixed vector in both frames."""
    d = Drawing(
        640, 260, "One vector in the world's axes and in those of a turned body"
    )
    q = from_rotation_vector(TURN * AXES[2])
    seen = attitude_matrix(q) @ AXES[0]
    _flat(d, (110.0, 170.0), 0.0, "w", "world")
    _flat(d, (110.0, 170.0), TURN, "b", "body")
    _arc(d, (110.0, 170.0), 55.0, 0.0, TURN)
    d.words((196.0, 152.0), "+30°", "faint")
    _ray(d, (110.0, 170.0), np.array([1.0, 0.0]), "r")
    d.words((20.0, 235.0), "seen from above: the body turned", "faint", "start")
    _flat(d, (440.0, 130.0), 0.0, "b", "body")
    _ray(d, (440.0, 130.0), seen[:2], "b = A(q) r")
    _arc(d, (440.0, 130.0), 55.0, 0.0, -TURN)
    d.words((516.0, 150.0), "−30°", "faint")
    d.words((330.0, 235.0), "in the body's axes: it turned back", "faint", "start")
    return d


def _flat(d: Drawing, origin: Point, turn: float, name: str, colour: str) -> None:
    for letter, angle in (("x", turn), ("y", turn + pi / 2)):
        end = (origin[0] + 105 * cos(angle), origin[1] - 105 * sin(angle))
        d.arrow(origin, end, colour)
        label = (origin[0] + 122 * cos(angle), origin[1] - 122 * sin(angle) + 5)
        d.words(label, f"{letter}_{name}", colour)


def _ray(d: Drawing, origin: Point, along: Float[Array, "2"], name: str) -> None:
    end = (origin[0] + 80 * along[0], origin[1] - 80 * along[1])
    d.arrow(origin, end, "sensor")
    d.words((end[0] + 4, end[1] + 20), name, "sensor")


def _arc(d: Drawing, origin: Point, size: float, start: float, end: float) -> None:
    angles = np.linspace(start, end, 16)
    d.curve(
        [(origin[0] + size * cos(a), origin[1] - size * sin(a)) for a in angles],
        "faint",
    )


def specific_force() -> Drawing:
    """What an accelerometer reads at rest, upside down and falling."""
    d = Drawing(640, 230, "Specific force at rest, upside down, and in free fall")
    cases = (
        (110.0, 0.0, 1.0, "at rest, level", "reads (0, 0, +g)"),
        (320.0, pi, 1.0, "upside down", "reads (0, 0, −g)"),
        (530.0, 0.0, 0.0, "falling freely", "reads (0, 0, 0)"),
    )
    for x, turn, force, title, reads in cases:
        d.words((x, 20.0), title)
        d.box((x - 40.0, 90.0), (80.0, 30.0), "sensor")
        z = attitude_matrix(from_rotation_vector(turn * AXES[0]))[2]
        d.arrow((x - 58.0, 105.0), (x - 58.0, 105.0 - 45.0 * z[2]), "sensor")
        d.words((x - 76.0, 105.0 - 45.0 * z[2] + 4.0), "z_s", "sensor")
        d.arrow((x + 60.0, 75.0), (x + 60.0, 135.0), "gravity")
        d.words((x + 60.0, 152.0), "gravity", "gravity")
        if force:
            d.line((x - 45.0, 123.0), (x + 45.0, 123.0), "faint")
            d.arrow((x + 15.0, 105.0), (x + 15.0, 45.0), "ink")
            d.words((x + 27.0, 55.0), "f")
        d.words((x, 205.0), reads)
    return d


def readings() -> Drawing:
    """From the true force to the reading, and back by a calibration."""
    d = Drawing(
        640, 230, "From specific force to a raw reading, and back by a calibration"
    )
    d.words((45.0, 64.0), "f")
    d.words((45.0, 84.0), "m/s²", "faint")
    steps = (
        (105.0, "(T K)⁻¹", "axes, scale"),
        (270.0, "+ B", "bias"),
        (400.0, "+ n", "noise"),
    )
    for x, text, words in steps:
        d.box((x, 40.0), (100.0, 45.0), "sensor" if text == "+ n" else "faint")
        d.words((x + 50.0, 60.0), text)
        d.words((x + 50.0, 78.0), words, "faint")
    for start, end in ((65.0, 103.0), (205.0, 268.0), (370.0, 398.0), (500.0, 560.0)):
        d.arrow((start, 62.0), (end, 62.0), "ink")
    d.words((590.0, 64.0), "y")
    d.words((590.0, 84.0), "raw units", "faint")
    d.line((590.0, 95.0), (590.0, 173.0), "ink")
    d.box((360.0, 150.0), (170.0, 45.0), "body")
    d.words((445.0, 170.0), "T̂ K̂ (y − B̂)")
    d.words((445.0, 188.0), "a calibration", "faint")
    d.arrow((590.0, 172.0), (532.0, 172.0), "ink")
    d.arrow((358.0, 172.0), (80.0, 172.0), "ink")
    d.words((45.0, 175.0), "f̂")
    d.words((45.0, 195.0), "m/s²", "faint")
    return d


def errors() -> Drawing:
    """Which way an error points."""
    d = Drawing(
        640,
        150,
        "Attitude errors are truth minus estimate, calibration errors the reverse",
    )
    rows = (
        (45.0, "attitude", "e = q − q̂", ("estimate q̂", "truth q")),
        (115.0, "calibration", "estimate − truth", ("truth", "estimate")),
    )
    for y, title, words, (tail, head) in rows:
        d.words((70.0, y + 5.0), title)
        d.line((180.0, y), (580.0, y), "faint", "thin")
        d.arrow((270.0, y), (470.0, y), "sensor")
        d.words((270.0, y + 25.0), tail)
        d.words((470.0, y + 25.0), head)
        d.words((370.0, y - 10.0), words, "sensor")
    return d


PICTURES = {
    "frames": frames,
    "attitude": attitude,
    "specific_force": specific_force,
    "readings": readings,
    "errors": errors,
    "singular": singular,
    "house": house,
}


def main() -> None:
    """Draw every picture into `docs/pictures`."""
    for name, draw in PICTURES.items():
        (FOLDER / f"{name}.svg").write_text(draw().svg(), encoding="utf-8")


if __name__ == "__main__":
    main()
