"""The page: the sections in order, in one template."""

from simval.report.section import Context, Section, template
from simval.report.sections import (
    attitude,
    calibration,
    checks,
    failures,
    numbers,
    provenance,
    scene,
    summary,
)
from simval.sweep import Run
from simval.verdict import judge

SECTIONS = (
    summary.section,
    failures.section,
    calibration.section,
    attitude.section,
    scene.section,
    checks.section,
    numbers.section,
    provenance.section,
)


def render(run: Run, alpha: float = 1e-3) -> str:
    """Render a run as one HTML page.

    Parameters
    ----------
    run : Run
        The run; cells that are missing or failed are shown as such.
    alpha : float, default 1e-3
        False-alarm rate that the sampling checks share.

    Returns
    -------
    str
        The page; the same run gives the same bytes.
    """
    rows = [(cell.name, row) for cell in run.cells for row in cell.rows]
    context = Context(run=run, verdicts=judge(rows, alpha), alpha=alpha)
    sections: list[Section] = [
        made for make in SECTIONS if (made := make(context)) is not None
    ]
    title = run.manifest["title"] or run.manifest["suite"]
    return template("page").render(title=title, sections=sections, run=run)
