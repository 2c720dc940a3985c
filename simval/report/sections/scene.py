"""The scene that was simulated: a picture, and the poses on the sphere."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from simval.arrays import Array
from simval.errors import InputError
from simval.report.artifacts import arrays, content_of, is_left, listed, shaped
from simval.report.calibration_page import widest_gap
from simval.report.panels import Drawing, SpherePanel
from simval.report.section import Context, Section, made
from simval.report.words import slug
from simval.shapes import Float

MAX_SCENES = 8  # for the size of a page; the others are named
MAX_DIRECTIONS = 2000  # points of a panel, the first; for the size of a page
MAX_PICTURE = 600_000
"""Bytes; a larger picture is left in the run folder."""
PNG = b"\x89PNG\r\n\x1a\n"
MAX_SIDE = 4096  # pixels; the scenes are drawn with 640


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A scene on the page."""

    name: str  # of the scene
    finding: str  # on its poses
    data: str  # the picture, base64; empty without one
    caption: str  # of the picture
    drawing: Drawing  # map of its poses


def section(context: Context) -> Section | None:
    """Make the section."""
    files = listed(context.run.folder, "scene-*.npz")
    scenes: list[Picture] = []
    for file in files[:MAX_SCENES]:
        if scene := _scene(file, explained=any(each.data for each in scenes)):
            scenes.append(scene)
    if not scenes:
        return None
    rest = [file.stem for file in files[MAX_SCENES:]]
    scenes[-1] = replace(scenes[-1], drawing=replace(scenes[-1].drawing, left_out=rest))
    drawings = [scene.drawing for scene in scenes]
    return made(
        "scene",
        "Scenes",
        drawings,
        scenes=scenes,
        hidden=len(files) - len(scenes),
        found=" ".join(scene.finding for scene in scenes),
    )


def _scene(file: Path, explained: bool) -> Picture | None:
    content = arrays(file)
    if "directions" not in content:
        return None
    directions = shaped(file, content, "directions", None, 3)
    name = file.stem.removeprefix("scene-").rpartition("-")[0]
    picture = file.with_suffix(".png")
    data = ""
    if is_left(picture) and picture.lstat().st_size <= MAX_PICTURE:
        data = base64.b64encode(_drawn(picture)).decode()
    return Picture(
        name=name,
        finding=(
            f"No direction is farther than {widest_gap(directions):.0f} degrees from "
            f"one of the {len(directions)} rests of {name}."
        ),
        data=data,
        caption=_caption(file, content, name, explained),
        drawing=_map(file, name, directions, bool(data)),
    )


def _drawn(file: Path) -> bytes:
    """The bytes of a picture, which is one and of the size that is drawn."""
    content = content_of(file)
    width, height = (int.from_bytes(content[i : i + 4]) for i in (16, 20))
    if content[:8] != PNG or not 0 < max(width, height) <= MAX_SIDE:
        msg = f"{file} is no picture of a scene; run the suite again"
        raise InputError(msg)
    return content


def _caption(
    file: Path, content: Mapping[str, Array], name: str, explained: bool
) -> str:
    """Words under a picture; one of an older run has no arrows."""
    if "drawn" not in content:
        return f"The scene {name}, drawn by the physics engine."
    time, end = shaped(file, content, "drawn", 2)
    when = f"The scene {name} after {time:.1f} s of {end:.1f} s"
    if explained:
        return f"{when}; arrows and sphere as above."
    return (
        f"{when}. The arrows are the axes x, y and z of the sensor and the specific "
        "force f that it feels, at rest the reaction to gravity, which points up. The "
        "sphere shows f as the sensor sees it: a dot for each rest, filled once it is "
        "visited, pale on the far side; the large dot is f now."
    )


def _map(
    file: Path, name: str, directions: Float[Array, "m 3"], pictured: bool
) -> Drawing:
    count = len(directions)
    some = f", {MAX_DIRECTIONS} of them drawn" if count > MAX_DIRECTIONS else ""
    return Drawing(
        name=slug(file.stem),
        fold=f"{name}: its {count} rests on two maps of the sphere" * pictured,
        caption=(
            f"{name}: the {count} directions{some} in which the sensor feels the "
            "reaction to gravity while at rest, in equal-area maps of the two half "
            "spheres; circles at 30, 60 and 90 degrees from the pole."
        ),
        alternative=f"{name}: {count} pose directions on the two half spheres",
        panels=[
            SpherePanel(title=title, directions=directions[:MAX_DIRECTIONS], sign=sign)
            for sign, title in ((1.0, "z up"), (-1.0, "z down"))
        ],
    )
