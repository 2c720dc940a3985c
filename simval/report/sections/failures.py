"""Cells that failed or were never run, and everything else not measured."""

import shlex

from simval.judge.findings import reproduce
from simval.report.section import Context, Section, made

MAX_ROWS = 200  # for the size of a page; the rest is counted


def section(context: Context) -> Section | None:
    """Make the section."""
    unfinished, gaps = context.judged.unfinished, context.judged.gaps
    if not unfinished and not gaps:
        return None
    cells = [cell for cell in unfinished if cell.status == "failed"]
    return made(
        "failures",
        "What was not measured",
        cells=cells[:MAX_ROWS],
        commands=[reproduce(cell.named, context.folder) for cell in cells[:MAX_ROWS]],
        pending=[cell.name for cell in unfinished if cell.status == "pending"],
        folder=shlex.quote(context.folder),
        gaps=gaps[:MAX_ROWS],
        hidden=max(0, len(cells) - MAX_ROWS) + max(0, len(gaps) - MAX_ROWS),
    )
