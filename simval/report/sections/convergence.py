"""Convergence of the solvers: distance to the solution after each iteration."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from simval.errors import InputError
from simval.report.artifacts import arrays, listed
from simval.report.curves import MAX_GROUPS
from simval.report.panels import COLOURS, MARKERS, Drawing, Panel, Series
from simval.report.parameters import setting_words
from simval.report.section import Context, Section, made
from simval.report.sections.other import numbers
from simval.studies.solvers import artifact_of
from simval.sweep.run import CellResult

LINES = ("-", "--", ":", "-.")


def section(context: Context) -> Section | None:
    """Make the section."""
    files = listed(context.run.folder, "convergence-*.npz")
    cells = context.cells("solvers")
    titles = {artifact_of(cell.parameters): _title(cell) for cell in cells}
    panels = [panel for file in files[:MAX_GROUPS] if (panel := _panel(file, titles))]
    tables = [numbers("solvers", cells)] if cells else []
    if not panels and not tables:
        return None
    left_out = [titles.get(file.name, file.stem) for file in files[MAX_GROUPS:]]
    drawings = [_drawing(panels, left_out)] if panels else []
    return made("convergence", "Convergence of the solvers", drawings, tables)


def _drawing(panels: Sequence[Panel], left_out: Sequence[str]) -> Drawing:
    return Drawing(
        name="convergence",
        asked="How fast does each solver come to the answer?",
        finding=_steps(panels[-1]),
        caption=(
            "Each point is one iteration. A straight line means linear convergence, a "
            "line that bends down faster convergence; solvers that take the same steps "
            "are on one line. The last points are rounding."
        ),
        alternative="Distance to the solution after each iteration, for each solver",
        panels=panels,
        left_out=left_out,
    )


def _title(cell: CellResult) -> str:
    """What was solved: poses and noise."""
    return ", ".join(
        setting_words("solvers", key, cell.parameters[key])
        for key in ("poses", "noise_std")
    )


def _steps(panel: Panel) -> str:
    """How many iterations each solver needs, in words."""
    named = [s for s in panel.series if s.label]
    told = ", ".join(f"{s.label} {int(np.max(s.x))}" for s in named)
    return f"Iterations with {panel.title}: {told}."


def _panel(file: Path, titles: Mapping[str, str]) -> Panel | None:
    series: list[Series] = []
    for i, (name, values) in enumerate(sorted(arrays(file).items())):
        trace = np.atleast_1d(np.asarray(values, dtype=float)).ravel()
        if not len(trace):
            msg = f"{file}: `{name}` is empty; run the suite again"
            raise InputError(msg)
        steps = np.arange(len(trace), dtype=float)
        trace = np.where(trace > 0.0, trace, np.nan)
        colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
        line = LINES[i % len(LINES)]  # of lines that coincide each is seen
        series.append(Series(label="", x=steps, y=trace, colour=colour, line=line))
        series.append(
            Series(label=name, x=steps, y=trace, colour=colour, marker=marker)
        )
    if not series:
        return None
    return Panel(
        title=titles.get(file.name, file.stem.removeprefix("convergence-")),
        x_label="iteration",
        y_label="distance to the solution",
        series=tuple(series),
        log_x=False,
    )
