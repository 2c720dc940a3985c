"""Convergence of the solvers: distance to the solution after each iteration."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from simval.report.artifacts import arrays
from simval.report.curves import MAX_GROUPS
from simval.report.panels import COLOURS, MARKERS, Drawing, Panel, Series
from simval.report.section import Context, Section, made
from simval.report.sections.other import numbers


def section(context: Context) -> Section | None:
    """Make the section."""
    files = sorted((context.run.folder / "artifacts").glob("convergence-*.npz"))
    panels = [panel for file in files[:MAX_GROUPS] if (panel := _panel(file))]
    cells = context.cells("solvers")
    tables = [numbers("solvers", cells)] if cells else []
    if not panels and not tables:
        return None
    left_out = [file.stem for file in files[MAX_GROUPS:]]
    drawings = [_drawing(panels, left_out)] if panels else []
    return made("convergence", "Convergence of the solvers", drawings, tables)


def _drawing(panels: Sequence[Panel], left_out: Sequence[str]) -> Drawing:
    return Drawing(
        name="convergence",
        caption=(
            "Each point is one iteration. A straight line means linear convergence, a "
            "line that bends down faster convergence. The last points are rounding."
        ),
        alternative="Distance to the solution after each iteration, for each solver",
        panels=panels,
        left_out=left_out,
    )


def _panel(file: Path) -> Panel | None:
    series: list[Series] = []
    for i, (name, values) in enumerate(sorted(arrays(file).items())):
        trace = np.atleast_1d(np.asarray(values, dtype=float)).ravel()
        steps = np.arange(len(trace), dtype=float)
        trace = np.where(trace > 0.0, trace, np.nan)
        colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
        series.append(Series(label="", x=steps, y=trace, colour=colour, line="-"))
        series.append(
            Series(label=name, x=steps, y=trace, colour=colour, marker=marker)
        )
    if not series:
        return None
    return Panel(
        title=file.stem.removeprefix("convergence-"),
        x_label="iteration, 1",
        y_label="distance to the solution",
        series=tuple(series),
        log_x=False,
    )
