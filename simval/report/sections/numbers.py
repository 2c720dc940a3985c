"""Every number: value, standard error, sample size, unit and prediction."""

from simval.report.section import Context, Section, made

SHOWN = 1000


def section(context: Context) -> Section | None:
    """Make the section.

    Parameters
    ----------
    context : Context
        The run and its verdicts.

    Returns
    -------
    Section or None
        None where nothing was measured.
    """
    rows = [(cell.name, row) for cell in context.run.cells for row in cell.rows]
    if not rows:
        return None
    return made(
        "numbers",
        "All numbers",
        rows=rows[:SHOWN],
        hidden=max(0, len(rows) - SHOWN),
        folder=context.run.folder.name,
    )
