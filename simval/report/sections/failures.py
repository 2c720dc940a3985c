"""Cells that failed or were never run, and what else was not measured."""

from simval.report.section import Context, Section, made

SHOWN = 200


def section(context: Context) -> Section | None:
    """Make the section.

    Parameters
    ----------
    context : Context
        The run and its verdicts.

    Returns
    -------
    Section or None
        None where every cell is done and measured what it says.
    """
    cells, gaps = context.judged.unfinished, context.judged.gaps
    if not cells and not gaps:
        return None
    return made(
        "failures",
        "What was not measured",
        cells=cells[:SHOWN],
        gaps=gaps[:SHOWN],
        hidden=max(0, len(cells) - SHOWN) + max(0, len(gaps) - SHOWN),
    )
