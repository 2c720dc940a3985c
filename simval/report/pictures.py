"""Pictures of simulations: the scene with its poses, and a filter's attitudes.

A trial turns as SVG with animations of its own: no script and no video.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path

import numpy as np
from markupsafe import Markup, escape

from simval.arrays import Array
from simval.errors import InputError
from simval.geometry import attitude_matrix, normalize
from simval.judge.algorithms import algorithm_of
from simval.report.artifacts import arrays, content_of, is_left, listed, shaped
from simval.report.calibration_page import widest_gap
from simval.report.curves import MAX_GROUPS
from simval.report.formatting import slug
from simval.report.panels import COLOURS, Drawing, SpherePanel, shade
from simval.report.section import Context, Section, made
from simval.report.study_sections import shown_of
from simval.shapes import Float
from simval.studies.filter import artifact_of
from simval.sweep.run import CellResult

# ---- scene

MAX_SCENES = 8  # for the size of a page; the others are named
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


def scene_section(context: Context) -> Section | None:
    """Make the section on the scenes."""
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
    """Bytes of a picture, checked to be one of the right size."""
    content = content_of(file)
    width, height = (int.from_bytes(content[i : i + 4]) for i in (16, 20))
    if content[:8] != PNG or not 0 < max(width, height) <= MAX_SIDE:
        msg = f"{file} is no picture of a scene; run the suite again"
        raise InputError(msg)
    return content


def _caption(
    file: Path, content: Mapping[str, Array], name: str, explained: bool
) -> str:
    """Words under a picture."""
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
    return Drawing(
        name=slug(file.stem),
        fold=f"{name}: its {count} rests on two maps of the sphere" * pictured,
        caption=(
            f"{name}: the {count} directions in which the sensor feels the reaction to "
            "gravity while at rest, in equal-area maps of the two half spheres; "
            "circles at 30, 60 and 90 degrees from the pole."
        ),
        alternative=f"{name}: {count} pose directions on the two half spheres",
        panels=[
            SpherePanel(title=title, directions=directions, sign=sign)
            for sign, title in ((1.0, "z up"), (-1.0, "z down"))
        ],
    )


# ---- turning axes

SIZE = 240.0  # of the picture, in its own units
LENGTH = 95.0  # of an axis
LONGEST = 20.0  # s that it may take; a longer run is shown faster
AZIMUTH, ELEVATION = np.radians(35.0), np.radians(25.0)  # from which it is seen


def turning(
    title: str,
    time: Float[Array, " k"],
    truth: Float[Array, "k 4"],
    estimate: Float[Array, "k 4"],
) -> Markup:
    """Moving axes of the truth, thick and pale, and of the estimate, thin."""
    seconds = min(float(time[-1] - time[0]), LONGEST)
    share = (time - time[0]) / (time[-1] - time[0])
    keys = ";".join(f"{each:.4g}" for each in share)
    lines = []
    for q, width, opacity in ((truth, 7.0, 0.35), (estimate, 2.0, 1.0)):
        ends = _seen(attitude_matrix(normalize(q)))
        for axis, colour in zip(range(3), COLOURS, strict=False):
            lines.append(_line(ends[:, axis], keys, seconds, colour, width, opacity))
    words = escape(title)
    return Markup(  # every part is a number, a colour of ours, or escaped
        f'<svg viewBox="0 0 {SIZE:g} {SIZE:g}" role="img" aria-label="{words}">'
        f"<title>{words}</title>{''.join(lines)}</svg>"
    )


def _seen(axes: Float[Array, "k 3 3"]) -> Float[Array, "k 3 2"]:
    """Ends of the body's axes as seen on the page, x to the right and y down."""
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    near = np.array([np.cos(AZIMUTH), np.sin(AZIMUTH), 0.0])
    up = np.cos(ELEVATION) * np.array([0.0, 0.0, 1.0]) - np.sin(ELEVATION) * near
    middle = SIZE / 2.0
    across, down = axes @ right, -(axes @ up)
    return middle + LENGTH * np.stack([across, down], axis=-1)


def _line(
    ends: Float[Array, "k 2"],
    keys: str,
    seconds: float,
    colour: str,
    width: float,
    opacity: float,
) -> str:
    moves = "".join(
        f'<animate attributeName="{name}" dur="{seconds:.3g}s" '
        f'repeatCount="indefinite" keyTimes="{keys}" '
        f'values="{";".join(f"{value:.1f}" for value in values)}"/>'
        for name, values in zip(("x2", "y2"), ends.T, strict=True)
    )
    x, y = ends[0]
    return (
        f'<line x1="{SIZE / 2:g}" y1="{SIZE / 2:g}" x2="{x:.1f}" y2="{y:.1f}" '
        f'stroke="{shade(colour)}" stroke-width="{width:g}" '
        f'stroke-opacity="{opacity:g}" stroke-linecap="round">{moves}</line>'
    )


# ---- filters


def filters_section(context: Context) -> Section | None:
    """Make the section on filters."""
    cells = context.cells("filter")
    if not cells:
        return None
    pictures = _turning(context, cells)
    return made(*shown_of(context, "filters"),
        turning=pictures[:MAX_GROUPS], hidden=max(len(pictures) - MAX_GROUPS, 0),
    )  # fmt: skip


def _turning(context: Context, cells: Sequence[CellResult]) -> list[tuple[str, Markup]]:
    """A moving picture of each cell that left attitudes, the worst first."""
    found = []
    for cell in cells:
        file = context.run.folder / "artifacts" / artifact_of(cell.parameters)
        if not is_left(file):
            continue
        content = arrays(file)
        time = shaped(file, content, "time", None)
        count = len(time)
        truth, estimate = (
            shaped(file, content, name, count, 4) for name in ("truth", "estimate")
        )
        if count < 2 or not (np.diff(time) > 0.0).all():
            continue
        words = f"{algorithm_of(cell)}, {cell.parameters.get('scenario', '')}"
        # cosine of half of the greatest angle between the two
        nearest = float(np.abs(np.vecdot(truth, estimate)).min())
        found.append((nearest, words, turning(words, time, truth, estimate)))
    found.sort(key=itemgetter(0))
    return [(words, picture) for _, words, picture in found]
