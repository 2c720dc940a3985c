"""The scene that was simulated: a picture, and the poses on the sphere."""

import base64
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from simval.arrays import Array
from simval.report.section import Context, Section, made
from simval.report.svg import COLOURS, style, svg


def section(context: Context) -> Section | None:
    """Make the section.

    Parameters
    ----------
    context : Context
        The run and its verdicts.

    Returns
    -------
    Section or None
        None where no study left the poses of a scene.
    """
    files = sorted((context.run.folder / "artifacts").glob("scene-*.npz"))
    scenes = [_scene(file) for file in files]
    if not scenes:
        return None
    figures = {str(scene["key"]): str(scene["figure"]) for scene in scenes}
    return made("scene", "Scenes", figures=figures, scenes=scenes)


def _scene(file: Path) -> dict[str, object]:
    """Name, picture (base64, empty without one) and pose map of one scene."""
    with np.load(file, allow_pickle=False) as content:
        directions = content["directions"]
    name = file.stem.removeprefix("scene-")
    picture = file.with_suffix(".png")
    data = ""
    if picture.is_file():
        data = base64.b64encode(picture.read_bytes()).decode()
    return {
        "key": file.stem,
        "name": name.rpartition("-")[0],
        "poses": len(directions),
        "picture": data,
        "figure": _sphere(directions, file.stem),
    }


def _sphere(directions: Array, name: str) -> str:
    """Directions of the specific force in equal-area maps of both half spheres."""
    with mpl.rc_context(style(name)):
        figure = Figure(figsize=(8.0, 4.0), layout="constrained")
        for column, sign, title in ((1, 1.0, "z > 0"), (2, -1.0, "z < 0")):
            axes = figure.add_subplot(1, 2, column)
            half = directions[sign * directions[:, 2] >= 0.0]
            # Lambert's azimuthal equal-area projection about the pole
            scale = np.sqrt(2.0 / (1.0 + np.abs(half[:, 2])))
            axes.plot(
                half[:, 0] * scale, half[:, 1] * scale, "o", color=COLOURS[0], ms=5
            )
            angle = np.linspace(0.0, 2.0 * np.pi, 181)
            for degrees in (30, 60, 90):
                radius = 2.0 * np.sin(np.radians(degrees) / 2.0)
                axes.plot(
                    radius * np.cos(angle),
                    radius * np.sin(angle),
                    color="#8c8c8c",
                    lw=0.6,
                )
            axes.set_aspect("equal")
            axes.grid(False)
            axes.set_xticks([])
            axes.set_yticks([])
            for spine in axes.spines.values():
                spine.set_visible(False)
            axes.set_title(f"direction of gravity's reaction, {title}")
        return svg(
            figure, name, f"{len(directions)} pose directions on the two half spheres"
        )
