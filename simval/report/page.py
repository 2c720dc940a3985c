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
    title = run.manifest["title"] or run.manifest["suite"]
    made = _sections(run, alpha)
    return template("page").render(title=title, sections=made, run=run)


def figures(run: Run) -> dict[str, str]:
    """Draw every figure of the report as a file of its own.

    Parameters
    ----------
    run : Run
        The run.

    Returns
    -------
    dict
        Name to SVG, dark ink on white paper.
    """
    paper = "<style>svg { color: #1c1c1e; background: #ffffff; }</style>"
    return {
        name: drawn.replace(">", ">" + paper, 1) + "\n"
        for section in _sections(run, 1e-3)
        for name, drawn in section.figures.items()
    }


def _sections(run: Run, alpha: float) -> list[Section]:
    rows = [(cell.name, row) for cell in run.cells for row in cell.rows]
    context = Context(run=run, verdicts=judge(rows, alpha), alpha=alpha)
    return [made for make in SECTIONS if (made := make(context)) is not None]
