"""Attitude filters: what their study declares, and a moving picture of a trial each."""

from collections.abc import Sequence
from operator import itemgetter

import numpy as np
from markupsafe import Markup

from simval.judge.algorithms import algorithm_of
from simval.report.artifacts import arrays, is_left, shaped
from simval.report.attitudes import turning
from simval.report.curves import MAX_GROUPS
from simval.report.declared import shown_of
from simval.report.section import Context, Section, made
from simval.studies.filter import artifact_of
from simval.sweep.run import CellResult


def section(context: Context) -> Section | None:
    """Make the section."""
    cells = context.cells("filter")
    if not cells:
        return None
    pictures = _turning(context, cells)
    return made(
        "filters", "Attitude filters", *shown_of(context, "filters"),
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
