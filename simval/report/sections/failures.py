"""Cells that failed or were never run, and everything else not measured."""

import shlex

from simval.gate.finding import reproduce
from simval.report.section import Context, Section, made

SHOWN = 200


def section(context: Context) -> Section | None:
    """Make the section."""
    unfinished, gaps = context.judged.unfinished, context.judged.gaps
    if not unfinished and not gaps:
        return None
    cells = [cell for cell in unfinished if cell.status == "failed"]
    return made(
        "failures",
        "What was not measured",
        cells=cells[:SHOWN],
        commands=[reproduce(cell.named, context.folder) for cell in cells[:SHOWN]],
        pending=[cell.name for cell in unfinished if cell.status == "pending"],
        folder=shlex.quote(context.folder),
        gaps=gaps[:SHOWN],
        hidden=max(0, len(cells) - SHOWN) + max(0, len(gaps) - SHOWN),
    )
