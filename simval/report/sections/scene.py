"""The scene that was simulated: a picture, and the poses on the sphere."""

import base64
from dataclasses import replace
from pathlib import Path

from simval.report.artifacts import arrays, shaped
from simval.report.panels import Drawing, SpherePanel
from simval.report.section import Context, Section, made
from simval.report.words import slug

MAX_SCENES = 8  # for the size of a page; the others are named
MAX_DIRECTIONS = 2000  # points of a panel, the first; for the size of a page
MAX_PICTURE = 600_000
"""Bytes; a larger picture is left in the run folder."""


def section(context: Context) -> Section | None:
    """Make the section."""
    files = sorted((context.run.folder / "artifacts").glob("scene-*.npz"))
    scenes = [scene for file in files[:MAX_SCENES] if (scene := _scene(file))]
    if not scenes:
        return None
    name, data, last = scenes[-1]
    rest = [file.stem for file in files[MAX_SCENES:]]
    scenes[-1] = (name, data, replace(last, left_out=rest))
    drawings = [drawing for _, _, drawing in scenes]
    return made(
        "scene", "Scenes", drawings, scenes=scenes, hidden=len(files) - len(scenes)
    )


def _scene(file: Path) -> tuple[str, str, Drawing] | None:
    """Name, picture (base64, empty without one) and pose map of one scene."""
    content = arrays(file)
    if "directions" not in content:
        return None
    directions = shaped(file, content, "directions", None, 3)
    count = len(directions)
    name = file.stem.removeprefix("scene-").rpartition("-")[0]
    picture = file.with_suffix(".png")
    data = ""
    if picture.is_file() and picture.stat().st_size <= MAX_PICTURE:
        data = base64.b64encode(picture.read_bytes()).decode()
    some = f", {MAX_DIRECTIONS} of them drawn" if count > MAX_DIRECTIONS else ""
    drawing = Drawing(
        name=slug(file.stem),
        caption=(
            f"{name}: the {count} directions{some} in which the sensor feels the "
            "reaction to gravity while at rest, in equal-area maps of the two half "
            "spheres; circles at 30, 60 and 90 degrees from the pole."
        ),
        alternative=f"{name}: {count} pose directions on the two half spheres",
        panels=[
            SpherePanel(title=title, directions=directions[:MAX_DIRECTIONS], sign=sign)
            for sign, title in ((1.0, "z > 0"), (-1.0, "z < 0"))
        ],
    )
    return name, data, drawing
