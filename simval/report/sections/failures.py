"""Cells that failed or were never run, with the reason."""

from simval.report.section import Context, Section, made


def section(context: Context) -> Section | None:
    """Make the section.

    Parameters
    ----------
    context : Context
        The run and its verdicts.

    Returns
    -------
    Section or None
        None where every cell is done.
    """
    cells = [cell for cell in context.run.cells if cell.status != "done"]
    if not cells:
        return None
    return made("failures", "Cells without a result", cells=cells)
